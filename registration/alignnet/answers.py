"""From the network's numbers to registration results: motions with covariances, priors, and doubts."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from registration import planar, uncertainty
from registration.alignnet import loss
from registration.alignnet.network import Motion
from registration.types import MotionPrior, PlanarCovariance, PlanarMotion, Point, Points, RegistrationResult, Status

ROUNDING = 1e-8  # so that a covariance that claims certainty has an inverse [m^2, rad^2]


@dataclass(frozen=True, slots=True)
class Answers:
    """What the network says of n pairs, in float64; positions relative to each cloud's own mean.

    Attributes:
        center, moved_center: the object's centre in the source, and in the target [m].
        turn: of the object [rad].
        covariance: of the motion (x, y, yaw) about the centre, in the axes of the clouds; NaN where the network
            predicts none.
    """

    center: Float64[np.ndarray, "n 3"]
    moved_center: Float64[np.ndarray, "n 3"]
    turn: Float64[np.ndarray, " n"]
    covariance: Float64[np.ndarray, "n 3 3"]


def read(motion: Motion, has_covariance: bool, scale: float) -> Answers:
    """Bring the network's outputs to numpy.

    Args:
        motion: of n pairs.
        has_covariance: whether the network was trained to say how sure it is.
        scale: factor of its covariances, from held-out pairs.
    """
    n = len(motion.turn)
    covariance = np.full((n, 3, 3), np.nan)
    if has_covariance:
        factor = loss.precision_factor(motion.precision.double())
        covariance = scale * torch.linalg.inv(factor.mT @ factor).numpy()
        turned = np.zeros((n, 3, 3))
        turned[:, 2, 2] = 1.0
        c, s = np.cos(motion.heading.double().numpy()), np.sin(motion.heading.double().numpy())
        turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 1, 1] = c, -s, s, c
        covariance = turned @ covariance @ turned.transpose(0, 2, 1)
    center, moved_center, turn = (f.double().numpy() for f in (motion.center, motion.moved_center, motion.turn))
    return Answers(center, moved_center, turn, covariance)


def result(
    answers: Answers, index: int, clouds: tuple[Points, Points], centroids: tuple[Point, Point], turn: float
) -> RegistrationResult:
    """Make a registration result of one answer.

    Args:
        answers: of all pairs.
        index: of the pair.
        clouds: source and target.
        centroids: their means.
        turn: of the object, made unambiguous [rad].
    """
    source, target = centroids
    center = source + answers.center[index]
    shift = target + answers.moved_center[index] - center
    about_center = np.array([shift[0], shift[1], turn])
    covariance = answers.covariance[index]
    if np.isnan(covariance).any():
        covariance = uncertainty.of_centroids(*clouds)
    else:
        covariance = planar.transport_covariance(covariance, turn, center[:2], source[:2])
    return RegistrationResult(
        T_target_source=planar.to_transform(about_center, center, z=float(target[2] - source[2])),
        source_centroid=source,
        covariance=0.5 * (covariance + covariance.T) + ROUNDING * np.eye(3),
        status=Status.CONVERGED,
        rmse=float("nan"),
        n_pairs=0,
    )


def nearest_turn(turn: float, expected: float) -> float:
    """Give the turn, or half a turn more or less, whichever is nearer to what is expected [rad]."""
    off = planar.wrap(turn - expected)
    return planar.wrap(expected + (off + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def fused(found: RegistrationResult, prior: MotionPrior) -> RegistrationResult:
    """Weigh an answer and a prior by their covariances."""
    motion = found.motion_about(found.source_centroid)
    off = prior.mean - motion
    off[2] = planar.wrap(float(off[2]))
    gain = found.covariance @ np.linalg.inv(found.covariance + prior.covariance)
    mean: PlanarMotion = motion + gain @ off
    covariance: PlanarCovariance = (np.eye(3) - gain) @ found.covariance
    z = float(
        (found.T_target_source[:3, :3] @ found.source_centroid + found.T_target_source[:3, 3] - found.source_centroid)[
            2
        ]
    )
    return RegistrationResult(
        T_target_source=planar.to_transform(mean, found.source_centroid, z),
        source_centroid=found.source_centroid,
        covariance=0.5 * (covariance + covariance.T) + ROUNDING * np.eye(3),
        status=found.status,
        rmse=found.rmse,
        n_pairs=found.n_pairs,
    )
