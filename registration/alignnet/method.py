"""The network as a registration method: numpy clouds in, planar motions with covariances out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import ArrayLike

from registration.alignnet import answers, checkpoint, inference
from registration.alignnet.answers import Answers
from registration.alignnet.network import AlignNet, Encoding
from registration.alignnet.packing import pack
from registration.belief import believe
from registration.method import PairMethod, check_cloud, nothing_known
from registration.types import MotionPrior, Point, Points, RegistrationResult, Status

BELIEVED_TURN = 0.1  # standard deviation of the turn where the network does not know it [rad]
DOUBT = 2.0  # factor of the centroids' covariance where the network was asked and does not know


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud and what the network knows of it.

    Attributes:
        points: as they came [m].
        centroid: their mean [m]; zero for an empty cloud.
        encodings: as a source, and as a target; relative to the centroid; none where there are too few points.
    """

    points: Points
    centroid: Point
    encodings: tuple[Encoding, Encoding] | None


@dataclass(frozen=True)
class LearnedRegistration(PairMethod):
    """Ask AlignNet-3D: each cloud is encoded once, and what it takes to compare two encodings is small.

    A prior is fused with the answer, each weighted by its covariance.  Where the network is not sure of the motion,
    or contradicts the clouds, the centroids' motion (or the prior's) stands in, with the status NOT_CONVERGED.

    Source: Gross, Osep & Leibe, "AlignNet-3D: Fast point cloud registration of partially observed objects",
    3DV 2019.
    """

    name: ClassVar[str]
    wants_sensors: ClassVar[bool] = True

    weights: str = ""  # path of a weights file; empty: those that come with the package
    precision: str = "auto"  # float32, bfloat16; auto: bfloat16 where the CPU knows it
    max_points: int = 512  # of a cloud that are looked at, evenly out of all
    min_points: int = 3  # smaller clouds say nothing
    max_spread: float = 1.5  # standard deviation of the shift beyond which the network does not know [m]
    max_offset: float = 8.0  # the object's centre cannot be farther than this from the mean of its points [m]
    fold_turn: bool = True  # between two clouds an object turns by less than 90 degrees; False: front and back differ

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, and load the weights.

        Raises:
            WeightsError: there are none, or they cannot be used.
        """
        if not 1 <= self.min_points <= self.max_points:
            raise ValueError(f"expected 1 <= min_points <= max_points, got {self.min_points} and {self.max_points}")
        self._load()

    def prepare_cloud(self, points: Points) -> Cloud:
        """Encode one cloud, seen from the origin."""
        return self.prepare([points])[0]

    def prepare(self, clouds: Sequence[ArrayLike], sensors: Sequence[ArrayLike] | None = None) -> list[Cloud]:
        """Check each (N, 3) cloud, and encode all of them at once.

        Args:
            clouds: in any axes with z up, if both clouds of a pair share them [m].
            sensors: where each cloud was seen from (x, y), in the same axes [m]; None: from the origin.

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
            ValueError: there are sensors, but not one a cloud.
        """
        checked = [check_cloud(cloud) for cloud in clouds]
        places = np.zeros((len(checked), 2)) if sensors is None else np.asarray(sensors, dtype=np.float64)
        if places.size == 0:  # of no clouds
            places = places.reshape(0, 2)
        if places.shape != (len(checked), 2):
            raise ValueError(f"expected the sensor's (x, y) for each of {len(checked)} clouds, got {places.shape}")
        prepared = [Cloud(cloud, cloud.mean(axis=0) if len(cloud) else np.zeros(3), None) for cloud in checked]
        told = [k for k, cloud in enumerate(checked) if len(cloud) >= self.min_points]
        if told:
            offsets = [checked[k] - prepared[k].centroid for k in told]
            sensors_seen = np.stack([places[k] - prepared[k].centroid[:2] for k in told])
            for k, encodings in zip(told, self._encode(offsets, sensors_seen), strict=True):
                prepared[k] = replace(prepared[k], encodings=encodings)
        return prepared

    def align(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Compare all pairs at once.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        if priors is None:
            priors = [None] * len(pairs)
        if len(priors) != len(pairs):
            raise ValueError(f"align got {len(pairs)} pairs but {len(priors)} priors; expected one a pair")
        told = [pair for pair in pairs if pair[0].encodings is not None and pair[1].encodings is not None]
        found, index = self._compare(told) if told else None, iter(range(len(told)))
        return [
            self._result(pair, prior, found, next(index))
            if found is not None and pair[0].encodings is not None and pair[1].encodings is not None
            else _fallback(pair, prior, Status.TOO_FEW_POINTS)
            for pair, prior in zip(pairs, priors, strict=True)
        ]

    def align_pair(self, source: Cloud, target: Cloud, prior: MotionPrior | None) -> RegistrationResult:
        """Compare one pair."""
        return self.align([(source, target)], [prior])[0]

    def network(self) -> AlignNet:
        """Give the network that encodes sources, folded for inference."""
        return self._load()[0][0]

    def _load(self) -> tuple[list[AlignNet], checkpoint.About]:
        path = Path(self.weights) if self.weights else checkpoint.shipped(self.name)
        return inference.load(path, self.precision)

    def _encode(self, clouds: list[Points], sensors: np.ndarray) -> list[tuple[Encoding, Encoding]]:
        networks, _ = self._load()
        batch = pack(clouds, sensors, self.max_points)
        with torch.inference_mode():
            by_branch = [network.encode(batch) for network in networks]
        as_source, as_target = by_branch[0], by_branch[-1]
        rows = [slice(k, k + 1) for k in range(len(clouds))]
        return [(as_source.rows(row), as_target.rows(row)) for row in rows]

    def _compare(self, pairs: Sequence[tuple[Cloud, Cloud]]) -> Answers:
        networks, about = self._load()
        sources = inference.stack([source.encodings[0] for source, _ in pairs if source.encodings])
        targets = inference.stack([target.encodings[1] for _, target in pairs if target.encodings])
        with torch.inference_mode():
            motion = networks[0].align(sources, targets)
        return answers.read(motion, about.architecture.covariance, about.covariance_scale)

    def _result(
        self, pair: tuple[Cloud, Cloud], prior: MotionPrior | None, found: Answers, index: int
    ) -> RegistrationResult:
        source, target = pair
        turn = float(found.turn[index])
        if self.fold_turn:
            turn = answers.nearest_turn(turn, 0.0 if prior is None else float(prior.mean[2]))
        result = answers.result(found, index, (source.points, target.points), (source.centroid, target.centroid), turn)
        offset = max(np.abs(found.center[index, :2]).max(), np.abs(found.moved_center[index, :2]).max())
        spread = np.sqrt(np.linalg.eigvalsh(found.covariance[index, :2, :2]).max()) if self._knows_spread() else 0.0
        if offset > self.max_offset or spread > self.max_spread:
            return _fallback(pair, prior, Status.NOT_CONVERGED)
        return result if prior is None else answers.fused(result, prior)

    def _knows_spread(self) -> bool:
        return self._load()[1].architecture.covariance


class AlignNetCars(LearnedRegistration):
    """The network for cars and vans."""

    name: ClassVar[str] = "alignnet"


class AlignNetPersons(LearnedRegistration):
    """The network for cars and persons."""

    name: ClassVar[str] = "alignnet-persons"


def _fallback(pair: tuple[Cloud, Cloud], prior: MotionPrior | None, status: Status) -> RegistrationResult:
    """Give the centroids' motion, or the prior's, where the network does not know."""
    source, target = pair
    if len(source.points) == 0 or len(target.points) == 0:
        return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
    belief = believe(source.points, target.points, prior, BELIEVED_TURN)
    return belief.result(status, DOUBT if status is Status.NOT_CONVERGED and prior is None else 1.0)
