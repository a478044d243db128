"""Where evidence of an object's motion comes from: its shape, laid on itself, and the network's opinion."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from registration import planar, se3, uncertainty
from registration.alignnet.method import AlignNetCars, AlignNetPersons
from registration.methods.adh import AnnealedHistograms3D
from registration.methods.plane_icp import PointToPlaneICP
from registration.types import MotionPrior, PlanarCovariance, Points, RegistrationResult, Status, Transform
from tracker.estimators.contract import Sighting
from tracker.estimators.fused.look import Encoding, Look, Networks, thinned
from tracker.estimators.fused.window import Square, Vector

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


@dataclass(frozen=True, slots=True)
class Evidence:
    """A motion that was measured between two looks.

    Attributes:
        step: displacement of the object's reference point (2) [m].
        information: inverse covariance of that (2, 2).
        turn: [rad].
        turn_variance: [rad^2]; infinite where no turn was measured.
        was_searched: annealed histograms had a say; they match what is seen as a whole.
    """

    step: Vector
    information: Square
    turn: float
    turn_variance: float
    was_searched: bool = False


@dataclass(frozen=True, slots=True)
class Expected:
    """Where an earlier look is expected in the newer one.

    Attributes:
        T: the motion; the earlier points are put there first.
        covariance: of what is left of (x, y) [m^2]; None where nothing is known of the motion.
        turn_variance: of what is left of yaw [rad^2].
        contrary: covariance that another place adds which is told of, beside that (x, y) [m^2].
    """

    T: Transform
    covariance: Square | None
    turn_variance: float
    contrary: Square = field(default_factory=lambda: np.zeros((2, 2)))

    def is_sure(self, n_points: int) -> bool:
        """Say whether the place is known well enough for planes, and points are many enough."""
        if self.covariance is None or n_points < FEW_POINTS:
            return False
        (a, b), (_, c) = self.covariance.tolist()
        return 0.5 * (a + c) + math.hypot(0.5 * (a - c), b) <= SURE**2  # the larger eigenvalue


@dataclass(frozen=True, slots=True)
class Laid:
    """An earlier look that is to be laid on a newer one.

    Attributes:
        earlier: the look.
        newer: number of the newer one.
        place: of the object's reference point in the earlier one (2) [m].
        expected: motion.
    """

    earlier: Look
    newer: int
    place: Vector
    expected: Expected


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

    def compare(self, laid: Sequence[Laid], newer: Sequence[Look]) -> list[Evidence]:
        """Lay many earlier looks on newer ones at once; several may be laid on the same one."""
        if not laid:
            return []
        moved = [se3.transform(job.expected.T, job.earlier.points) for job in laid]
        targets = [newer[job.newer] for job in laid]
        priors = [_prior(job.expected, a, b.points) for job, a, b in zip(laid, moved, targets, strict=True)]
        found = self._searched(laid, moved, targets, priors)
        fewest = [min(job.earlier.n_points, look.n_points) for job, look in zip(laid, targets, strict=True)]
        beliefs = [
            prior if result is None else _belief(result, job.expected, n_points)
            for prior, result, job, n_points in zip(priors, found, laid, fewest, strict=True)
        ]
        surfaces = self._planes.prepare([look.points for look in newer])
        sources = self._planes.prepare([thinned(cloud, SHAPE_POINTS) for cloud in moved])
        refined = self._planes.align([(a, surfaces[job.newer]) for a, job in zip(sources, laid, strict=True)], beliefs)
        return [
            _evidence_of_shape(before, after, job, n_points)
            for before, after, job, n_points in zip(found, refined, laid, fewest, strict=True)
        ]

    def _searched(
        self, laid: Sequence[Laid], moved: Sequence[Points], targets: Sequence[Look], priors: Sequence[MotionPrior]
    ) -> list[RegistrationResult | None]:
        """Search around, where what is expected is not sure enough or points are too few for planes."""
        found: list[RegistrationResult | None] = [None] * len(laid)
        own = [k for k, job in enumerate(laid) if _is_searched(job, moved[k], targets[k])]
        sources = self._search.prepare([moved[k] for k in own], [targets[k].sensor.place for k in own])
        surroundings = self._search.prepare([targets[k].points for k in own], [targets[k].sensor.place for k in own])
        results = self._search.align(list(zip(sources, surroundings, strict=True)), [priors[k] for k in own])
        for k, result in zip(own, results, strict=True):
            found[k] = result
        return found


def _is_searched(job: Laid, moved: Points, target: Look) -> bool:
    """Say whether the place is not known well enough for planes, something contradicts it, or points are too few."""
    return not job.expected.is_sure(min(len(moved), len(target.points))) or bool(job.expected.contrary.any())


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
            clouds = network.prepare([sightings[k].points for k in own], [sightings[k].sensor for k in own])
            found.update((k, Encoding(network, cloud)) for k, cloud in zip(own, clouds, strict=True))
        return [found[k] for k in range(len(sightings))]

    def ask(self, pairs: Sequence[tuple[Look, Look]]) -> list[RegistrationResult | None]:
        """Compare many pairs (earlier, newer look) at once; None where the network does not know."""
        answers: list[RegistrationResult | None] = [None] * len(pairs)
        for network in {id(newer.learned.network): newer.learned.network for _, newer in pairs}.values():
            own = [k for k, pair in enumerate(pairs) if all(look.learned.network is network for look in pair)]
            results = network.align([(pairs[k][0].learned.cloud, pairs[k][1].learned.cloud) for k in own])
            for k, result in zip(own, results, strict=True):
                answers[k] = result if result.status is Status.CONVERGED else None
        return answers

    def _network(self, class_name: str) -> Networks:
        if class_name.lower() not in PERSONS:
            return self._cars
        if self._persons is None:
            self._persons = AlignNetPersons(max_points=LEARNED_POINTS)
        return self._persons


def _prior(expected: Expected, moved: Points, newer: Points) -> MotionPrior:
    """Expect no motion beside the expected one; with nothing expected, what centroids would say of one."""
    covariance = np.zeros((3, 3))
    if expected.covariance is None:
        covariance += FIRST_DOUBT * uncertainty.of_centroids(moved, newer)
    else:
        covariance[:2, :2] = expected.covariance + expected.contrary
    covariance[2, 2] = expected.turn_variance
    return MotionPrior(np.zeros(3), covariance)


def _belief(found: RegistrationResult, expected: Expected, n_points: int) -> MotionPrior:
    """Believe what a search has found; where it has chosen between two places only, that it is there, no more."""
    covariance = found.covariance.copy()
    if expected.covariance is not None and expected.is_sure(n_points):
        covariance[:2, :2] = expected.covariance
    covariance[2, 2] = expected.turn_variance
    return MotionPrior(found.motion_about(found.source_centroid), covariance)


def _evidence_of_shape(
    before: RegistrationResult | None, after: RegistrationResult, laid: Laid, n_points: int
) -> Evidence:
    """Read what the planes found after a search or without; where they found nothing, what was found before."""
    expected, place = laid.expected, laid.place
    is_refined = after.n_pairs > 0 and after.status in (Status.CONVERGED, Status.NOT_CONVERGED)
    if before is None and not is_refined:
        return Evidence(np.zeros(2), np.zeros((2, 2)), 0.0, float("inf"))
    result = after if is_refined or before is None else before
    at = _moved(expected.T, place)
    step = _moved(result.T_target_source, at) - place
    covariance = _about(result.covariance, 0.0, result.source_centroid[:2], at)
    information = _inverse(covariance[:2, :2])
    was_searched = before is not None and not expected.is_sure(n_points)  # else it has chosen between two places only
    if expected.covariance is not None:
        prior = expected.covariance + expected.contrary if was_searched else expected.covariance
        information = _without(information, _inverse(prior))
    information /= SEARCHED_SHARE if was_searched else SHAPE_SHARE * _denser(n_points)
    turn = planar.wrap(se3.yaw(result.T_target_source) + se3.yaw(expected.T))
    variance = TURN_SHARE * result.covariance[2, 2] + (TURN_SAMPLING / n_points) ** 2
    return Evidence(step, information, turn, float(variance) if is_refined else float("inf"), was_searched)


def _denser(n_points: int) -> float:
    """Give the share of their variance that dense clouds have."""
    return (SHAPE_POINTS / min(max(n_points, SHAPE_POINTS), DENSEST)) ** DENSER


def evidence_of_network(result: RegistrationResult, earlier: Look, newer: Look, place: Vector) -> Evidence:
    """Read an answer of the network at the object's reference point.

    Args:
        result: motion between the looks.
        earlier, newer: the looks.
        place: of the reference point in the earlier one [m].
    """
    T, turn = result.T_target_source, se3.yaw(result.T_target_source)
    seen = place - earlier.shift  # the network knows of no shifts
    covariance = _about(result.covariance, turn, result.source_centroid[:2], seen)
    information = _inverse(covariance[:2, :2])
    turn_variance = float(result.covariance[2, 2]) + (TURN_SAMPLING / min(earlier.n_points, newer.n_points)) ** 2
    return Evidence(_moved(T, seen) + newer.shift - place, information, turn, turn_variance)


def _about(
    covariance: PlanarCovariance, turn: float, old: Float64[np.ndarray, "2"], new: Float64[np.ndarray, "2"]
) -> PlanarCovariance:
    return planar.transport_covariance(covariance, turn, old, new)


def _moved(T: Transform, place: Vector) -> Vector:
    moved: Vector = T[:2, :2] @ place + T[:2, 3]
    return moved


def _inverse(covariance: Square) -> Square:
    """Invert a covariance (2, 2); NumPy's own takes longer to call than to compute, seven times an object and frame."""
    (a, b), (_, c) = covariance.tolist()
    return np.array([[c, -b], [-b, a]]) / (a * c - b * b)


def _without(information: Square, prior: Square) -> Square:
    """Take out what a prior knew; directions that nothing else told of are left without information."""
    left: Square = information - prior
    (a, b), (_, c) = left.tolist()
    least = LEAST * float(information[0, 0] + information[1, 1])
    if a > least and (a - least) * (c - least) > b * b:  # all directions are left
        return left
    values, axes = np.linalg.eigh(left)
    values = np.where(values > least, values, 0.0)
    return (axes * values) @ axes.T
