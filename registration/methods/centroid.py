"""The shift between the clouds' means: the simplest registration, and the start of most others."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from registration import se3, uncertainty
from registration.method import PairMethod, nothing_known
from registration.types import MotionPrior, Points, RegistrationResult, Status


@dataclass(frozen=True)
class Centroid(PairMethod):
    """Move the mean of the source onto the mean of the target; never turns.

    The baseline of Held et al., "Combining 3D shape, color, and motion for robust anytime tracking", RSS 2014.
    """

    name: ClassVar[str] = "centroid"

    def prepare_cloud(self, points: Points) -> Points:
        """Keep the points."""
        return points

    def align_pair(self, source: Points, target: Points, prior: MotionPrior | None) -> RegistrationResult:
        """Subtract the means; the prior is not used."""
        if len(source) == 0 or len(target) == 0:
            center = source.mean(axis=0) if len(source) else np.zeros(3)
            return nothing_known(center, Status.TOO_FEW_POINTS)
        shift = target.mean(axis=0) - source.mean(axis=0)
        return RegistrationResult(
            T_target_source=se3.pose(np.eye(3), shift),
            source_centroid=source.mean(axis=0),
            covariance=uncertainty.of_centroids(source, target),
            status=Status.CONVERGED,
            rmse=float("nan"),
            n_pairs=0,
        )
