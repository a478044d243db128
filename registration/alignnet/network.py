"""AlignNet-3D: where an object is in each of two clouds, and from that its motion between them."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from registration.alignnet import angles, ragged
from registration.alignnet.angles import AngleOutputs, Angles
from registration.alignnet.layers import Head, PointEncoder
from registration.alignnet.ragged import Clouds

COMPOSITIONS = ("composed", "additive")
Places = Float[Tensor, "b 3"]  # [m]
CONTEXT = 2  # numbers that say how a cloud is seen: range and point count; in the embedding also the direction


@dataclass(frozen=True)
class Architecture:
    """What the network is made of; the released code's variants are the settings that are off.

    The first block is the paper's; `paper()` switches the second block off.
    """

    n_bins: int = 50  # of an angle
    coarse: tuple[int, ...] = (64, 128, 256)  # layers of a point, T-CoarseNet
    fine: tuple[int, ...] = (64, 128, 512)  # T-FineNet
    embedding: tuple[int, ...] = (64, 128, 1024)  # of the canonical cloud
    head: tuple[int, ...] = (512, 256)  # fully connected layers of each stage
    dropout: float = 0.3  # share of features dropped before a head's last layer
    composition: str = "composed"  # T1 Tf T2^-1 as published; additive: in sensor axes, as released
    branch_norms: bool = False  # batch norm of its own for each cloud of a pair, as released
    translation_dims: int = 2  # 3: heads also predict z, as released

    view_axes: bool = True  # look at each cloud along the line of sight: the bearing cannot matter
    sensor_context: bool = True  # tell the heads range, point count and the sensor's direction
    covariance: bool = True  # predict how sure the motion is

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        if self.composition not in COMPOSITIONS:
            raise ValueError(f"composition must be one of {', '.join(COMPOSITIONS)}, got {self.composition!r}")
        if self.translation_dims not in (2, 3):
            raise ValueError(f"translation_dims must be 2 or 3, got {self.translation_dims}")
        if self.n_bins < 2 or self.n_bins % 2:
            raise ValueError(f"n_bins must be even, so that half a turn is a whole number of bins, got {self.n_bins}")


class Encoding(NamedTuple):
    """What the network knows of each of b clouds; positions in sensor axes, relative to the cloud's own origin.

    Attributes:
        coarse_center: of the object, by T-CoarseNet [m].
        center: of the object, by T-FineNet [m].
        bearing: direction that angles are said relative to [rad]; the line of sight, or 0.
        angle: T-FineNet's class logits and residuals, relative to the bearing.
        heading: decoded from them, counter-clockwise about +z [rad].
        embedding: of the cloud in the object's axes.
    """

    coarse_center: Places
    center: Places
    bearing: Angles
    angle: AngleOutputs
    heading: Angles
    embedding: Float[Tensor, "b d"]

    def rows(self, index: slice) -> "Encoding":
        """Give the encodings of some of the clouds."""
        return Encoding(*(field[index] for field in self))


class Motion(NamedTuple):
    """The motion of each of b pairs; positions relative to the clouds' own origins.

    Attributes:
        center: the object's centre in the source cloud [m].
        moved_center: the same point of the object in the target cloud [m].
        turn: of the object [rad].
        early_turn: the part of it that T-FineNet's headings say [rad].
        angle: class logits and residuals of what remains of the turn.
        heading: of the object in the source: the axes of `precision` [rad].
        precision: six numbers of each pair, see `loss.precision_factor`; zeros where it is not predicted.
    """

    center: Places
    moved_center: Places
    turn: Angles
    early_turn: Angles
    angle: AngleOutputs
    heading: Angles
    precision: Float[Tensor, "b 6"]


class AlignNet(nn.Module):
    """Two clouds of one object in, its planar motion out.

    Source: Gross, Osep & Leibe, "AlignNet-3D", 3DV 2019, section 3, with one convention for angles: headings psi
    counter-clockwise about +z, a cloud in canonical pose is Rz(-psi) (x - center).
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        a, branches = architecture, 2 if architecture.branch_norms else 1
        context = CONTEXT if a.sensor_context else 0
        n_angle, dims = 2 * a.n_bins, a.translation_dims
        self.architecture = a
        self.coarse = PointEncoder(a.coarse, branches)
        self.coarse_head = Head(a.coarse[-1] + context, a.head, dims, a.dropout, branches)
        self.fine = PointEncoder(a.fine, branches)
        self.fine_head = Head(a.fine[-1] + context, a.head, dims + n_angle, a.dropout, branches)
        self.embedding = PointEncoder(a.embedding, branches)
        d_pair = 2 * (a.embedding[-1] + (context + 2 if context else 0))
        self.final_head = Head(d_pair, a.head, dims + n_angle, a.dropout)
        self.precision = nn.Linear(a.head[-1], 6) if a.covariance else None
        if self.precision is not None:
            nn.init.zeros_(self.precision.weight)
            nn.init.zeros_(self.precision.bias)

    def forward(self, source: Clouds, target: Clouds) -> tuple[Encoding, Encoding, Motion]:
        """Register b pairs of clouds; the encodings come with it for the losses of the early stages."""
        if self.architecture.branch_norms:
            encodings = self.encode(source, 0), self.encode(target, 1)
        else:
            both, half = self.encode(ragged.join(source, target)), source.n_seen.shape[0]
            encodings = both.rows(slice(None, half)), both.rows(slice(half, None))
        return *encodings, self.align(*encodings)

    def encode(self, clouds: Clouds, branch: int = 0) -> Encoding:
        """Do all that depends on one cloud only: T-CoarseNet, T-FineNet, and the embedding in canonical pose.

        Args:
            clouds: the batch.
            branch: whose batch norm is used, where each cloud of a pair has its own.
        """
        cloud, n_clouds = clouds.cloud, clouds.n_seen.shape[0]
        middle = ragged.mean(clouds.points, cloud, n_clouds)  # (b, 3)
        bearing, context = self._look(clouds, middle)  # (b,), (b, 0 or 2)
        points = ragged.in_axes(clouds.points, cloud, middle, bearing)  # (n, 3)

        # T-CoarseNet: from the mean of the points to the centre of the object.
        features = self.coarse(points, cloud, n_clouds, branch)  # (b, 256)
        s1 = self._in_space(self.coarse_head(torch.cat([features, context], dim=1), branch))  # (b, 3)

        # T-FineNet: the rest of the way, and the heading.
        features = self.fine(points - ragged.spread(s1, cloud), cloud, n_clouds, branch)  # (b, 512)
        offset, angle = self._split(self.fine_head(torch.cat([features, context], dim=1), branch))  # (b, 3), (b, 100)
        s2 = s1 + offset  # (b, 3)
        alpha = angles.decode(angle)  # (b,)

        # The cloud in canonical pose, and its embedding.
        canonical = ragged.in_axes(points, cloud, s2, alpha)  # (n, 3)
        features = self.embedding(canonical, cloud, n_clouds, branch)  # (b, 1024)
        heading = bearing + alpha
        return Encoding(
            coarse_center=middle + angles.rotate(s1, bearing),
            center=middle + angles.rotate(s2, bearing),
            bearing=bearing,
            angle=angle,
            heading=heading,
            embedding=torch.cat([features, self._seen_from(clouds, middle, heading), context], dim=1),
        )

    def align(self, source: Encoding, target: Encoding) -> Motion:
        """Compare two encodings: what T-FineNet's poses leave of the motion, composed with them."""
        hidden = self.final_head.hidden(torch.cat([source.embedding, target.embedding], dim=1))  # (b, 256)
        outputs = self.final_head.output(self.final_head.dropout(hidden)).float()  # (b, 2 + 100)
        shift, angle = self._split(outputs)  # (b, 3), (b, 100)
        if self.architecture.composition == "composed":  # T2 Tf T1^-1: the shift is in the target's canonical axes
            shift = angles.rotate(shift, target.heading)
        early_turn = target.heading - source.heading
        return Motion(
            center=source.center,
            moved_center=target.center + shift,
            turn=angles.wrap(early_turn + angles.decode(angle)),
            early_turn=early_turn,
            angle=angle,
            heading=source.heading,
            precision=shift.new_zeros(shift.shape[0], 6) if self.precision is None else self.precision(hidden).float(),
        )

    def _look(
        self, clouds: Clouds, middle: Float[Tensor, "b 3"]
    ) -> tuple[Float[Tensor, " b"], Float[Tensor, "b context"]]:
        """Give the bearing that angles are said relative to, and what the heads are told beside the points."""
        sight = middle[:, :2] - clouds.sensor  # (b, 2)
        bearing = torch.atan2(sight[:, 1], sight[:, 0])
        if not self.architecture.view_axes:
            bearing = torch.zeros_like(bearing)
        if not self.architecture.sensor_context:
            return bearing, sight[:, :0]
        distance = sight.norm(dim=1)
        context = torch.stack([torch.log1p(distance) - 3.0, torch.log1p(clouds.n_seen) - 5.0], dim=1)  # (b, 2)
        return bearing, context

    def _seen_from(
        self, clouds: Clouds, middle: Float[Tensor, "b 3"], heading: Float[Tensor, " b"]
    ) -> Float[Tensor, "b direction"]:
        """Give the direction of the sensor in the object's axes, as a unit vector."""
        sight = nn.functional.normalize(middle[:, :2] - clouds.sensor, dim=1)  # (b, 2)
        if not self.architecture.sensor_context:
            return sight[:, :0]
        return angles.rotate(-sight, -heading)

    def _split(self, outputs: Float[Tensor, "b outputs"]) -> tuple[Float[Tensor, "b 3"], Float[Tensor, "b bins2"]]:
        dims = self.architecture.translation_dims
        return self._in_space(outputs[:, :dims]), outputs[:, dims:]

    def _in_space(self, shift: Float[Tensor, "b d"]) -> Float[Tensor, "b 3"]:
        """Give a shift of the plane its z, which is 0."""
        return nn.functional.pad(shift, (0, 3 - shift.shape[1]))
