"""Where evidence of an object's motion comes from: its shape, laid on itself, and the network's opinion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration import icp_kernels, iterative, neighbours, planar, se3, uncertainty
from registration.alignnet.method import AlignNetCars, AlignNetPersons
from registration.methods.adh import AnnealedHistograms3D
from registration.methods.plane_icp import ROUNDING, PointToPlaneICP
from registration.types import MotionPrior, Points, RegistrationResult
from tracker.estimators.contract import Sighting
from tracker.estimators.fused import source_kernels
from tracker.estimators.fused.look import Encoding, Look, Networks, thinned

PERSONS = {"pedestrian", "person", "person_sitting", "cyclist"}  # classes that the network for persons is asked about
# Planes count for what lies beside them as far as they were fitted, and rings on hoods are no walls: see docs/fused.md.
PLANES = PointToPlaneICP(
    independent_pairs=200.0, robust_scale=0.05, patch_share=0.7, normal_neighbours=10, line_neighbours=30
)
SHAPE_POINTS = 400  # of an earlier look, at most, that are laid on all points of the newer one by planes
LEARNED_POINTS = 192  # of a look, at most, that the network is shown
FIRST_DOUBT = 4.0  # factor of the centroids' covariance, where nothing else is known of a motion
# Sparse clouds tell turns worse than their covariance says: standard deviation of one point's share [rad].
TURN_SAMPLING = 0.5
# Shares of what methods claim that their errors show within a track, on simulated training sequences and scenes (the
# large ones are left to Student's t): of plane-icp's variance of a turn and covariance of a shift, and of the latter
# where histograms had a say.  The network's covariance is taken as it is.
TURN_SHARE, SHAPE_SHARE, SEARCHED_SHARE = 0.06, 0.12, 0.3
# Clouds of n > SHAPE_POINTS points err less: variances go with n to the power of minus DENSER, as far as DENSEST.
DENSER, DENSEST = 0.6, 3000
FEW_POINTS = 25  # clouds with fewer are searched for around, ...
SURE = 0.6  # ... and those that are expected with a larger standard deviation [m]: planes find what is near only
LEAST_DOUBT = ROUNDING * np.eye(3)  # so that covariances have inverses
LEAST = 1e-3  # a direction with less than this share of the information counts as not measured
# as `source_kernels.weigh` takes them
SHARES = SEARCHED_SHARE, SHAPE_SHARE, float(SHAPE_POINTS), float(DENSEST), DENSER, LEAST

Vectors = Float64[np.ndarray, "m 2"]
Squares = Float64[np.ndarray, "m 2 2"]
PlanarCovariances = Float64[np.ndarray, "m 3 3"]
# turns, steps of the places, and covariances of these (xx, xy, yy) and variance of the turn
Moved = tuple[Float64[np.ndarray, " m"], Vectors, Float64[np.ndarray, "m 4"]]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Motions that were measured between looks, M of them.

    Attributes:
        steps: displacements of the objects' reference points (M, 2) [m].
        informations: inverse covariances of these (M, 2, 2); zero where nothing was measured.
        turns: (M) [rad].
        turn_variances: (M) [rad^2]; infinite where no turn was measured.
        was_searched: where annealed histograms had a say (M); they match what is seen as a whole.
    """

    steps: Vectors
    informations: Squares
    turns: Float64[np.ndarray, " m"]
    turn_variances: Float64[np.ndarray, " m"]
    was_searched: Bool[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class Laid:
    """Earlier looks that are to be laid on newer ones, M of them, and where they are expected there.

    Attributes:
        earlier: the looks.
        newer: number of each one's newer look (M).
        places: of the objects' reference points in the earlier ones (M, 2) [m].
        shifts: how far these are expected to move (M, 2) [m]; the earlier points are put there first.
        turns: that are expected (M) [rad].
        covariances: of what is left of the shifts (M, 2, 2) [m^2].
        is_expected: where anything is known of the motion; else the centroids tell the shift, no covariance is known.
        turn_variances: of what is left of the turns (M) [rad^2].
        contraries: covariances that another place adds which is told of, beside those (M, 2, 2) [m^2].
    """

    earlier: Sequence[Look]
    newer: Sequence[int]
    places: Vectors
    shifts: Vectors
    turns: Float64[np.ndarray, " m"]
    covariances: Squares
    is_expected: Bool[np.ndarray, " m"]
    turn_variances: Float64[np.ndarray, " m"]
    contraries: Squares

    def moved(self, k: int, points: Points) -> Points:
        """Put points of an earlier look where they are expected."""
        R, place = planar.rotation(self.turns[k]), self.places[k]
        moved = points.copy()
        moved[:, :2] = points[:, :2] @ R.T + (place + self.shifts[k] - R @ place)
        return moved

    def is_sure(self) -> Bool[np.ndarray, " m"]:
        """Say where the place is known well enough for planes, if points are many enough."""
        a, b, c = self.covariances[:, 0, 0], self.covariances[:, 0, 1], self.covariances[:, 1, 1]
        largest = 0.5 * (a + c) + np.hypot(0.5 * (a - c), b)  # eigenvalue
        return self.is_expected & (largest <= SURE**2)


class Shape:
    """Lay earlier points on the newer ones, by planes.

    Where the place is not surely known, annealed histograms, which see all places around, find it first; what they
    find is the belief that the planes refine.  Elsewhere they are not asked: they match all that is seen, and where
    a part of the object comes into view they slide along with it, and are sure.
    Where it is surely known, and only something contradicts it, they choose between both places, and are believed no
    further.
    The expectation's own information is taken out again: it comes from the same window that the evidence goes to.
    """

    def __init__(self, planes: PointToPlaneICP = PLANES) -> None:
        """Take the planes, and create the search."""
        self._search = AnnealedHistograms3D()
        self._planes = planes

    def compare(self, laid: Laid, newer: Sequence[Look]) -> Evidence:
        """Lay earlier looks on newer ones, all at once; one at least, and several may be laid on the same one."""
        targets = [newer[number] for number in laid.newer]
        kept = np.array([(len(a.points), len(b.points)) for a, b in zip(laid.earlier, targets, strict=True)])
        seen = np.array([(a.n_points, b.n_points) for a, b in zip(laid.earlier, targets, strict=True)]).min(axis=1)
        means, covariances = np.zeros((len(seen), 3)), _doubts(laid, targets)
        is_near = laid.is_sure()
        is_sure, is_searched = is_near & (seen >= FEW_POINTS), ~is_near | (kept.min(axis=1) < FEW_POINTS)
        searched = np.flatnonzero(is_searched | laid.contraries.any(axis=(1, 2)))
        found = self._searched(laid, targets, searched, covariances)
        for k, result in found.items():  # the planes believe it; where it only chose a place, that it is there, no more
            means[k], chosen = result.motion_about(result.source_centroid), result.covariance.copy()
            chosen[:2, :2] = laid.covariances[k] if is_sure[k] else chosen[:2, :2]
            chosen[2, 2] = laid.turn_variances[k]
            covariances[k] = chosen
        turns, steps, known = np.zeros(len(seen)), np.zeros((len(seen), 2)), np.ones((len(seen), 4))
        for k, result in found.items():  # for where planes have no say
            at = laid.places[k] + laid.shifts[k]
            covariance = planar.transport_covariance(result.covariance, 0.0, result.source_centroid[:2], at)
            turns[k], steps[k] = se3.yaw(result.T_target_source), result.motion_about(np.array([*at, 0.0]))[:2]
            known[k] = covariance[0, 0], covariance[0, 1], covariance[1, 1], covariance[2, 2]
        is_refined = _refined(self._planes, laid, newer, (means, covariances), (turns, steps, known))
        was_searched, is_told, priors = np.zeros_like(is_sure), is_refined.copy(), laid.covariances
        if len(searched):
            was_searched[searched] = ~is_sure[searched]  # else it has chosen between two places only
            is_told[searched] = True
            priors = priors + was_searched[:, None, None] * laid.contraries
        expected, informations = (laid.shifts, priors, laid.turns, laid.is_expected), np.empty((len(seen), 2, 2))
        source_kernels.weigh(known, expected, is_told, was_searched, seen, SHARES, (steps, turns, informations))
        variances = TURN_SHARE * known[:, 3] + (TURN_SAMPLING / seen) ** 2
        variances[~is_refined] = np.inf
        return Evidence(steps, informations, turns, variances, was_searched)

    def _searched(
        self, laid: Laid, targets: Sequence[Look], searched: Int64[np.ndarray, " s"], covariances: PlanarCovariances
    ) -> dict[int, RegistrationResult]:
        """Search around, for those that are not expected surely enough, or have too few points for planes."""
        if not len(searched):
            return {}
        numbers = searched.tolist()
        places = [targets[k].sensor.place for k in numbers]
        sources = self._search.prepare([laid.moved(k, laid.earlier[k].points) for k in numbers], places)
        surroundings = self._search.prepare([targets[k].points for k in numbers], places)
        priors = [MotionPrior(np.zeros(3), covariances[k]) for k in numbers]
        results = self._search.align(list(zip(sources, surroundings, strict=True)), priors)
        return dict(zip(numbers, results, strict=True))


def _doubts(laid: Laid, targets: Sequence[Look]) -> PlanarCovariances:
    """Give the covariances of motions beside the expected ones; with nothing expected, what centroids would say."""
    covariances = np.zeros((len(targets), 3, 3))
    covariances[:, :2, :2] = laid.covariances + laid.contraries
    for k in np.flatnonzero(~laid.is_expected).tolist():
        covariances[k] = FIRST_DOUBT * uncertainty.of_centroids(
            laid.moved(k, laid.earlier[k].points), targets[k].points
        )
    covariances[:, 2, 2] = laid.turn_variances
    return covariances


def _refined(
    planes: PointToPlaneICP,
    laid: Laid,
    newer: Sequence[Look],
    believed: tuple[Float64[np.ndarray, "m 3"], PlanarCovariances],
    moved: Moved,
) -> Bool[np.ndarray, " m"]:
    """Refine motions by planes; say where these had a say, and put what they tell of places in the earlier clouds.

    Args:
        planes: how.
        laid: what is laid on what.
        newer: looks.
        believed: means of the motions beside those expected, about the clouds' centroids, and their covariances.
        moved: changed.
    """
    own, (starts, covariances) = np.array(laid.newer), believed
    points, begin = neighbours.pack_arrays([thinned(look.points, SHAPE_POINTS) for look in laid.earlier])
    points = points.copy() if len(own) == 1 else points
    icp_kernels.move_all(points, begin, laid.turns, laid.places, laid.shifts)
    sources = iterative.centered(points, begin)
    points, begin = neighbours.pack_arrays([look.points for look in newer])
    surfaces = iterative.centered(points.copy() if len(newer) == 1 else points, begin)
    starting = sources.centroids[:, :2]
    between = surfaces.centroids[own, :2] - starting
    starts[:, :2] -= between
    doubts = covariances + LEAST_DOUBT
    found = planes.iterate(sources.points, sources.begin, planes.surfaces(surfaces), own, starts, doubts)
    arms, is_found = laid.places + laid.shifts - starting, found.is_found
    source_kernels.laid(found.motions, found.covariances(found.beliefs), is_found, arms, between, *moved)
    return is_found


class Learned:
    """Ask AlignNet, that for persons or that for cars: each look is encoded once, and compared with any other."""

    def __init__(self) -> None:
        """Load the weights for cars; those for persons are loaded when the first one is seen."""
        self._cars = AlignNetCars(max_points=LEARNED_POINTS)
        self._persons: AlignNetPersons | None = None

    def encode(self, sightings: Sequence[Sighting]) -> list[Encoding]:
        """Encode all that is seen in a frame."""
        networks = [self._network(sighting.class_name) for sighting in sightings]
        found: dict[int, Encoding] = {}
        for network in {id(network): network for network in networks}.values():
            own = [k for k, other in enumerate(networks) if other is network]
            means, sensors = (np.array([getattr(sightings[k], name) for k in own]) for name in ("centroid", "sensor"))
            clouds = network.encode([sightings[k].points for k in own], means, sensors)
            found.update((k, Encoding(network, cloud)) for k, cloud in zip(own, clouds, strict=True))
        return [found[k] for k in range(len(sightings))]

    def ask(self, pairs: Sequence[tuple[Look, Look]], places: Vectors) -> Evidence:
        """Compare many pairs (earlier, newer look) at once.

        Args:
            pairs: M of them.
            places: of the objects' reference points in the earlier ones (M, 2) [m].
        """
        n = len(pairs)
        steps, informations, turns, variances = np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros(n), np.full(n, np.inf)
        for network in {id(newer.learned.network): newer.learned.network for _, newer in pairs}.values():
            own = [k for k, pair in enumerate(pairs) if all(look.learned.is_told_by(network) for look in pair)]
            if not own:
                continue
            looks = [pairs[k] for k in own]
            found, is_doubtful = network.compare([(a.learned.cloud, b.learned.cloud) for a, b in looks])
            told = np.array([(*a.mean, *b.mean, (TURN_SAMPLING / min(a.n_points, b.n_points)) ** 2) for a, b in looks])
            evidence = steps, informations, turns, variances
            source_kernels.opinions(found.motions, found.covariance, is_doubtful, np.array(own), told, places, evidence)
        return Evidence(steps, informations, turns, variances, np.zeros(n, dtype=np.bool_))

    def _network(self, class_name: str) -> Networks:
        if class_name.lower() not in PERSONS:
            return self._cars
        if self._persons is None:
            self._persons = AlignNetPersons(max_points=LEARNED_POINTS)
        return self._persons
