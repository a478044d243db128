"""One scan against a local map of the static scene: point to plane, in six degrees of freedom, with a covariance."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial.transform import Rotation

from registration import se3
from registration.libraries import load_small_gicp
from registration.types import Point, Points, Transform
from tracker.ego_motion.static_scene import START_SPEEDS, SceneSettings

LEAST_SLOPE = 0.2  # of the ratio of a weight function's derivative to itself, averaged over residuals
HORIZONTAL = np.array([0, 1, 5])  # x, y and yaw of an Update
LEVEL = float(np.cos(np.deg2rad(10.0)))  # planes whose normals are nearer to the vertical are ground

Update = Float64[np.ndarray, "6"]  # (x, y, z) [m], rotation vector [rad]: about the sensor, in world axes
Information = Float64[np.ndarray, "6 6"]


@dataclass(frozen=True)
class RefineSettings:
    """How scans are registered to the local map.

    The numbers come from the sensor (2 cm of range noise, rings some decimetres apart where it matters) and from how
    cars move; none was tried out on KITTI.
    """

    scene: SceneSettings = field(default_factory=SceneSettings)
    voxel: float = 0.25  # one point is left in each cell of scan and map [m]
    n_neighbours: int = 15  # that make up the plane at a point of the map
    n_keyframes: int = 12  # scans in the map
    keyframe_distance: float = 1.0  # from one to the next [m]
    keyframe_turn: float = 0.1  # or this [rad]
    noise: float = 0.02  # of a point off its plane [m]
    robust_scale: float = 0.05  # distance off its plane at which a pair has a quarter of its weight [m]
    first_scale: float = 0.5  # the same in the first iteration [m]
    first_distance: float = 1.0  # between the points of a pair in the first iteration [m]
    last_distance: float = 0.4  # and in the last ones [m]
    max_iterations: int = 20
    min_pairs: int = 100  # fewer say nothing
    prior_shift: float = 0.1  # standard deviation of a step given beforehand: 7 ms at 15 m/s [m]
    prior_turn: float = 0.01  # [rad]
    lost: float = 0.05  # a pose less sure than this, in any horizontal direction, is flagged [m]
    cluster: float = 2.0  # residuals nearer to each other than this are not independent [m]
    floor_shift: float = 5e-4  # standard deviation that no residual shows: calibration, planes that are none [m]
    floor_turn: float = 5e-5  # [rad]
    start_speeds: tuple[float, ...] = START_SPEEDS  # that a drive without recorded poses may start with [m/s]
    doubt: float = 0.3  # between odometry's step and the last one, from which on both are tried [m]
    drift_time: float = 30.0  # in which the heading is drawn back to that of recorded poses [s]


@dataclass(frozen=True)
class LocalMap:
    """The static scene around the sensor.

    Attributes:
        origin: of the coordinates below, in the world: small numbers, wherever on earth the sensor is [m].
        points: (n, 3) [m].
        normals: of the planes at the points; zeros where there are too few neighbours.
        tree: a small_gicp.KdTree of the points.
    """

    origin: Point
    points: Points
    normals: Points
    tree: Any

    @classmethod
    def of(cls, points_world: Points, origin: Point, settings: RefineSettings) -> "LocalMap":
        """Thin points out, and find the plane at each."""
        small_gicp = load_small_gicp("refining ego poses")
        cloud, tree = small_gicp.preprocess_points(points_world - origin, settings.voxel, settings.n_neighbours)
        return cls(origin, np.array(cloud.points()[:, :3]), np.array(cloud.normals()[:, :3]), tree)


@dataclass(frozen=True)
class Fit:
    """Where a scan lies in the map.

    Attributes:
        T_world_lidar: pose of the sensor.
        covariance: of (x, y, z, rotation vector) about the sensor, in world axes, relative to the map.
        n_pairs: points that found a plane.
        support: how many of them lie on it, ground left out: what tells one place from another.
    """

    T_world_lidar: Transform
    covariance: Information
    n_pairs: int
    support: float


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Points of the scan and the planes they lie next to: one row a pair.

    Attributes:
        arm: from the sensor to the point, in world axes [m].
        normal: of the plane.
        off: signed distance of the point from the plane [m].
    """

    arm: Points
    normal: Points
    off: Float64[np.ndarray, " n"]

    @property
    def jacobian(self) -> Float64[np.ndarray, "n 6"]:
        """How the distances change with an update.

        Level planes know nothing of a horizontal motion: what their normals lean is mostly noise, and thousands of
        them would make a bare road look like a place.
        """
        J = np.hstack([self.normal, np.cross(self.arm, self.normal)])
        J[np.ix_(np.flatnonzero(self.is_level), HORIZONTAL)] = 0.0
        return J

    @property
    def is_level(self) -> Bool[np.ndarray, " n"]:
        """Which planes are ground."""
        return np.abs(self.normal[:, 2]) > LEVEL


def thin_out(points: Points, settings: RefineSettings) -> Points:
    """Replace the points in each cell by their mean."""
    small_gicp = load_small_gicp("refining ego poses")
    return np.array(small_gicp.voxelgrid_sampling(points, settings.voxel).points()[:, :3])


