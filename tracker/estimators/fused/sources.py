"""Where evidence of an object's motion comes from: its shape, laid on itself, and the network's opinion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration import icp_kernels, iterative, neighbours, planar, se3, uncertainty
from registration.alignnet.method import AlignNetCars, AlignNetPersons
from registration.methods.adh import AnnealedHistograms3D
from registration.methods.plane_icp import ROUNDING, PointToPlaneICP
from registration.types import MotionPrior, PlanarCovariance, Points, RegistrationResult
from tracker.estimators.contract import Sighting
from tracker.estimators.fused.look import Encoding, Look, Networks, thinned
from tracker.estimators.fused.window import Vector

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
LEAST = 1e-3  # a direction with less than this share of the information counts as not measured

Vectors = Float64[np.ndarray, "m 2"]
Squares = Float64[np.ndarray, "m 2 2"]
PlanarCovariances = Float64[np.ndarray, "m 3 3"]
Moved = tuple[Float64[np.ndarray, " m"], Vectors, PlanarCovariances]  # turns, steps of the places, their covariances


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

    def is_sure(self, n_points: Int64[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
        """Say where the place is known well enough for planes, and points are many enough."""
        a, b, c = self.covariances[:, 0, 0], self.covariances[:, 0, 1], self.covariances[:, 1, 1]
        largest = 0.5 * (a + c) + np.hypot(0.5 * (a - c), b)  # eigenvalue
        return self.is_expected & (n_points >= FEW_POINTS) & (largest <= SURE**2)


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
        is_sure = laid.is_sure(seen)
        searched = np.flatnonzero(~laid.is_sure(kept.min(axis=1)) | laid.contraries.any(axis=(1, 2)))
        found = self._searched(laid, targets, searched, covariances)
        for k, result in found.items():  # the planes believe it; where it only chose a place, that it is there, no more
            means[k], chosen = result.motion_about(result.source_centroid), result.covariance.copy()
            chosen[:2, :2] = laid.covariances[k] if is_sure[k] else chosen[:2, :2]
            chosen[2, 2] = laid.turn_variances[k]
            covariances[k] = chosen
        at = laid.places + laid.shifts
        is_refined, (turns, steps, known) = _refined(self._planes, laid, newer, means, covariances)
        is_told = is_refined.copy()
        for k in set(np.flatnonzero(~is_refined).tolist()) & found.keys():  # what was found before
            turns[k], steps[k], known[k] = _about(found[k], at[k])
            is_told[k] = True
        was_searched = np.zeros_like(is_sure)
        was_searched[searched] = ~is_sure[searched]  # else it has chosen between two places only
        priors = laid.covariances + was_searched[:, None, None] * laid.contraries
        informations = np.where(is_told[:, None, None], planar.inverses(known[:, :2, :2]), 0.0)
        is_prior = laid.is_expected & is_told
        informations[is_prior] = _without(informations[is_prior], planar.inverses(priors[is_prior]))
        informations /= np.where(was_searched, SEARCHED_SHARE, SHAPE_SHARE * _denser(seen))[:, None, None]
        variances = TURN_SHARE * known[:, 2, 2] + (TURN_SAMPLING / seen) ** 2
        return Evidence(
            steps=np.where(is_told[:, None], steps + laid.shifts, 0.0),
            informations=informations,
            turns=planar.wrap_all(turns + laid.turns),
            turn_variances=np.where(is_refined, variances, np.inf),
            was_searched=was_searched,
        )

    def _searched(
        self, laid: Laid, targets: Sequence[Look], searched: Int64[np.ndarray, " s"], covariances: PlanarCovariances
    ) -> dict[int, RegistrationResult]:
        """Search around, for those that are not expected surely enough, or have too few points for planes."""
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
    means: Float64[np.ndarray, "m 3"],
    covariances: PlanarCovariances,
) -> tuple[Bool[np.ndarray, " m"], Moved]:
    """Refine motions by planes; say where these had a say, and what they tell of places in the earlier clouds.

    Args:
        planes: how.
        laid: what is laid on what.
        newer: looks.
        means: of what is believed of the motions beside those expected, about the clouds' centroids.
        covariances: of that.
    """
    own, starts, doubts = np.array(laid.newer), means.copy(), covariances + ROUNDING * np.eye(3)
    points, begin = neighbours.pack_arrays([thinned(look.points, SHAPE_POINTS) for look in laid.earlier])
    points = points.copy() if len(own) == 1 else points
    icp_kernels.move_all(points, begin, laid.turns, laid.places, laid.shifts)
    sources = iterative.centered(points, begin)
    points, begin = neighbours.pack_arrays([look.points for look in newer])
    surfaces = iterative.centered(points.copy() if len(newer) == 1 else points, begin)
    starting, arriving = sources.centroids[:, :2], surfaces.centroids[own, :2]
    starts[:, :2] -= arriving - starting
    found = planes.iterate(sources.points, sources.begin, planes.surfaces(surfaces), own, starts, doubts)
    arms, turns = laid.places + laid.shifts - starting, found.motions[:, 2]
    steps = arriving - starting + found.motions[:, :2] + planar.rotate_all(arms, turns) - arms
    about = planar.transport_covariances(found.covariances(found.beliefs), np.zeros(len(arms)), arms)
    return found.is_found, (turns, steps, about)


def _about(found: RegistrationResult, at: Vector) -> tuple[float, Vector, PlanarCovariance]:
    """Read a result at a place: turn, step, covariance."""
    covariance = planar.transport_covariance(found.covariance, 0.0, found.source_centroid[:2], at)
    return se3.yaw(found.T_target_source), found.motion_about(np.array([*at, 0.0]))[:2], covariance


def _denser(n_points: Int64[np.ndarray, " m"]) -> Float64[np.ndarray, " m"]:
    """Give the share of their variance that dense clouds have."""
    return (SHAPE_POINTS / np.clip(n_points, SHAPE_POINTS, DENSEST)) ** DENSER


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
            shifts = np.array([(a.shift, b.shift) for a, b in looks])
            n_points = np.array([min(a.n_points, b.n_points) for a, b in looks])
            sources = np.array([a.learned.cloud.centroid[:2] for a, _ in looks])
            targets = np.array([b.learned.cloud.centroid[:2] for _, b in looks])
            found, is_doubtful = network.compare([(a.learned.cloud, b.learned.cloud) for a, b in looks])
            known = np.flatnonzero(~is_doubtful)
            at = places[own] - shifts[:, 0]  # the network knows of no shifts
            arms = at - sources - found.center[:, :2]
            moved = targets + found.moved_center[:, :2] + planar.rotate_all(arms, found.turn) + shifts[:, 1]
            covariances = found.covariances_about(arms)
            told = np.array(own)[known]
            steps[told], informations[told] = (moved - places[own])[known], planar.inverses(covariances[known, :2, :2])
            turns[told] = found.turn[known]
            variances[told] = covariances[known, 2, 2] + (TURN_SAMPLING / n_points[known]) ** 2
        return Evidence(steps, informations, turns, variances, np.zeros(n, dtype=np.bool_))

    def _network(self, class_name: str) -> Networks:
        if class_name.lower() not in PERSONS:
            return self._cars
        if self._persons is None:
            self._persons = AlignNetPersons(max_points=LEARNED_POINTS)
        return self._persons


def _without(informations: Squares, priors: Squares) -> Squares:
    """Take out what priors knew; directions that nothing else told of are left without information."""
    left: Squares = informations - priors
    a, b, c = left[:, 0, 0], left[:, 0, 1], left[:, 1, 1]
    least = LEAST * (informations[:, 0, 0] + informations[:, 1, 1])
    is_whole = (a > least) & ((a - least) * (c - least) > b * b)  # all directions are left
    for k in np.flatnonzero(~is_whole):
        values, axes = np.linalg.eigh(left[k])
        left[k] = (axes * np.where(values > least[k], values, 0.0)) @ axes.T
    return left
