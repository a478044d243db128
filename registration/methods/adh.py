"""Annealed dynamic histograms: the whole distribution of the shift between two clouds, as fine as it is worth.

Written from the paper and from a description in words of what the authors' release does; no code of the release
was used.  Its licence (academic, non-commercial) names the provisional patent 62/009,238: whoever builds
a product on this method should look into that.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from registration import annealing
from registration.method import PairMethod, check_cloud, nothing_known, one_prior_a_pair
from registration.neighbours import pack_arrays, share_out
from registration.types import MotionPrior, PlanarCovariance, Point, Points, RegistrationResult, Status
from registration.uncertainty import ORDINARY_TURN

Vector2 = Float64[np.ndarray, "2"]

# A prior knows (x, y), the release's is a density in space: its height's variance sets it against its floor.
HEIGHT_VARIANCE = 0.1  # [m^2]
EXACT = 1e-9  # added to a prior's variances, which may be 0 [m^2]

# From the histogram's spread to the error of an object's motion.  Fitted by maximum likelihood on two simulated
# streets (`regmot simulate`, seeds 1 and 2: cars, vans, persons, 3 to 80 m), all three methods at once, with and
# without priors.  The histogram is broader than its error, but knows nothing of a cloud that slides along itself
# because another part of the object is seen; without height it is misled more.
SPREAD = 0.53  # share of the histogram's variance
SLIDE_FLAT, SLIDE = 0.028, 0.012  # share of the smaller cloud's own scatter, as standard deviations


@dataclass(frozen=True, slots=True)
class Cloud:
    """A cloud with what every alignment of it needs.

    Attributes:
        centroid: mean of all points [m]; 0 where there are none.
        scatter: horizontal covariance of the points: xx, xy, yy [m^2].
        extent: sides of the bounding rectangle [m].
        range_m: how far from the sensor the centroid is, horizontally [m].
        n_points: number of points.
        as_moved: the points that are left when this is the smaller cloud of a pair [m].
        as_fixed: the points that are left when it is the larger one [m].
    """

    centroid: Point
    scatter: tuple[float, float, float]
    extent: tuple[float, float]
    range_m: float
    n_points: int
    as_moved: Points
    as_fixed: Points


@dataclass(frozen=True, slots=True)
class Posterior:
    """What is known of the shift of the source once the points have been looked at.

    Attributes:
        mean: (x, y) [m].
        covariance: of the histogram's cell centres, the filter's own: see `AnnealedHistograms2D.result` for an
            honest one [m^2].
        within: mean variance inside a cell, of each of x and y [m^2].
        n_levels: number of resolutions gone through.
    """

    mean: Vector2
    covariance: Float64[np.ndarray, "2 2"]
    within: float
    n_levels: int

    @property
    def spread(self) -> tuple[float, float, float]:
        """Covariance of the histogram with the extent of its cells: xx, xy, yy [m^2]."""
        (xx, xy), (_, yy) = self.covariance.tolist()
        return xx + self.within, xy, yy + self.within


@dataclass(frozen=True)
class AnnealedHistograms2D(PairMethod):
    """Weigh all shifts of a coarse grid by how well they lay one cloud on the other, divide the likely, repeat.

    A shift's likelihood is the product, over the points of the smaller cloud, of how likely each is measured
    where the larger cloud has its nearest point: a normal distribution as wide as the cells, the spacing of the
    sensor's rays and its noise together, over a floor for points that were not seen before (section IV).  With a
    motion prior it makes a posterior (section V).  Cells of enough probability are divided until they are as fine
    as the sensor's rays (section VI).  The answer is the posterior's mean: a pure shift, horizontal, since height
    and turn are not searched.  There are no starting value and no iterations that could end in a wrong minimum.

    How far apart the rays are depends on the range: where `prepare` is not told where the sensor is, clouds must be
    in axes whose origin it is.

    Source: Held, Levinson, Thrun & Savarese, "Combining 3D shape, color, and motion for robust anytime tracking",
    RSS 2014; constants of the authors' release.
    """

    name: ClassVar[str] = "adh-2d"
    uses_height: ClassVar[bool] = False
    wants_sensors: ClassVar[bool] = True

    coarsest: float = 1.0  # side of the first cells [m]
    finest: float = 0.05  # cells this small are not divided [m], ...
    ray_share: float = 1.0  # ... nor are cells smaller than this share of the distance between measured points
    reduction: int = 3  # a cell is divided into so many along x, and along y
    split_above: float = 1e-4  # cells of more probability than this are divided
    max_reach: float = 30.0  # the search ends this far from the shift of the centroids, along x and y [m]; not theirs
    azimuth_step_deg: float = 0.18  # between the sensor's rays; an HDL-64E
    elevation_step_deg: float = 26.8 / 63
    sensor_share: float = 0.5  # share of the rays' distance in the standard deviation of a measured point
    noise: float = 0.03  # standard deviation of the sensor's noise [m]
    floor: float = 0.8  # likelihood of a point with nothing near it, where 1 more is that of one right on a point
    discount: float = 1.0  # exponent of every likelihood
    independent: int = 150  # so many points count in full; more of them share their weight
    max_moved: int = 150  # the smaller cloud is thinned to about so many points
    max_fixed: int = 2000  # and the larger one to so many
    prior_floor: float = 1e-4  # least density of a prior [1/m^3]
    acceleration_variance: float = 10.0  # of the motion model that the tracker's estimator keeps [m^2/s^4]
    widest: float = 0.5  # posteriors with a larger standard deviation than this are no answer [m]
    threads: int = 1  # that search the pairs of a batch

    def __post_init__(self) -> None:
        """Refuse settings that cannot work."""
        for field in ("coarsest", "finest", "azimuth_step_deg", "elevation_step_deg", "noise", "floor", "prior_floor"):
            if not getattr(self, field) > 0.0:
                raise ValueError(f"{field} must be positive, got {getattr(self, field)}")
        if self.reduction < 2:
            raise ValueError(f"reduction must be at least 2, got {self.reduction}")
        if min(self.max_moved, self.max_fixed, self.independent) < 1:
            raise ValueError("max_moved, max_fixed and independent must be at least 1")

    def prepare(self, clouds: Sequence[ArrayLike], sensors: Sequence[ArrayLike] | None = None) -> list[Cloud]:
        """Check and thin each (N, 3) cloud, and measure it.

        Args:
            clouds: [m], any horizontal axes, z up.
            sensors: where each cloud was seen from (x, y), in the same axes [m]; None: from the origin.

        Raises:
            InvalidCloudError: a cloud is no finite (N, 3) array of numbers.
            ValueError: there are sensors, but not one a cloud.
        """
        if sensors is None:
            sensors = [np.zeros(2)] * len(clouds)
        if len(sensors) != len(clouds):
            raise ValueError(f"prepare got {len(clouds)} clouds but {len(sensors)} sensors; expected one a cloud")
        return [
            self.prepare_cloud(check_cloud(cloud), np.asarray(sensor, dtype=np.float64))
            for cloud, sensor in zip(clouds, sensors, strict=True)
        ]

    def align(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[RegistrationResult]:
        """Register prepared (source, target) pairs, all in one call of the compiled search.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        found = self.posteriors(pairs, priors)
        return [self.result(a, b, posterior) for (a, b), posterior in zip(pairs, found, strict=True)]

    def align_pair(self, source: Cloud, target: Cloud, prior: MotionPrior | None) -> RegistrationResult:
        """Register two prepared clouds."""
        return self.align([(source, target)], [prior])[0]

    def posteriors(
        self, pairs: Sequence[tuple[Cloud, Cloud]], priors: Sequence[MotionPrior | None] | None = None
    ) -> list[Posterior | None]:
        """Give the posterior of each pair's shift; None where a cloud is empty.

        Raises:
            ValueError: there are priors, but not one a pair.
        """
        priors = one_prior_a_pair(pairs, priors)
        found: list[Posterior | None] = [None] * len(pairs)
        moved, fixed, rows, places, signs = [], [], [], [], []
        for place, ((source, target), prior) in enumerate(zip(pairs, priors, strict=True)):
            if source.n_points == 0 or target.n_points == 0:
                continue
            # The smaller cloud moves: there is more for its points to find a partner in.
            small, large, sign = (source, target, 1.0) if source.n_points <= target.n_points else (target, source, -1.0)
            moved.append(small.as_moved)
            fixed.append(large.as_fixed)
            rows.append((*self._searched(small, large), *self._spacing(large, target), sign, *_density(prior)))
            places.append(place)
            signs.append(sign)
        if rows:
            answers = self._search(moved, fixed, np.array(rows, dtype=annealing.PAIR))
            for place, sign, (x, y, xx, xy, yy, within, n_levels) in zip(places, signs, answers, strict=True):
                mean, covariance = np.array([sign * x, sign * y]), np.array([[xx, xy], [xy, yy]])
                found[place] = Posterior(mean, covariance, within, int(n_levels))
        return found

    def _search(self, moved: list[Points], fixed: list[Points], pairs: np.ndarray) -> list[tuple[float, ...]]:
        """Give a row of POSTERIOR for each pair; each thread takes one pair after another."""
        clouds, found = (*pack_arrays(moved), *pack_arrays(fixed)), np.zeros(len(pairs), dtype=annealing.POSTERIOR)
        share_out(lambda a, b: annealing.search(a, b, *clouds, pairs, self._constants, found), len(pairs), self.threads)
        rows: list[tuple[float, ...]] = found.tolist()
        return rows

    def result(self, source: Cloud, target: Cloud, posterior: Posterior | None) -> RegistrationResult:
        """Turn a posterior into the motion of an object: its mean, and how far that can be trusted."""
        if posterior is None:
            return nothing_known(source.centroid, Status.TOO_FEW_POINTS)
        xx, xy, yy = posterior.spread
        widest_variance = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        T_target_source = np.eye(4)
        T_target_source[:2, 3] = posterior.mean
        return RegistrationResult(
            T_target_source=T_target_source,
            source_centroid=source.centroid,
            covariance=self._covariance(posterior, source if source.n_points <= target.n_points else target),
            status=Status.CONVERGED if widest_variance <= self.widest**2 else Status.NOT_CONVERGED,
            rmse=float("nan"),
            n_pairs=0,
            n_iterations=posterior.n_levels,
        )

    def _covariance(self, posterior: Posterior, smaller: Cloud) -> PlanarCovariance:
        slide = (SLIDE if self.uses_height else SLIDE_FLAT) ** 2
        xx, xy, yy = (SPREAD * s + slide * c for s, c in zip(posterior.spread, smaller.scatter, strict=True))
        return np.array([[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, ORDINARY_TURN**2]])

    def prepare_cloud(self, points: Points, sensor: Vector2 | None = None) -> Cloud:
        """Thin a checked cloud and measure it, as seen from the sensor, or else from the origin."""
        if len(points) == 0:
            return Cloud(np.zeros(3), (0.0, 0.0, 0.0), (0.0, 0.0), 0.0, 0, points, points)
        centroid, scatter, low, high = annealing.measure(points)
        return Cloud(
            centroid=centroid,
            scatter=(float(scatter[0, 0]), float(scatter[0, 1]), float(scatter[1, 1])),
            extent=(float(high[0] - low[0]), float(high[1] - low[1])),
            range_m=math.hypot(*(centroid[:2] if sensor is None else centroid[:2] - sensor)),
            n_points=len(points),
            as_moved=_thinned(points, self.max_moved),
            as_fixed=_thinned(points, self.max_fixed),
        )

    def _searched(self, small: Cloud, large: Cloud) -> tuple[float, float, float]:
        """Give the middle of the searched square of shifts and half its side [m]: clouds that would still touch."""
        reach = math.ceil(0.5 * math.hypot(*map(max, small.extent, large.extent)))
        x, y = (large.centroid - small.centroid)[:2].tolist()
        return x, y, min(reach, self.max_reach)

    def _spacing(self, large: Cloud, target: Cloud) -> tuple[float, float]:
        """Give the distance of neighbouring points, across and up [m]: of the rays, and larger where thinned."""
        thinning = large.n_points / len(large.as_fixed)
        across, up = self._ray_spacing
        return across * target.range_m * thinning, up * target.range_m * thinning

    @cached_property
    def _ray_spacing(self) -> tuple[float, float]:
        """Distance of neighbouring rays at 1 m from the sensor, across and up [m]."""
        across, up = (2.0 * math.tan(math.radians(0.5 * a)) for a in (self.azimuth_step_deg, self.elevation_step_deg))
        return across, up

    @cached_property
    def _constants(self) -> annealing.Constants:
        across, up = self._ray_spacing
        settings = {name: getattr(self, name) for name in annealing.Constants._fields if name != "step_up"}
        return annealing.Constants(**settings, step_up=up / across if self.uses_height else 0.0)


