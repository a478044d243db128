"""Generalised ICP in the plane: pair nearest neighbours, weigh each pair by the surfaces about both points."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float64, Int64

from registration import planar, uncertainty
from registration.belief import Belief, believe
from registration.libraries import load_small_gicp
from registration.method import PairMethod, nothing_known
from registration.types import (
    MotionPrior,
    Point,
    Points,
    RegistrationResult,
    Status,
    Transform,
)

MIN_NEIGHBOURS = 5  # small_gicp gives no surface to clouds that are smaller

UNLIKE = 2.0  # factor of the belief's covariance where the clouds do not meet: they show different surfaces
BELIEVED_LIFT = 0.3  # standard deviation of the change in z about that of the centroids [m]
_SHIFT = [0, 1, 3]  # where (x, y, z) stand in an Update

Covariances = Float64[np.ndarray, "n 3 3"]
Update = Float64[np.ndarray, "4"]  # (x, y, yaw, z) about the moved source centroid [m, m, rad, m]
Information = Float64[np.ndarray, "4 4"]  # of an Update


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud with what every alignment of it needs; no tree and no surfaces where there are too few points.

    Attributes:
        points: as they came [m].
        offsets: the points relative to the centroid: small numbers, wherever on earth the cloud is [m].
        covariances: small_gicp's surface about each point: variance 1e-3 across it, 1 along it (no unit: relative).
        tree: a small_gicp.KdTree of the offsets.
    """

    points: Points
    offsets: Points
    centroid: Point
    covariances: Covariances
    tree: Any


@dataclass(frozen=True, slots=True)
class Pairing:
    """Which source points found a partner within reach, and how far off they are."""

    source: Int64[np.ndarray, " n"]
    target: Int64[np.ndarray, " n"]
    rmse: float

    def __len__(self) -> int:
        return len(self.source)


@dataclass(frozen=True)
class GeneralizedICP(PairMethod):
    """Minimise the Mahalanobis distances of nearest neighbours over (x, y, yaw, z), with a belief about the motion.

    Trees and surfaces are small_gicp's; the Gauss-Newton steps are ours, since the library's have six degrees of
    freedom and tilt freely where a cloud is a scan ring or two.  z is a nuisance: solved for, kept in the result's
    shift, not in its covariance.  The centroids' shift with its own covariance (or the prior) enters as one more
    measurement: it decides in the directions that the surfaces leave open.  Far pairs lose weight (Cauchy).

    Source: Segal, Haehnel & Thrun, "Generalized-ICP", RSS 2009; small_gicp (Koide, JOSS 9(100), 2024); the weight:
    Bergstroem & Edlund, "Robust registration of point sets using iteratively reweighted least squares", 2014.
    """

    name: ClassVar[str] = "gicp"

    max_distance: float = 0.5  # points farther apart than this make no pair [m]
    max_iterations: int = 30
    tolerance: float = 1e-3  # stop when an update shifts [m] and turns [rad] less than this
    n_neighbours: int = 10  # that make up the surface about a point
    min_points: int = 5  # smaller clouds have no surfaces; fewer pairs say nothing
    robust_scale: float = 0.5  # Mahalanobis distance at which a pair has half its weight; inf: least squares
    believed_turn: float = 0.1  # standard deviation of the turn about the start, without a prior [rad]

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, and load small_gicp."""
        for field in ("max_distance", "robust_scale", "believed_turn"):
            if not getattr(self, field) > 0.0:
                raise ValueError(f"{field} must be positive, got {getattr(self, field)}")
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations must be at least 1, got {self.max_iterations}")
        for field in ("n_neighbours", "min_points"):
            if getattr(self, field) < MIN_NEIGHBOURS:
                raise ValueError(f"{field} must be at least {MIN_NEIGHBOURS}, got {getattr(self, field)}")
        load_small_gicp(self.name)

    def prepare_cloud(self, points: Points) -> Cloud:
        """Build the search tree and estimate the surface about each point."""
        centroid = points.mean(axis=0) if len(points) else np.zeros(3)
        offsets = points - centroid
        if len(points) < self.min_points:
            return Cloud(points, offsets, centroid, np.empty((0, 3, 3)), None)
        small_gicp = load_small_gicp(self.name)
        cloud = small_gicp.PointCloud(offsets)
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_covariances(cloud, tree, self.n_neighbours)
        return Cloud(points, offsets, centroid, np.array(cloud.covs())[:, :3, :3], tree)

    def align_pair(self, source: Cloud, target: Cloud, prior: MotionPrior | None) -> RegistrationResult:
        """Iterate from the belief to the nearest minimum."""
        if len(source.points) == 0 or len(target.points) == 0:
            return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
        belief = believe(source.points, target.points, prior, self.believed_turn)
        if min(len(source.points), len(target.points)) < self.min_points:
            return belief.result(Status.TOO_FEW_POINTS)
        T, is_settled, n_iterations = belief.T_target_source, False, 0
        while not is_settled and n_iterations < self.max_iterations:
            pairing = self._pair(T, source, target)
            if len(pairing) < self.min_points:
                return belief.result(Status.NO_OVERLAP, UNLIKE)
            H, b = self._normal_equations(T, source, target, pairing)
            H_belief, b_belief = _normal_equations_of_belief(T, belief)
            update = np.linalg.solve(H + H_belief, b + b_belief)
            T = _apply(update, T, source.centroid)
            is_settled = np.hypot(*update[:2]) < self.tolerance and abs(update[2]) < self.tolerance
            n_iterations += 1
        return RegistrationResult(
            T_target_source=T,
            source_centroid=source.centroid,
            covariance=uncertainty.of_surface_pairs(
                H[:3, :3], belief.covariance, source.points, target.points, len(pairing)
            ),
            status=Status.CONVERGED if is_settled else Status.NOT_CONVERGED,
            rmse=pairing.rmse,
            n_pairs=len(pairing),
            n_iterations=n_iterations,
        )

    def _pair(self, T: Transform, source: Cloud, target: Cloud) -> Pairing:
        """Find each source point's nearest target point within `max_distance`."""
        moved = source.offsets @ T[:3, :3].T + _between(T, source, target)
        nearest, squared = target.tree.batch_knn_search(moved, 1)
        paired = np.flatnonzero(squared[:, 0] < self.max_distance**2)
        rmse = float(np.sqrt(squared[paired, 0].mean())) if len(paired) else float("nan")
        return Pairing(paired, nearest[paired, 0].astype(np.int64), rmse)

    def _normal_equations(
        self, T: Transform, source: Cloud, target: Cloud, pairing: Pairing
    ) -> tuple[Information, Update]:
        """Sum up what each pair says of the next update: Segal et al., eq. 2, linearised at T, with Cauchy's weight."""
        R = T[:3, :3]
        arm = source.offsets[pairing.source] @ R.T
        off = target.offsets[pairing.target] - arm - _between(T, source, target)
        W = _inverse(target.covariances[pairing.target] + _turn(source.covariances[pairing.source], R))
        Woff = np.einsum("nij,nj->ni", W, off)
        weight = 1.0 / (1.0 + (off * Woff).sum(axis=1) / self.robust_scale**2)
        turning = np.column_stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))])  # how each point moves with yaw
        Wturning = np.einsum("nij,nj->ni", W, turning)
        H = np.empty((4, 4))
        H[np.ix_(_SHIFT, _SHIFT)] = (weight @ W.reshape(-1, 9)).reshape(3, 3)
        H[2, _SHIFT] = H[_SHIFT, 2] = weight @ Wturning
        H[2, 2] = weight @ (turning * Wturning).sum(axis=1)
        b = np.empty(4)
        b[_SHIFT] = weight @ Woff
        b[2] = weight @ (turning * Woff).sum(axis=1)
        return H, b


