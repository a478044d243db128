"""What the iterative methods share: prepared clouds, starts, and all pairs of a frame aligned in one call."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from registration import icp_kernels, neighbours, uncertainty
from registration.method import PairMethod, nothing_known
from registration.neighbours import Grid
from registration.types import MotionPrior, Point, Points, RegistrationResult, Status, Transform

STATUS = {
    icp_kernels.CONVERGED: Status.CONVERGED,
    icp_kernels.NOT_CONVERGED: Status.NOT_CONVERGED,
    icp_kernels.NO_OVERLAP: Status.NO_OVERLAP,
    icp_kernels.TOO_FEW_POINTS: Status.TOO_FEW_POINTS,
    icp_kernels.EMPTY: Status.TOO_FEW_POINTS,
}


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud with what every alignment of it needs.

    Attributes:
        points: as they came [m].
        centroid: their mean [m]; zero for an empty cloud.
        scatter: horizontal covariance of the points: xx, xy, yy [m^2].
        grid: the points relative to the centroid, in cells: small numbers, wherever on earth the cloud is.
    """

    points: Points
    centroid: Point
    scatter: tuple[float, float, float]
    grid: Grid


class Clouds(NamedTuple):
    """Many clouds one after the other, each about its own centroid.

    Attributes:
        points: cloud k is rows begin[k] to begin[k + 1] (n, 3) [m].
        begin: see there.
        centroids: of each; zero for an empty one [m].
    """

    points: Points
    begin: Int64[np.ndarray, " _"]
    centroids: Float64[np.ndarray, "k 3"]

    @property
    def sizes(self) -> Int64[np.ndarray, " k"]:
        """Give the number of points of each cloud."""
        return np.diff(self.begin)


class BatchMethod(PairMethod):
    """A method that aligns all pairs of a frame in one call; its author writes `prepare_cloud` and `align_batch`."""

    @abstractmethod
    def align_batch(
        self, pairs: Sequence[tuple[Any, Any]], priors: Sequence[MotionPrior | None]
    ) -> list[RegistrationResult]:
        """Register prepared pairs, at least one; there is a prior, or None, for each."""

    def align_pair(self, source: Any, target: Any, prior: MotionPrior | None) -> RegistrationResult:
        """Register a batch of one."""
        return self.align_batch([(source, target)], [prior])[0]

    def align(
        self, pairs: Sequence[tuple[Any, Any]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Register prepared (source, target) pairs in one call.

        A subclass with an `align_pair` of its own is asked pair by pair instead.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        is_own = type(self).align_pair is BatchMethod.align_pair
        if not is_own or not pairs or (priors is not None and len(priors) != len(pairs)):
            return super().align(pairs, priors)
        return self.align_batch(pairs, priors if priors is not None else [None] * len(pairs))


def prepare(points: Points, cell: float) -> Cloud:
    """Centre a cloud and sort it into cells of side `cell` [m]."""
    offsets, own = np.array(points, order="C"), np.array([0, len(points)])
    centroids, scatters = np.empty((2, 1, 3))
    icp_kernels.center_all(offsets, own, centroids, scatters)
    xx, xy, yy = scatters[0].tolist()
    return Cloud(points, centroids[0], (xx, xy, yy), neighbours.build_grid(offsets, cell))


def centered(points: Points, begin: Int64[np.ndarray, " _"]) -> Clouds:
    """Move clouds that lie one after the other to their centroids, in place."""
    centroids, scatters = np.empty((2, len(begin) - 1, 3))
    icp_kernels.center_all(points, begin, centroids, scatters)
    return Clouds(points, begin, centroids)


def starts(pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None]) -> Float64[np.ndarray, "n 3"]:
    """Give each pair's start (x, y, yaw) between the clouds about their centroids [m, m, rad].

    Zero brings the centroids together; a prior's mean takes its place where there is one.
    """
    motions = np.zeros((len(pairs), 3))
    for k, ((source, target), prior) in enumerate(zip(pairs, priors, strict=True)):
        if prior is not None:
            motions[k, :2] = prior.mean[:2] - (target.centroid - source.centroid)[:2]
            motions[k, 2] = prior.mean[2]
    return motions


def transform(motion: Sequence[float], source: Cloud, target: Cloud) -> Transform:
    """Turn a motion (x, y, yaw) between the clouds about their centroids into T_target_source.

    Its shift in z is that between the centroids.
    """
    x, y, yaw = motion
    c, s = math.cos(yaw), math.sin(yaw)
    a, b, height = source.centroid.tolist()
    p, q, target_height = target.centroid.tolist()
    return np.array(
        [
            [c, -s, 0.0, p + x - (c * a - s * b)],
            [s, c, 0.0, q + y - (s * a + c * b)],
            [0.0, 0.0, 1.0, target_height - height],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def fallback(source: Cloud, target: Cloud, T_target_source: Transform, status: Status) -> RegistrationResult:
    """Give a best guess that is no better than the centroids it comes from; of empty clouds nothing is known."""
    if len(source.points) == 0 or len(target.points) == 0:
        return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
    return RegistrationResult(
        T_target_source=T_target_source,
        source_centroid=source.centroid,
        covariance=uncertainty.of_centroids(source.points, target.points),
        status=status,
        rmse=float("nan"),
        n_pairs=0,
    )
