"""From the network's numbers to registration results: motions with covariances, priors, and doubts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from registration import planar, uncertainty
from registration.types import MotionPrior, PlanarCovariance, PlanarMotion, Points, RegistrationResult, Status

ROUNDING = 1e-8  # so that a covariance that claims certainty has an inverse [m^2, rad^2]

Numbers = Float64[np.ndarray, " n"]
Places = Float64[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True)
class Answers:
    """What the network says of n pairs, in float64; positions relative to each cloud's own mean.

    Attributes:
        motions: the object's centre in the source, in the target [m], and its turn [rad].
        covariance: of the motion (x, y, yaw) about the centre, in the axes of the clouds; NaN where the network
            predicts none.
    """

    motions: Float64[np.ndarray, "n 7"]
    covariance: Float64[np.ndarray, "n 3 3"]

    @property
    def center(self) -> Places:
        """The object's centre in the source [m]."""
        return self.motions[:, :3]

    @property
    def moved_center(self) -> Places:
        """The object's centre in the target [m]."""
        return self.motions[:, 3:6]

    @property
    def turn(self) -> Numbers:
        """By how much the object turned [rad]."""
        return self.motions[:, 6]

    def covariances_about(self, arms: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3 3"]:
        """Carry the covariances from the objects' centres to places so far from there, in the source [m]."""
        covariance = planar.transport_covariances(self.covariance, self.turn, arms)
        return 0.5 * (covariance + covariance.transpose(0, 2, 1)) + ROUNDING * np.eye(3)


def results(
    answers: Answers, clouds: Sequence[tuple[Points, Points]], sources: Places, targets: Places
) -> list[RegistrationResult]:
    """Make registration results of the answers.

    Args:
        answers: of n pairs.
        clouds: source and target of each.
        sources, targets: their means.
    """
    center, moved_center, turn = sources + answers.center, targets + answers.moved_center, answers.turn
    T = np.tile(np.eye(4), (len(turn), 1, 1))
    T[:, :3, :3] = _turns(turn)
    T[:, :3, 3] = moved_center - (T[:, :3, :3] @ center[:, :, None])[:, :, 0]
    T[:, 2, 3] = targets[:, 2] - sources[:, 2]
    covariance = answers.covariances_about(-answers.center[:, :2])
    return [
        RegistrationResult(
            T_target_source=T[k],
            source_centroid=sources[k],
            covariance=uncertainty.of_centroids(*clouds[k]) if np.isnan(covariance[k, 0, 0]) else covariance[k],
            status=Status.CONVERGED,
            rmse=float("nan"),
            n_pairs=0,
        )
        for k in range(len(turn))
    ]


def fused(found: RegistrationResult, prior: MotionPrior) -> RegistrationResult:
    """Weigh an answer and a prior by their covariances."""
    centroid, T = found.source_centroid, found.T_target_source
    motion = found.motion_about(centroid)
    off = prior.mean - motion
    off[2] = planar.wrap(float(off[2]))
    gain = found.covariance @ np.linalg.inv(found.covariance + prior.covariance)
    mean: PlanarMotion = motion + gain @ off
    covariance: PlanarCovariance = (np.eye(3) - gain) @ found.covariance
    return RegistrationResult(
        T_target_source=planar.to_transform(mean, centroid, z=float(T[2, 3])),
        source_centroid=centroid,
        covariance=0.5 * (covariance + covariance.T) + ROUNDING * np.eye(3),
        status=found.status,
        rmse=found.rmse,
        n_pairs=found.n_pairs,
    )


def _turns(angle: Numbers) -> Float64[np.ndarray, "n 3 3"]:
    """Make rotations about z."""
    R = np.zeros((len(angle), 3, 3))
    c, s = np.cos(angle), np.sin(angle)
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, -s, s, c, 1.0
    return R