def _between(T: Transform, source: Cloud, target: Cloud) -> Point:
    """Give the moved source centroid relative to the target's."""
    return T[:3, :3] @ source.centroid + T[:3, 3] - target.centroid


def _normal_equations_of_belief(T: Transform, belief: Belief) -> tuple[Information, Update]:
    """Say how strongly, and where to, the belief pulls the update at T."""
    H = np.diag([0.0, 0.0, 0.0, 1.0 / BELIEVED_LIFT**2])
    H[:3, :3] = np.linalg.inv(belief.covariance)
    off, centroid = np.empty(4), belief.source_centroid
    off[:3] = planar.motion_about(belief.T_target_source, centroid) - planar.motion_about(T, centroid)
    off[2] = planar.wrap(float(off[2]))
    off[3] = belief.T_target_source[2, 3] - T[2, 3]
    return H, H @ off


def _apply(update: Update, T: Transform, centroid: Point) -> Transform:
    """Turn the moved cloud about its centroid, then shift it."""
    center = T[:3, :3] @ centroid + T[:3, 3]
    return planar.to_transform(update[:3], center, z=float(update[3])) @ T


def _turn(covariances: Covariances, R: Float64[np.ndarray, "3 3"]) -> Covariances:
    """Give R C R' of many C, as one product of matrices."""
    return (covariances.reshape(-1, 9) @ np.kron(R, R).T).reshape(-1, 3, 3)


def _inverse(M: Covariances) -> Covariances:
    """Invert symmetric 3x3 matrices by their cofactors: ten times as fast as LAPACK on many small ones."""
    a, b, c, d, e, f = M[:, 0, 0], M[:, 0, 1], M[:, 0, 2], M[:, 1, 1], M[:, 1, 2], M[:, 2, 2]
    A, B, C, D, E, F = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    adjugate = np.stack([A, B, C, B, D, E, C, E, F], axis=-1).reshape(-1, 3, 3)
    return adjugate / (a * A + b * B + c * C)[:, None, None]
