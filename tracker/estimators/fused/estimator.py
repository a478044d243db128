"""The estimator `fused`: each look at an object is compared with several earlier ones, and all of it weighed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from registration import planar
from registration.types import RegistrationResult
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.estimators.fused import parked
from tracker.estimators.fused.sources import (
    Evidence,
    Expected,
    Learned,
    Look,
    Shape,
    evidence_of_network,
    thinned,
)
from tracker.estimators.fused.window import Comparison, MotionModel, Vector, Window
from tracker.smoothing import FixedLag, RauchTungStriebel, Smoothing, WindowMean, in_hindsight
from tracker.types import Covariance2, EstimateStatus, Hindsight, Vector2, VelocityEstimate

# Share of the window's covariance that is left when heavy tails are paid for by single errors, not by all of them:
# fitted to the errors on simulated training sequences.
HONEST_SHARE = 0.3
OWN_TURN_SD = 0.3  # of an object's rate of turn before anything is known [rad/s]
LEAST_SD = 0.01  # of a velocity [m/s]
FIRST_TURN_SD = 0.05  # of a turn between the first two looks [rad]
SEARCHED_TURN_SD = 0.01  # of a turn that is always searched [rad]
MOST_CENTERS = 20  # looks that count for where an object's centre is
RATE_SD = 15.0  # of an object's velocity before anything is known, along x and y [m/s]; fast ones soon prove it


@dataclass(frozen=True)
class FusedSettings:
    """From physics and the sensor; what is fitted was fitted on simulated training sequences.

    Attributes:
        motion: of a car: accelerations of 3 m/s^2 that last for a tenth of a second to a second.
        turn: of a car's heading.
        shape_lags: how many looks ago are the points compared by shape; the first is the step itself.
        learned_lags: and by the network.
        offset_floor, offset_sampling, offset_single: standard deviation of what one look at an object is off: in any
            case, of a single point of many, and of a single point that is all that is seen [m].
        offset_near: the same at 1 m from the sensor, falling with the range squared: what is close changes its look
            from scan to scan [m].
        offset_changed: the same for a look that shares no point with the one before, as when an object comes out from
            behind another one; it grows with the square of the share of points that came or went [m].
        search_floor: standard deviation of an expected place that is always searched [m].
        search_doubt: factor of an expectation's covariance.
        pose_turn_sd: of the axes' own turn between two frames, as by an error of the ego's heading [rad].
        refers_to_center: whether velocities are those of the centre that the network sees, or of the first middle.
        knows_parked: whether what stands in the world is taken to stand.
    """

    motion: MotionModel = field(default_factory=lambda: MotionModel(density=2.0))
    turn: MotionModel = field(default_factory=lambda: MotionModel(density=0.02))
    shape_lags: tuple[int, ...] = (1, 4)
    learned_lags: tuple[int, ...] = (1, 3, 8)
    offset_floor: float = 0.005
    offset_sampling: float = 0.05
    offset_single: float = 1.0
    offset_near: float = 0.5
    offset_changed: float = 0.2
    search_floor: float = 0.1
    search_doubt: float = 4.0
    pose_turn_sd: float = 0.001
    refers_to_center: bool = True
    knows_parked: bool = True

    def __post_init__(self) -> None:
        """Refuse lags that cannot work."""
        lags = (*self.shape_lags, *self.learned_lags)
        if not lags or min(lags) < 1 or max(lags) >= self.motion.n_frames:
            raise ValueError(f"expected lags of 1 to {self.motion.n_frames - 1} frames, got {lags}")


@dataclass
class _Track:
    """One object: its window of places, that of its heading, and the looks that belong to their frames.

    Attributes:
        center: of the object relative to its place, in the axes of its first look [m]; a mean over ...
        n_centers: ... so many looks, at most MOST_CENTERS.
    """

    place: Window
    turn: Window
    looks: list[Look]
    center: Vector = field(default_factory=lambda: np.zeros(2))
    n_centers: int = 0

    def center_at(self, j: int) -> Vector:
        """Give the object's centre at frame j [m]."""
        return self.place.state[j, 0] + planar.rotation(float(self.turn.state[j, 0, 0])) @ self.center

    def refer_to_center(self) -> None:
        """Let the network's opinion of the latest look count for where the centre is."""
        center = self.looks[-1].center
        if center is not None:
            own = planar.rotation(-float(self.turn.state[-1, 0, 0])) @ (center - self.place.state[-1, 0])
            self.n_centers = min(self.n_centers + 1, MOST_CENTERS)
            self.center = self.center + (own - self.center) / self.n_centers