@dataclass(frozen=True)
class AnnealedHistograms3D(AnnealedHistograms2D):
    """The same search of a horizontal shift, with points that also differ in height: one layer of cells a ring."""

    name: ClassVar[str] = "adh-3d"
    uses_height: ClassVar[bool] = True


@dataclass(frozen=True)
class TunedHistograms3D(AnnealedHistograms3D):
    """`adh-3d` with the best of 59 settings for car velocities in the world frame, which are not held-out ones.

    They were swept with the authors' release on the 521 steps of cars and vans of KITTI tracking sequence 0000:
    figures on that sequence are no evidence.  Finer cells and four times the points: several times slower.  With
    these constants we do not reach what the sweep reports (0.25/0.19 m/s there, 0.29/0.22 here, < 80/< 20 m), though
    the default settings agree with the release row by row: the list of settings may not be complete.
    """

    name: ClassVar[str] = "adh-3d-tuned"

    finest: float = 0.02  # [m]
    reduction: int = 4
    sensor_share: float = 1.0
    noise: float = 0.05  # [m]
    discount: float = 1.5
    independent: int = 40
    max_moved: int = 600
    prior_floor: float = 1e-6  # [1/m^3]
    acceleration_variance: float = 1.0  # [m^2/s^4]


def _thinned(points: Points, n: int) -> Points:
    """Keep every k-th point so that about n are left; clouds that are hardly larger stay whole."""
    if 0.8 * len(points) <= n:
        return np.ascontiguousarray(points)
    return np.ascontiguousarray(points[:: math.ceil(len(points) / n)])


def _density(prior: MotionPrior | None) -> tuple[float, ...]:
    """Give what PAIR holds of a prior: whether there is one, its mean, precision, and the log of its peak."""
    if prior is None:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    (xx, xy), (_, yy) = prior.covariance[:2, :2].tolist()
    xx, yy = xx + EXACT, yy + EXACT
    determinant = xx * yy - xy * xy
    log_peak = -1.5 * math.log(2.0 * math.pi) - 0.5 * math.log(determinant * HEIGHT_VARIANCE)
    x, y = prior.mean[:2].tolist()
    return True, x, y, yy / determinant, -xy / determinant, xx / determinant, log_peak
