"""Point-to-point ICP in the plane: pair nearest neighbours, align the pairs, repeat."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from registration import icp_kernels, iterative, neighbours, uncertainty
from registration.iterative import BatchMethod, Cloud
from registration.types import MotionPrior, Points, RegistrationResult, Status


@dataclass(frozen=True)
class PointToPointICP(BatchMethod):
    """Pair each point with its nearest neighbour in 3-D, align the pairs in the plane, repeat.

    Starts from the shift between the centroids (or from the prior's mean); the shift in z of the start is kept.
    Ends when neither the share of paired points nor their RMSE changes any more.

    Source: Besl & McKay, "A method for registration of 3-D shapes", PAMI 14(2), 1992; with the planar update,
    start and settings of the ICP baseline of AlignNet-3D (3DV 2019).
    """

    name: ClassVar[str] = "icp"

    max_distance: float = 0.1  # points farther apart than this make no pair [m]
    max_iterations: int = 30
    tolerance: float = 1e-6  # stop when fitness and RMSE [m] both change less than this
    min_points: int = 3  # smaller clouds, and fewer pairs, say nothing of the turn
    threads: int = 1  # that align the pairs of a batch

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        if not self.max_distance > 0.0:
            raise ValueError(f"max_distance must be positive [m], got {self.max_distance}")
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations must be at least 1, got {self.max_iterations}")

    def prepare_cloud(self, points: Points) -> Cloud:
        """Sort the points into cells."""
        return iterative.prepare(points, self.max_distance)

    def align_batch(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None]
    ) -> list[RegistrationResult]:
        """Iterate each pair from its start to the nearest minimum."""
        motions, outcomes = iterative.starts(pairs, priors), np.empty((len(pairs), 4))
        sources, begin = neighbours.pack_arrays([source.grid.points for source, _ in pairs])
        targets = neighbours.pack([target.grid for _, target in pairs])
        limits = (float(self.max_distance), self.max_iterations, float(self.tolerance), self.min_points)
        neighbours.share_out(
            lambda a, b: icp_kernels.point_to_point(a, b, sources, begin, *targets, limits, motions, outcomes),
            len(pairs),
            self.threads,
        )
        answers = zip(pairs, motions.tolist(), outcomes.tolist(), strict=True)
        return [_result(source, target, motion, outcome) for (source, target), motion, outcome in answers]


def _result(source: Cloud, target: Cloud, motion: list[float], outcome: list[float]) -> RegistrationResult:
    status, n_pairs = iterative.STATUS[int(outcome[0])], int(outcome[1])
    T = iterative.transform(motion, source, target)
    if status not in (Status.CONVERGED, Status.NOT_CONVERGED):
        return iterative.fallback(source, target, T, status)
    is_settled = status is Status.CONVERGED
    return RegistrationResult(
        T_target_source=T,
        source_centroid=source.centroid,
        covariance=uncertainty.of_point_pairs(
            source.scatter, len(source.points), len(target.points), n_pairs, is_settled
        ),
        status=status,
        rmse=outcome[2],
        n_pairs=n_pairs,
        n_iterations=int(outcome[3]),
    )