class FusedEstimator(FrameEstimator):
    """Weigh comparisons of an object with its own past, several frames back, by shape and by AlignNet.

    A step between neighbouring scans is precise to centimetres, which are decimetres a second; the same centimetres
    over eight scans are a tenth of that, if the motion between is smooth.  A `Window` of the last frames finds the
    places that agree with all comparisons and with a motion of nearly constant velocity, where single comparisons,
    looks and accelerations may be far off (Student's t).  Nothing is accumulated that a wrong velocity could smear.

    Without ego poses all is relative to the sensor, in its axes.
    """

    name = "fused"

    def __init__(self, smoothing: Smoothing | None = None, settings: FusedSettings | None = None) -> None:
        """Start with no tracks.

        Raises:
            WeightsError: AlignNet's weights cannot be loaded.
        """
        super().__init__(smoothing or WindowMean())
        self.settings = settings or FusedSettings()
        self._shape, self._learned = Shape(), Learned()
        self._tracks: dict[int, _Track] = {}

    def forget(self, track_id: int) -> None:
        """Drop a track."""
        self._tracks.pop(track_id, None)

    def fresh(self) -> "FusedEstimator":
        """Make one with the same settings and no tracks."""
        return FusedEstimator(self.smoothing, self.settings)

    def smoothed(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Read what later frames said: the window is a smoother already; its length is the most that `rts` sees."""
        if isinstance(self.smoothing, FixedLag):
            return in_hindsight(estimates, self.smoothing.lag)
        if isinstance(self.smoothing, RauchTungStriebel):
            return in_hindsight(estimates, self.settings.motion.n_frames)
        return self.smoothing.posteriors(estimates)

    def measure(self, sightings: Mapping[int, Sighting]) -> dict[int, Measurement]:
        """Compare each object with its past, step by step more sure of where it is."""
        if not sightings:
            return {}
        new = self._look(sightings)
        known = {key: self._tracks[key] for key in sightings if key in self._tracks}
        for key, track in known.items():
            self._advance(track, sightings[key])
        is_measured = self._first_comparisons(known, new, sightings)
        for lag in self.settings.shape_lags[1:]:
            self._compare_further(known, new, sightings, lag)
        for key, track in known.items():
            track.turn.solve()
            track.looks.append(new[key])
            if self.settings.refers_to_center:
                track.refer_to_center()
        self._start_tracks(sightings, new)
        may_stand = self.settings.knows_parked and next(iter(sightings.values())).in_world
        return {key: _measurement(track, is_measured[key], may_stand) for key, track in known.items()}

    def _first_comparisons(
        self, known: Mapping[int, _Track], new: Mapping[int, Look], sightings: Mapping[int, Sighting]
    ) -> dict[int, bool]:
        """Compare with the last look by shape, and by the network; say whether anything was found of each object."""
        first = self.settings.shape_lags[0] if self.settings.shape_lags else 0
        steps = self._compare_shapes(known, new, sightings, first) if first else {}
        opinions = self._ask(known, new)
        for key, track in known.items():
            _hear(track, {first: steps[key]} if key in steps else {})
            _hear(track, _as_evidence(opinions[key], track, new[key]))
            track.place.solve()
        return {key: key in steps or bool(opinions[key]) for key in known}

    def _compare_further(
        self, known: Mapping[int, _Track], new: Mapping[int, Look], sightings: Mapping[int, Sighting], lag: int
    ) -> None:
        """Compare with an earlier look by shape, from where the last comparisons say that the object is."""
        for key, evidence in self._compare_shapes(known, new, sightings, lag).items():
            _hear(known[key], {lag: evidence})
            known[key].place.solve()

    def _look(self, sightings: Mapping[int, Sighting]) -> dict[int, Look]:
        seen = list(sightings.values())
        encoded = self._learned.encode([s.points for s in seen], [s.sensor for s in seen])
        return {
            key: Look(thinned(s.points), len(s.points), learned, self._learned.center(learned), s.frame)
            for (key, s), learned in zip(sightings.items(), encoded, strict=True)
        }

    def _advance(self, track: _Track, sighting: Sighting) -> None:
        """Expect the object where its motion leads, in axes whose own turn is not known exactly."""
        arm = track.place.state[-1, 0] - sighting.sensor
        across = self.settings.pose_turn_sd * np.array([-arm[1], arm[0]])
        has_left = track.place.advance(
            sighting.timestamp, np.outer(across, across), self._offset_sd(sighting, track.looks[-1])
        )
        track.turn.advance(sighting.timestamp)
        if has_left:
            track.looks.pop(0)

    def _offset_sd(self, sighting: Sighting, before: Look | None = None) -> float:
        """Say how far what is seen may be off: more where it is little, close, or another part than the last time."""
        n, own = len(sighting.points), self.settings
        parts = [own.offset_floor, own.offset_sampling / n**0.5, own.offset_single / n]
        parts.append(own.offset_near / max(sighting.range_m, 1.0) ** 2)
        if before is not None:
            changed = 1.0 - min(n, before.n_points) / max(n, before.n_points)
            parts.append(own.offset_changed * changed**2)
        return float(np.linalg.norm(parts))

    def _compare_shapes(
        self, known: Mapping[int, _Track], new: Mapping[int, Look], sightings: Mapping[int, Sighting], lag: int
    ) -> dict[int, Evidence]:
        """Lay the looks of `lag` frames ago on the new ones, where there are any."""
        keys = [key for key, track in known.items() if len(track.looks) >= lag]
        evidence = self._shape.compare(
            [known[key].looks[-lag].points for key in keys],
            [new[key].points for key in keys],
            [sightings[key].sensor for key in keys],
            [known[key].place.seen(-1 - lag) for key in keys],
            [self._expected(known[key], new[key], lag) for key in keys],
        )
        return dict(zip(keys, evidence, strict=True))

    def _expected(self, track: _Track, new: Look, lag: int) -> Expected:
        older = -1 - lag
        place = track.place.seen(older)
        turn = float(track.turn.state[-1, 0, 0] - track.turn.state[older, 0, 0])
        if len(track.place) == 2:
            shift, covariance = (new.points.mean(axis=0) - track.looks[-1].points.mean(axis=0))[:2], None
            doubt = FIRST_TURN_SD**2
        else:
            own = self.settings
            shift = track.place.seen(-1) - place
            covariance = own.search_doubt * track.place.difference(older, is_seen=True)
            covariance = covariance + own.search_floor**2 * np.eye(2)
            doubt = float(track.turn.difference(older)[0, 0]) + SEARCHED_TURN_SD**2
        return Expected(planar.to_transform(np.array([*shift, turn]), np.array([*place, 0.0])), covariance, doubt)

    def _ask(self, known: Mapping[int, _Track], new: Mapping[int, Look]) -> dict[int, dict[int, RegistrationResult]]:
        """Give the network's opinion of each object, by lag."""
        jobs = [(k, lag) for k, track in known.items() for lag in self.settings.learned_lags if lag <= len(track.looks)]
        answers = self._learned.ask([(known[key].looks[-lag], new[key].learned) for key, lag in jobs])
        opinions: dict[int, dict[int, RegistrationResult]] = {key: {} for key in known}
        for (key, lag), answer in zip(jobs, answers, strict=True):
            if answer is not None:
                opinions[key][lag] = answer
        return opinions

    def _start_tracks(self, sightings: Mapping[int, Sighting], new: Mapping[int, Look]) -> None:
        own = self.settings
        for key, sighting in sightings.items():
            if key in self._tracks:
                continue
            points, time = new[key].points, sighting.timestamp
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))[:2]
            place = Window.start(own.motion, time, middle, RATE_SD, self._offset_sd(sighting))
            self._tracks[key] = _Track(place, Window.start(own.turn, time, np.zeros(1), OWN_TURN_SD), [new[key]])
            if own.refers_to_center:
                self._tracks[key].refer_to_center()


