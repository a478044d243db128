"""What a method believes of the motion before it compares shapes: where to start, and what to fall back on."""

from dataclasses import dataclass

import numpy as np

from registration import planar, se3, uncertainty
from registration.types import (
    MotionPrior,
    PlanarCovariance,
    Point,
    Points,
    RegistrationResult,
    Status,
    Transform,
)


@dataclass(frozen=True, slots=True)
class Belief:
    """A motion, and how sure it is before the clouds are compared.

    Attributes:
        T_target_source: the most likely motion; its shift in z is that between the centroids.
        source_centroid: the centre that `covariance` refers to [m].
        covariance: of (x, y, yaw) about the source centroid [m, m, rad].
    """

    T_target_source: Transform
    source_centroid: Point
    covariance: PlanarCovariance

    def distance_to(self, T_target_source: Transform) -> float:
        """Measure how far off another motion is: squared Mahalanobis distance over (x, y, yaw)."""
        off = planar.motion_about(T_target_source, self.source_centroid)
        off -= planar.motion_about(self.T_target_source, self.source_centroid)
        off[2] = planar.wrap(float(off[2]))
        return float(off @ np.linalg.solve(self.covariance, off))

    def result(self, status: Status, doubt: float = 1.0) -> RegistrationResult:
        """Give the belief as the best guess, and the reason why there is no better one.

        Args:
            status: the reason.
            doubt: factor of the covariance, where that reason speaks against the belief too.
        """
        return RegistrationResult(
            T_target_source=self.T_target_source,
            source_centroid=self.source_centroid,
            covariance=doubt * self.covariance,
            status=status,
            rmse=float("nan"),
            n_pairs=0,
        )


def believe(source: Points, target: Points, prior: MotionPrior | None, turn: float) -> Belief:
    """Expect what the prior says, or else the shift between the centroids and hardly any turn.

    Args:
        source: not empty [m].
        target: not empty [m].
        prior: of the caller.
        turn: standard deviation of the turn where there is no prior [rad].
    """
    centroid = source.mean(axis=0)
    shift = target.mean(axis=0) - centroid
    if prior is not None:
        T = planar.to_transform(prior.mean, centroid, z=float(shift[2]))
        return Belief(T, centroid, prior.covariance + _ROUNDING * np.eye(3))
    covariance = uncertainty.of_centroids(source, target)
    covariance[2, 2] = turn**2
    return Belief(se3.pose(np.eye(3), shift), centroid, covariance)


_ROUNDING = 1e-8  # so that a prior that claims certainty has an inverse [m^2, rad^2]
