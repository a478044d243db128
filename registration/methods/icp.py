"""Point-to-point ICP in the plane: pair nearest neighbours, align the pairs, repeat."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Int64
from scipy.spatial import KDTree

from registration import planar, se3, uncertainty
from registration.method import PairMethod, nothing_known
from registration.types import MotionPrior, Point, Points, RegistrationResult, Status, Transform


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud with what every alignment of it needs."""

    points: Points
    tree: KDTree
    centroid: Point


@dataclass(frozen=True, slots=True)
class Pairing:
    """Which source points found a partner within reach, and how far off they are."""

    source: Int64[np.ndarray, " n"]
    target: Int64[np.ndarray, " n"]
    fitness: float
    rmse: float

    def __len__(self) -> int:
        return len(self.source)


@dataclass(frozen=True)
class PointToPointICP(PairMethod):
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

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        if not self.max_distance > 0.0:
            raise ValueError(f"max_distance must be positive [m], got {self.max_distance}")
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations must be at least 1, got {self.max_iterations}")

    def prepare_cloud(self, points: Points) -> Cloud:
        """Build the search tree."""
        return Cloud(points, KDTree(points), points.mean(axis=0) if len(points) else np.zeros(3))

    def align_pair(self, source: Cloud, target: Cloud, prior: MotionPrior | None) -> RegistrationResult:
        """Iterate from the start to the nearest minimum."""
        if len(source.points) == 0 or len(target.points) == 0:
            return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
        T = _start(source, target, prior)
        if min(len(source.points), len(target.points)) < self.min_points:
            return _fallback(source, target, T, Status.TOO_FEW_POINTS)
        pairing, is_settled, n_iterations = self._pair(T, source, target), False, 0
        while not is_settled and n_iterations < self.max_iterations:
            if len(pairing) < self.min_points:
                return _fallback(source, target, T, Status.NO_OVERLAP)
            moved = se3.transform(T, source.points[pairing.source])
            T = planar.align_pairs(moved, target.points[pairing.target]) @ T
            previous, pairing = pairing, self._pair(T, source, target)
            is_settled = _is_settled(previous, pairing, self.tolerance)
            n_iterations += 1
        return RegistrationResult(
            T_target_source=T,
            source_centroid=source.centroid,
            covariance=uncertainty.of_point_pairs(source.points, target.points, len(pairing), is_settled),
            status=Status.CONVERGED if is_settled else Status.NOT_CONVERGED,
            rmse=pairing.rmse,
            n_pairs=len(pairing),
            n_iterations=n_iterations,
        )

    def _pair(self, T: Transform, source: Cloud, target: Cloud) -> Pairing:
        """Find each source point's nearest target point within `max_distance`."""
        distance, nearest = target.tree.query(se3.transform(T, source.points), distance_upper_bound=self.max_distance)
        paired = np.flatnonzero(np.isfinite(distance))
        rmse = float(np.sqrt(np.mean(distance[paired] ** 2))) if len(paired) else float("nan")
        return Pairing(paired, nearest[paired], len(paired) / len(source.points), rmse)


def _start(source: Cloud, target: Cloud, prior: MotionPrior | None) -> Transform:
    shift = target.centroid - source.centroid
    if prior is None:
        return se3.pose(np.eye(3), shift)
    return planar.to_transform(prior.mean, source.centroid, z=float(shift[2]))


def _is_settled(before: Pairing, after: Pairing, tolerance: float) -> bool:
    return abs(after.fitness - before.fitness) < tolerance and abs(after.rmse - before.rmse) < tolerance


def _fallback(source: Cloud, target: Cloud, T: Transform, status: Status) -> RegistrationResult:
    """Give the start as the best guess: no better than the centroids it comes from."""
    return RegistrationResult(
        T_target_source=T,
        source_centroid=source.centroid,
        covariance=uncertainty.of_centroids(source.points, target.points),
        status=status,
        rmse=float("nan"),
        n_pairs=0,
    )
