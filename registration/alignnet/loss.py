"""What training minimises: Huber distances of centres and motions, classified angles, and the motion's likelihood."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from registration.alignnet import angles
from registration.alignnet.network import Encoding, Motion

HEADINGS = ("sample_min", "batch_min", "batch_max", "full")
DEGREES = 4.0  # of freedom of the Student t that errors are taken to follow: its tails forgive outliers


@dataclass(frozen=True)
class LossSettings:
    """Weights of the parts; the defaults are the published ones, but for the covariance, which the paper lacks."""

    heading: str = "sample_min"  # which of the two headings of an axis counts in the angles; full: there is but one
    heading_axis: bool = True  # half a turn more or less is no error of a motion
    early: float = 0.5  # weight of the stages before the last
    angle: float = 1.0  # weight of the angles
    residual: float = 20.0  # weight of an angle's residual beside its class
    translation: float = 1.0  # weight of the translations
    unit: float = 1.0  # of lengths in the Huber distances [m]: beyond it (2 of it at last) they grow linearly
    covariance: float = 0.1  # weight of the likelihood of the motion's error

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        if self.heading not in HEADINGS:
            raise ValueError(f"heading must be one of {', '.join(HEADINGS)}, got {self.heading!r}")
        if not self.unit > 0.0:
            raise ValueError(f"unit must be positive [m], got {self.unit}")


class Truth(NamedTuple):
    """What is known of b clouds: the object's centre relative to the cloud's origin [m] and its heading [rad]."""

    center: Float[Tensor, "b 3"]
    heading: Float[Tensor, " b"]


def total(
    encodings: tuple[Encoding, Encoding], motion: Motion, truths: tuple[Truth, Truth], settings: LossSettings
) -> tuple[Float[Tensor, ""], dict[str, Float[Tensor, ""]]]:
    """Sum up the parts of the loss of a batch of pairs; also give them one by one, unweighted.

    Source: AlignNet-3D, section 3; released code, tp8.py, 304-354.
    """
    pairs = list(zip(encodings, truths, strict=True))
    source, target = truths
    parts = {
        "coarse": _mean([_distance(e.coarse_center, t.center, settings.unit) for e, t in pairs]),
        "fine": _mean([_distance(e.center, t.center, settings.unit) for e, t in pairs]),
        "final": _final_distance(motion, source, target, settings),
        "heading": _mean([angle_loss(e.angle, t.heading - e.bearing, settings) for e, t in pairs]),
        "turn": angle_loss(motion.angle, target.heading - source.heading - motion.early_turn, settings),
        "covariance": negative_log_likelihood(motion, source, target, settings.heading_axis),
    }
    early = settings.early
    translation = early * (parts["coarse"] + parts["fine"]) + parts["final"]
    angle = early * parts["heading"] + parts["turn"]
    loss = settings.translation * translation + settings.angle * angle + settings.covariance * parts["covariance"]
    return loss, {name: part.detach() for name, part in parts.items()}


def angle_loss(
    outputs: Float[Tensor, "b bins2"], angle: Float[Tensor, " b"], settings: LossSettings
) -> Float[Tensor, ""]:
    """Cross entropy of the true bin, and Huber distance of the residual in it.

    Of an axis' two headings the smaller loss counts, sample by sample (the paper's words); `batch_max` keeps the
    larger of the two batch means, as the released code does.
    """
    one = _angle_losses(outputs, angle, settings.residual)  # (b,)
    if settings.heading == "full":
        return one.mean()
    other = _angle_losses(outputs, angle + math.pi, settings.residual)  # (b,)
    if settings.heading == "sample_min":
        return torch.minimum(one, other).mean()
    choose = torch.minimum if settings.heading == "batch_min" else torch.maximum
    return choose(one.mean(), other.mean())


def motion_error(motion: Motion, source: Truth, target: Truth, heading_axis: bool) -> Float[Tensor, "b 3"]:
    """Give how far the true motion is from the predicted one, about the predicted centre: (x, y, yaw) [m, m, rad].

    In the axes of the source object's predicted heading.  Where only the axis of a heading counts, half a turn
    more or less is no error.
    """
    true_turn = target.heading - source.heading
    turn = angles.wrap(true_turn - motion.turn)
    if heading_axis:
        turn = angles.fold(turn)
    arm = angles.rotate(motion.center - source.center, true_turn)  # (b, 3)
    shift = (target.center + arm - motion.moved_center)[:, :2]
    return torch.cat([angles.rotate(shift, -motion.heading), turn[:, None]], dim=1)


def displacement_error(motion: Motion, source: Truth, target: Truth, heading_axis: bool) -> Float[Tensor, "b 3"]:
    """Give how far from its true place the motion moves the object's true centre [m]."""
    turn = motion.turn
    if heading_axis:  # the turn of which the axis is the same, and the nearest to the truth
        true_turn = target.heading - source.heading
        turn = true_turn + angles.fold(turn - true_turn)
    arm = angles.rotate(source.center - motion.center, turn)
    return motion.moved_center + arm - target.center


def negative_log_likelihood(motion: Motion, source: Truth, target: Truth, heading_axis: bool) -> Float[Tensor, ""]:
    """Score the predicted precision of the motion by its error, which this part does not train."""
    error = motion_error(motion, source, target, heading_axis).detach()  # (b, 3)
    factor = precision_factor(motion.precision)  # (b, 3, 3)
    whitened = torch.einsum("bij,bj->bi", factor, error)
    log_scale = torch.diagonal(factor, dim1=1, dim2=2).log().sum(dim=1)
    square = (whitened * whitened).sum(dim=1)
    return (0.5 * (DEGREES + 3.0) * torch.log1p(square / DEGREES) - log_scale).mean()


def precision_factor(numbers: Float[Tensor, "b 6"]) -> Float[Tensor, "b 3 3"]:
    """Make the upper triangular U of a precision U'U over (x, y, yaw) from six numbers.

    The first three are the logarithms of its diagonal in units of 10/m, 10/m, 10/rad, the others lie beside it.
    """
    xx, yy, tt = (10.0 * torch.exp(numbers[:, :3].clamp(-6.0, 6.0))).unbind(dim=1)
    xy, xt, yt = (10.0 * numbers[:, 3:]).unbind(dim=1)
    none = torch.zeros_like(xx)
    return torch.stack([xx, xy, xt, none, yy, yt, none, none, tt], dim=1).reshape(-1, 3, 3)


def _mean(values: list[Tensor]) -> Tensor:
    return torch.stack(values).mean()


def _distance(predicted: Tensor, true: Tensor, unit: float, delta: float = 1.0) -> Tensor:
    """Average the Huber distance over batch and coordinates of the plane."""
    off = (predicted - true)[:, :2] / unit
    return functional.huber_loss(off, torch.zeros_like(off), delta=delta)


def _final_distance(motion: Motion, source: Truth, target: Truth, settings: LossSettings) -> Tensor:
    off = displacement_error(motion, source, target, settings.heading_axis)
    return _distance(off, torch.zeros_like(off), settings.unit, delta=2.0)


def _angle_losses(outputs: Tensor, angle: Tensor, weight: float) -> Tensor:
    logits, residuals = outputs.chunk(2, dim=1)  # (b, bins) each
    bins, residual = angles.encode(angle, logits.shape[1])
    of_bin = functional.cross_entropy(logits, bins, reduction="none")  # (b,)
    off = residuals.gather(1, bins[:, None])[:, 0] - residual
    return of_bin + weight * functional.huber_loss(off, torch.zeros_like(off), reduction="none")
