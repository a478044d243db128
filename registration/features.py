"""What the global methods share: a cloud's geometric features, correspondences by them, and the test of an answer.

Features are Open3D's fast point feature histograms: Rusu, Blodow & Beetz, "Fast point feature histograms (FPFH)
for 3D registration", ICRA 2009.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from registration import se3
from registration.belief import Belief
from registration.libraries import load_open3d
from registration.types import Point, Points, Transform

NEAR = 12.0  # squared Mahalanobis distance that 99 % of motions keep from the belief they are drawn from

Correspondences = Int64[np.ndarray, "n 2"]  # rows of (source row, target row) in the thinned clouds


@dataclass(frozen=True)
class FeatureSettings:
    """How a cloud is thinned and described: the values of AlignNet-3D's baselines, wider where a cloud is sparse.

    Within 0.1 m a car beyond some 20 m shows a single scan ring, and a normal estimated from that is arbitrary.
    Both radii therefore grow by one factor until the smaller one holds `sparse_neighbours` at the median point.
    """

    voxel: float = 0.05  # side of the cubes that are thinned to one point each [m]
    normal_radius: float = 0.10  # [m]
    normal_neighbours: int = 30  # at most
    feature_radius: float = 0.25  # [m]
    feature_neighbours: int = 100  # at most
    sparse_neighbours: int = 15  # that the normals' radius holds at the median point; 0: radii are kept

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        for field, value in vars(self).items():
            if not value > 0 and field != "sparse_neighbours":
                raise ValueError(f"features.{field} must be positive, got {value}")
        if self.sparse_neighbours < 0:
            raise ValueError(f"features.sparse_neighbours must be 0 or more, got {self.sparse_neighbours}")


@dataclass(frozen=True, slots=True)
class FeatureCloud:
    """A cloud with what every alignment of it needs.

    Attributes:
        points: as they came [m].
        origin: their mean, or zero for an empty cloud [m]; all below is relative to it.
        thinned: one point per voxel [m].
        tree: of the thinned points.
        features: open3d.pipelines.registration.Feature, one column per thinned point; None for an empty cloud.
    """

    points: Points
    origin: Point
    thinned: Points
    tree: KDTree
    features: Any


def describe(points: Points, settings: FeatureSettings, needed_by: str) -> FeatureCloud:
    """Thin a cloud, estimate normals, compute FPFH."""
    if len(points) == 0:
        return FeatureCloud(points, np.zeros(3), points, KDTree(points), None)
    open3d = load_open3d(needed_by)
    search = open3d.geometry.KDTreeSearchParamHybrid
    origin = points.mean(axis=0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points - origin))
    cloud = cloud.voxel_down_sample(settings.voxel)
    thinned = np.array(cloud.points)
    tree = KDTree(thinned)
    wider = _widening(tree, settings)
    cloud.estimate_normals(search(wider * settings.normal_radius, settings.normal_neighbours))
    features = open3d.pipelines.registration.compute_fpfh_feature(
        cloud, search(wider * settings.feature_radius, settings.feature_neighbours)
    )
    return FeatureCloud(points, origin, thinned, tree, features)


def _widening(tree: KDTree, settings: FeatureSettings) -> float:
    """Give the factor of both radii; 1 for clouds that are dense, or smaller than the neighbours asked for."""
    k = settings.sparse_neighbours
    if k == 0 or tree.n <= k:
        return 1.0
    distance, _ = tree.query(tree.data, k=[k + 1])  # the nearest is the point itself
    return max(1.0, float(np.median(distance)) / settings.normal_radius)


def correspond(
    source: FeatureCloud, target: FeatureCloud, height_tolerance: float, needed_by: str
) -> tuple[Correspondences, float]:
    """Pair each source point with the target point of the nearest feature, where all agree on one lift.

    A planar motion lifts all points alike, so pairs whose difference in z is not the most common one, within
    `height_tolerance` [m], are wrong.

    Returns:
        the pairs kept, and their median lift from the source's to the target's origin [m].
    """
    registration = load_open3d(needed_by).pipelines.registration
    pairs = np.asarray(registration.correspondences_from_features(source.features, target.features), dtype=np.int64)
    lift = target.thinned[pairs[:, 1], 2] - source.thinned[pairs[:, 0], 2]
    common = most_common(lift, height_tolerance)
    kept = np.abs(lift - common) <= height_tolerance
    return pairs[kept], common


def most_common(values: Float64[np.ndarray, " n"], tolerance: float) -> float:
    """Find the median of the fullest window of half width `tolerance`; 0 for no values at all."""
    if len(values) == 0:
        return 0.0
    ordered = np.sort(values)
    n_within = np.searchsorted(ordered, ordered + 2.0 * tolerance, side="right") - np.arange(len(ordered))
    first = int(np.argmax(n_within))
    return float(np.median(ordered[first : first + n_within[first]]))


@dataclass(frozen=True)
class Doubt:
    """When the answer of a global search is not believed.

    Features of sparse clouds are often wrong, and then so is the answer, by metres or half a turn.  The misfit of
    an answer is the mean squared distance of each cloud's points to the other cloud, capped; it is compared with
    that of the belief (the centroids' shift, or the prior).
    """

    cap: float = 0.3  # distances count no more than this [m]
    near: float = 1.2  # an answer near the belief may misfit this many times as much as the belief, ...
    far: float = 0.5  # ... and one far from it only this many times; 1e9 in both: every answer is believed

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        for field, value in vars(self).items():
            if not value > 0.0:
                raise ValueError(f"doubt.{field} must be positive, got {value}")

    def admits(self, T: Transform, source: FeatureCloud, target: FeatureCloud, belief: Belief) -> bool:
        """Say whether an answer explains the clouds."""
        if not np.isfinite(T).all():
            return False
        limit = self.near if belief.distance_to(T) < NEAR else self.far
        return self.misfit(T, source, target) <= limit * self.misfit(belief.T_target_source, source, target)

    def misfit(self, T: Transform, source: FeatureCloud, target: FeatureCloud) -> float:
        """Give the mean squared capped distance between the clouds, the mean of both directions [m^2]."""
        T = between_origins(T, source, target)
        there = self._one_way(se3.transform(T, source.thinned), target)
        back = self._one_way(se3.transform(se3.invert(T), target.thinned), source)
        return 0.5 * (there + back)

    def _one_way(self, points: Points, other: FeatureCloud) -> float:
        distance, _ = other.tree.query(points, distance_upper_bound=self.cap)
        return float(np.mean(np.minimum(distance, self.cap) ** 2))


def between_origins(T: Transform, source: FeatureCloud, target: FeatureCloud) -> Transform:
    """Rewrite T_target_source for coordinates relative to the clouds' origins."""
    return se3.pose(T[:3, :3], T[:3, :3] @ source.origin + T[:3, 3] - target.origin)


def from_origins(T: Transform, source: FeatureCloud, target: FeatureCloud) -> Transform:
    """Undo `between_origins`."""
    return se3.pose(T[:3, :3], T[:3, 3] + target.origin - T[:3, :3] @ source.origin)


def agreement(
    T: Transform, source: FeatureCloud, target: FeatureCloud, pairs: Correspondences, reach: float
) -> tuple[int, float]:
    """Count the correspondences that a motion between the origins brings within `reach` [m]; give count and RMSE."""
    moved = se3.transform(T, source.thinned[pairs[:, 0]])
    squared = ((moved - target.thinned[pairs[:, 1]]) ** 2).sum(axis=1)
    within = squared < reach**2
    n = int(within.sum())
    return n, (float(np.sqrt(squared[within].mean())) if n else float("nan"))