def fit(local_map: LocalMap, points_lidar: Points, T_prior: Transform, settings: RefineSettings) -> Fit:
    """Find the pose that puts a scan's points on the planes of the map, with a belief about the pose.

    Minimises the sum of the squared distances, weighed by Geman and McClure's function whose scale shrinks from
    `first_scale` to `robust_scale`, plus the prior's own term: directions that the scene leaves open stay at the
    prior.  The covariance comes from how the residuals really scatter: each cluster of `cluster` metres is one
    independent pull (a sandwich estimator), since neighbours on one wall are off together.

    Args:
        local_map: what to register to.
        points_lidar: static points of the scan, moved to one instant [m].
        T_prior: T_world_lidar as expected.
        settings: how.

    Source: Chen & Medioni, 1992 (point to plane); Zhou, Park & Koltun, ECCV 2016 (the shrinking scale); White,
    "Maximum likelihood estimation of misspecified models", 1982, and Huber, "Robust statistics", 1981, 6.3 (the
    sandwich).
    """
    T, scale, reach = T_prior.copy(), settings.first_scale, settings.first_distance
    known = _prior_information(settings)
    pairs = _pair(local_map, points_lidar, T, reach)
    for _ in range(settings.max_iterations):
        weight = _weights(pairs.off, scale, settings.noise)
        J = pairs.jacobian
        H = (J * weight[:, None]).T @ J + known
        update = np.linalg.solve(H, known @ _difference(T, T_prior) - J.T @ (weight * pairs.off))
        T = _apply(update, T)
        is_final = scale == settings.robust_scale and reach == settings.last_distance
        scale, reach = max(settings.robust_scale, 0.6 * scale), max(settings.last_distance, 0.8 * reach)
        pairs = _pair(local_map, points_lidar, T, reach)
        if is_final and np.abs(update[:3]).max() < 2e-4 and np.abs(update[3:]).max() < 1e-5:
            break
    upright = pairs.off[~pairs.is_level]
    support = float(_weights(upright, settings.robust_scale, 1.0).sum())
    return Fit(T, _covariance(pairs, known, settings), len(pairs.off), support)


def _pair(local_map: LocalMap, points_lidar: Points, T: Transform, reach: float) -> _Pairs:
    """Find the plane next to each point, within reach."""
    arm = points_lidar @ T[:3, :3].T
    placed = arm + (T[:3, 3] - local_map.origin)
    nearest, squared = local_map.tree.batch_nearest_neighbor_search(placed)
    rows: Int64[np.ndarray, " n"] = np.asarray(nearest, dtype=np.int64).ravel()
    is_near: Bool[np.ndarray, " n"] = np.asarray(squared).ravel() < reach**2
    normal = local_map.normals[rows]
    kept = is_near & normal.any(axis=1)
    off = ((placed[kept] - local_map.points[rows[kept]]) * normal[kept]).sum(axis=1)
    return _Pairs(arm[kept], normal[kept], off)


def _weights(off: Float64[np.ndarray, " n"], scale: float, noise: float) -> Float64[np.ndarray, " n"]:
    return np.asarray(1.0 / (1.0 + (off / scale) ** 2) ** 2 / noise**2)


def _prior_information(settings: RefineSettings) -> Information:
    return np.diag([settings.prior_shift**-2] * 3 + [settings.prior_turn**-2] * 3)


def _difference(T: Transform, T_prior: Transform) -> Update:
    """Give the update that leads from T to the prior."""
    turn = Rotation.from_matrix(T_prior[:3, :3] @ T[:3, :3].T).as_rotvec()
    return np.concatenate([T_prior[:3, 3] - T[:3, 3], turn])


def _apply(update: Update, T: Transform) -> Transform:
    """Turn the sensor about itself, then shift it."""
    R = Rotation.from_rotvec(update[3:]).as_matrix() @ T[:3, :3]
    return se3.pose(se3.nearest_rotation(R), T[:3, 3] + update[:3])


def _covariance(pairs: _Pairs, known: Information, settings: RefineSettings) -> Information:
    """Sum up the pulls of clusters of residuals, and carry them over to the pose.

    How far the pose gives way to a pull is decided by the derivative of the weighted residuals, not by the weights: a
    pair that moves off its plane also loses weight.  Their ratio is taken over all pairs, where it is positive.
    """
    weight = _weights(pairs.off, settings.robust_scale, settings.noise)
    off = (pairs.off / settings.robust_scale) ** 2
    slope = float((weight * (1.0 - 3.0 * off) / (1.0 + off)).sum() / max(float(weight.sum()), 1e-9))
    J = pairs.jacobian
    cells = np.floor(pairs.arm[:, :2] / settings.cluster).astype(np.int64)
    _, cluster = np.unique(cells, axis=0, return_inverse=True)
    n_clusters = int(cluster.max()) + 1 if len(cluster) else 0
    pulls = np.zeros((n_clusters, 6))
    np.add.at(pulls, cluster.ravel(), J * (weight * pairs.off)[:, None])
    spread = pulls.T @ pulls * n_clusters / max(n_clusters - 6, 1)
    inverse = np.linalg.inv(max(slope, LEAST_SLOPE) * (J * weight[:, None]).T @ J + known)
    floor = np.diag([settings.floor_shift**2] * 3 + [settings.floor_turn**2] * 3)
    return inverse @ (spread + known) @ inverse + floor
