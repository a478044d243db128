"""Point-to-plane ICP in the plane: bring each point onto the surface about its nearest neighbour, repeat.

The constants of the covariance were fitted to the errors on two simulated streets (`regmot simulate`, seeds 1 and 2;
cars and vans, 3 to 80 m) such that the normalised error squared has its expectation; `regmot compare` prints it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration import icp_kernels, iterative, neighbours, uncertainty
from registration.iterative import BatchMethod, Cloud, Clouds
from registration.neighbours import Packed
from registration.types import MotionPrior, PlanarCovariance, Points, RegistrationResult, Status

# Standard deviation of one plane's distance [m], as if planes were independent: ...
PLANE_SHARED = 5.7e-4  # ... many pairs share their errors: this, with the square root of their number, ...
PLANE_SAMPLING = (
    0.98  # ... few points make poor planes: this, over the square root of the points of the smaller cloud, ...
)
PLANE_APART = 0.48  # ... and clouds may show different parts: this times the share of the source that has no partner
UNSETTLED = 2.1  # factor where the iterations did not come to rest
PLANE_FLOOR = 0.01  # standard deviation of any shift [m]
CENTROIDS_SHARE = 0.53  # factor of `uncertainty.of_centroids`' standard deviations for clouds that overlap; ...
CENTROIDS_APART = 2.4  # ... share of the extent by which their centroids differ if nothing overlaps
BELIEVED_LIFT = 0.1  # standard deviation of the change in z about that of the centroids [m]
DENSE = 500  # points; cells of larger clouds are smaller, so that a search looks at no more points
ROUNDING = 1e-8  # so that a prior that claims certainty has an inverse [m^2, rad^2]


@dataclass(frozen=True)
class PointToPlaneICP(BatchMethod):
    """Minimise the distances of points to the planes about their nearest neighbours, over (x, y, yaw, z).

    Normals are the target's.  z is a nuisance: solved for, kept in the result's shift, not in its covariance.  Where
    other parts are seen of an object, centroids rise or sink, and sloping planes (hoods, windscreens) would take
    that for a motion along the ground.
    What is known of the motion is less what normals tell only since they lean, by the noise of the points that they
    were fitted to: along the flat side of a car, seen through a gap, that is all.
    Pairs lose weight as their distance grows (Geman & McClure), and all together count as no more than
    `independent_pairs`.  The start, the centroids' shift with its own covariance or the prior, enters as one more
    measurement: it keeps the motion where the planes leave it open, as along the side of a car or with a single
    scan ring, so that sparse clouds cannot run away.  Where the planes alone would leave some direction unsure by more
    than `unsure`, the status is NOT_CONVERGED: that direction is the start's.

    Source: Chen & Medioni, "Object modelling by registration of multiple range images", Image and Vision Computing
    10(3), 1992; the weight: Geman & McClure, Bull. Int. Stat. Inst. 52(4), 1987.
    """

    name: ClassVar[str] = "plane-icp"

    max_distance: float = 0.5  # points farther apart than this make no pair [m]
    max_iterations: int = 30
    tolerance: float = 1e-3  # stop when an update shifts [m] and turns [rad] less than this
    min_points: int = 3  # smaller clouds, and fewer pairs, say nothing of the turn
    normal_radius: float = 0.5  # of the neighbourhood that a plane is fitted to [m], ...
    normal_neighbours: int = 20  # ... and the number of points in it, at most
    line_neighbours: int = 20  # and where those lie on a line, if that is more
    noise: float = 0.05  # of a point's distance to its plane, beside the start's covariance [m]
    robust_scale: float = 0.1  # at this distance to its plane a pair has a quarter of its weight [m]
    # Beside its partner by this share of the radius of the plane's neighbourhood a pair has a quarter of its weight
    # too: where one cloud shows what the other does not, its edge is the nearest, and surfaces bend behind edges.
    patch_share: float = math.inf
    independent_pairs: float = 50.0  # more pairs than this are no surer than this many
    unsure: float = 0.3  # standard deviation of a shift from the planes alone that is no answer [m]
    threads: int = 1  # that align the pairs of a batch

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        lengths = "max_distance", "normal_radius", "noise", "robust_scale", "patch_share"
        for setting in (*lengths, "independent_pairs", "unsure"):
            if not getattr(self, setting) > 0.0:
                raise ValueError(f"{setting} must be positive, got {getattr(self, setting)}")
        for setting, least in (("max_iterations", 1), ("normal_neighbours", 3), ("min_points", 1)):
            if getattr(self, setting) < least:
                raise ValueError(f"{setting} must be at least {least}, got {getattr(self, setting)}")

    def prepare_cloud(self, points: Points) -> Cloud:
        """Sort the points into cells; planes are fitted when they are first asked for."""
        return iterative.prepare(points, float(self._cells(np.array([len(points)]))[0]))

    def surfaces(self, clouds: Clouds) -> Packed:
        """Do `prepare_cloud` for many at once, as `iterate` takes targets."""
        return neighbours.build_grids(clouds.points, clouds.begin, self._cells(clouds.sizes))[0]

    def _cells(self, n_points: Int64[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        sides: Float64[np.ndarray, " k"] = self.max_distance * np.minimum(1.0, (DENSE / np.maximum(n_points, 1)) ** 0.5)
        return sides

    def align_batch(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None]
    ) -> list[RegistrationResult]:
        """Iterate each pair from its start by damped Gauss-Newton steps."""
        doubts = np.array([_doubt(*pair, prior) for pair, prior in zip(pairs, priors, strict=True)])
        # pairs of one target share its planes, which are fitted where they are needed; on several threads they do not
        keys = [id(target) if self.threads <= 1 else k for k, (_, target) in enumerate(pairs)]
        grids = {key: target.grid for key, (_, target) in zip(keys, pairs, strict=True)}
        numbers = {key: number for number, key in enumerate(grids)}
        found = self.iterate(
            *neighbours.pack_arrays([source.grid.points for source, _ in pairs]),
            neighbours.pack(list(grids.values())),
            np.array([numbers[key] for key in keys]),
            iterative.starts(pairs, priors),
            doubts,
        )
        known = found.beliefs.copy()
        for k, ((source, target), prior) in enumerate(zip(pairs, priors, strict=True)):
            if prior is None:
                known[k] = np.linalg.inv(_centroids_doubt(source, target, found.apart[k]))
        return [
            _result(*each)
            for each in zip(
                pairs,
                found.motions.tolist(),
                found.outcomes.tolist(),
                found.covariances(known),
                found.is_degenerate(self.unsure),
                strict=True,
            )
        ]

    def iterate(
        self,
        sources: Points,
        begin: Int64[np.ndarray, " _"],
        targets: Packed,
        own: Int64[np.ndarray, " n"],
        starts: Float64[np.ndarray, "n 3"],
        doubts: Float64[np.ndarray, "n 3 3"],
    ) -> "Iterated":
        """Do the work of `align_batch`, for who wants all of its answers in one piece.

        Args:
            sources: n clouds one after the other, each about its centroid [m].
            begin: source k is rows begin[k] to begin[k + 1] of these.
            targets: each about its centroid, see `surfaces`.
            own: which target is that of each source.
            starts: motions (x, y, yaw) between the clouds about their centroids [m, m, rad].
            doubts: covariances of these.
        """
        n, motions = len(own), starts.copy()
        outcomes, informations, beliefs = np.empty((n, 5)), np.zeros((n, 3, 3)), icp_kernels.inverses(doubts)
        planes = np.full((len(targets.points), 5), np.nan)
        around = float(self.normal_radius), self.normal_neighbours, self.line_neighbours
        neighbours.share_out(
            lambda a, b: icp_kernels.point_to_plane(
                a, b, sources, begin, *targets, planes, own, around, self._limits(), beliefs, motions, outcomes,
                informations
            ),
            n,
            self.threads,
        )  # fmt: skip
        sizes, ends = np.empty((n, 2), dtype=np.int64), targets.points_begin
        sizes[:, 0], sizes[:, 1] = begin[1:] - begin[:-1], (ends[1:] - ends[:-1])[own]
        return Iterated(motions, outcomes, informations, beliefs, sizes, self.noise)

    def _limits(self) -> tuple[float, int, float, int, float, float, float, float, float]:
        pairs = float(self.noise), float(self.patch_share) ** -2, float(self.robust_scale)
        floats = (*pairs, float(self.independent_pairs), BELIEVED_LIFT**-2)
        return (float(self.max_distance), self.max_iterations, float(self.tolerance), self.min_points, *floats)


@dataclass(frozen=True, slots=True)
class Iterated:
    """Where the iterations of n pairs ended.

    Attributes:
        motions: (x, y, yaw) between the clouds about their centroids (n, 3) [m, m, rad].
        outcomes: see `icp_kernels.point_to_plane` (n, 5).
        informations: what the planes alone say of the motions, as inverse covariances (n, 3, 3).
        beliefs: inverse covariances of the starts (n, 3, 3).
        sizes: points of both clouds (n, 2).
        noise: of a point's distance to its plane, by these [m].
    """

    motions: Float64[np.ndarray, "n 3"]
    outcomes: Float64[np.ndarray, "n 5"]
    informations: Float64[np.ndarray, "n 3 3"]
    beliefs: Float64[np.ndarray, "n 3 3"]
    sizes: Int64[np.ndarray, "n 2"]
    noise: float

    @property
    def apart(self) -> Float64[np.ndarray, " n"]:
        """Give the share of each source that has no partner."""
        shares: Float64[np.ndarray, " n"] = 1.0 - self.outcomes[:, 1] / np.maximum(self.sizes[:, 0], 1)
        return shares

    @property
    def is_found(self) -> Bool[np.ndarray, " n"]:
        """Say where planes had a say at all: there were pairs to the end."""
        how = self.outcomes[:, 0]
        return (how == icp_kernels.CONVERGED) | (how == icp_kernels.NOT_CONVERGED)

    def covariances(self, known: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n 3 3"]:
        """Bound the errors of the motions.

        The planes' information and the start's make the covariance; both count less where the clouds show different
        parts of the object, the planes' also where points are few and where the iterations did not settle.

        Args:
            known: inverse covariances of the starts, as they are taken afterwards.
        """
        shares = PLANE_SHARED**2, PLANE_SAMPLING**2, PLANE_APART**2, UNSETTLED**2, PLANE_FLOOR**2
        found: Float64[np.ndarray, "n 3 3"] = icp_kernels.covariances(
            self.outcomes, self.informations, known, self.sizes, self.noise**2, shares
        )
        return found

    def is_degenerate(self, unsure: float) -> Bool[np.ndarray, " n"]:
        """Say where the planes alone would leave some direction unsure by more than that [m]."""
        return np.linalg.eigvalsh(self.informations[:, :2, :2])[:, 0] * unsure**2 < 1.0


def _result(
    pair: tuple[Cloud, Cloud],
    motion: list[float],
    outcome: list[float],
    covariance: PlanarCovariance,
    is_degenerate: np.bool_,
) -> RegistrationResult:
    source, target = pair
    status = iterative.STATUS[int(outcome[0])]
    T = iterative.transform(motion, source, target)
    T[2, 3] += outcome[4]
    if status not in (Status.CONVERGED, Status.NOT_CONVERGED):
        return iterative.fallback(source, target, T, status)
    return RegistrationResult(
        T_target_source=T,
        source_centroid=source.centroid,
        covariance=covariance,
        status=Status.NOT_CONVERGED if is_degenerate else status,
        rmse=outcome[2],
        n_pairs=int(outcome[1]),
        n_iterations=int(outcome[3]),
    )


def _centroids_doubt(source: Cloud, target: Cloud, apart: float) -> PlanarCovariance:
    """Give the covariance of a start at the centroids, of clouds of which a share has no partners."""
    doubt = CENTROIDS_SHARE**2 * _doubt(source, target, None)
    if len(source.points):
        doubt[:2, :2] += CENTROIDS_APART**2 * apart**2 * np.cov(source.points[:, :2], rowvar=False, bias=True)
    return doubt


def _doubt(source: Cloud, target: Cloud, prior: MotionPrior | None) -> PlanarCovariance:
    """Give the covariance of the start."""
    if prior is not None:
        return prior.covariance + ROUNDING * np.eye(3)
    if len(source.points) == 0 or len(target.points) == 0:
        return uncertainty.unknown()
    return uncertainty.of_centroids(source.points, target.points)