def _hear(track: _Track, evidence: Mapping[int, Evidence]) -> None:
    """Take evidence about an object into account, by lag."""
    newest = len(track.place) - 1
    for lag, e in evidence.items():
        if newest == 1:
            track.place.place_last(track.place.seen(0) + e.step)
        track.place.compare(Comparison(newest - lag, newest, e.step, e.information))
        if np.isfinite(e.turn_variance):
            turn_information = np.array([[1.0 / e.turn_variance]])
            track.turn.compare(Comparison(newest - lag, newest, np.array([e.turn]), turn_information))


def _as_evidence(opinions: Mapping[int, RegistrationResult], track: _Track, new: Look) -> dict[int, Evidence]:
    return {
        lag: evidence_of_network(answer, track.looks[-lag], new, track.place.seen(-1 - lag))
        for lag, answer in opinions.items()
    }


def _measurement(track: _Track, is_measured: bool, may_stand: bool) -> Measurement:
    """Read the step to the latest look, and what is now known of those before."""
    standing = parked.probability(track.place) if may_stand else 0.0
    velocity, covariance = parked.mixed(*_step(track, -1), standing)
    (yaw_rate,), _ = track.turn.step()
    earlier = range(len(track.looks) - 2, 0, -1)
    return Measurement(
        position=track.center_at(-1),
        velocity=velocity,
        covariance=covariance,
        yaw_rate=float(yaw_rate),
        status=EstimateStatus.CONVERGED if is_measured else EstimateStatus.NOT_CONVERGED,
        hindsight=tuple(Hindsight(track.looks[j].frame, *parked.mixed(*_step(track, j), standing)) for j in earlier),
    )


def _step(track: _Track, j: int) -> tuple[Vector2, Covariance2]:
    """Give the velocity of the centre over the step to look j."""
    j %= len(track.looks)
    seconds = track.place.times[j] - track.place.times[j - 1]
    _, covariance = track.place.step(j)
    _, turn_variance = track.turn.step(j)
    arm = planar.rotation(float(track.turn.state[j, 0, 0])) @ np.array([-track.center[1], track.center[0]])
    covariance = HONEST_SHARE * (covariance + turn_variance * np.outer(arm, arm)) + LEAST_SD**2 * np.eye(2)
    return (track.center_at(j) - track.center_at(j - 1)) / seconds, covariance
