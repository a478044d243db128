"""The estimator `fused`: each look at an object is compared with several earlier ones, and all of it weighed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from registration import planar
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.estimators.fused import parked
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.sources import (
    Evidence,
    Expected,
    Laid,
    Learned,
    Look,
    Shape,
    evidence_of_network,
    thinned,
)
from tracker.estimators.fused.window import Comparison, MotionModel, Square, Vector, Window, solve
from tracker.smoothing import FixedLag, RauchTungStriebel, Smoothing, WindowMean, in_hindsight
from tracker.types import Covariance2, EstimateStatus, Hindsight, Vector2, VelocityEstimate

# Share of the window's covariance that is left when heavy tails are paid for by single errors, not by all of them:
# fitted to the errors on simulated training sequences.
HONEST_SHARE = 0.3
LEAST_SD = 0.01  # of a velocity [m/s]
FIRST_TURN_SD = 0.05  # of a turn between the first two looks [rad]
SEARCHED_TURN_SD = 0.01  # of a turn that is always searched [rad]
MOST_CENTERS = 20  # looks that count for where an object's centre is


@dataclass(frozen=True)
class FusedSettings:
    """From physics and the sensor; what is fitted was fitted on simulated training sequences.

    Attributes:
        motion: of a car: accelerations of 3 m/s^2 that last for a tenth of a second to a second; objects faster than
            30 m/s soon prove it.
        turn: of a car's heading.
        shape_lags: how many looks ago are the points compared by shape; the first is the step itself.
        learned_lags: and by the network.
        offset_floor, offset_sampling, offset_single: standard deviation of what one look at an object is off: in any
            case, of a single point of many, and of a single point that is all that is seen [m].
        offset_near: the same at 1 m from the sensor, falling with the range squared: what is close changes its look
            from scan to scan [m].
        shape_changed, learned_changed: standard deviation of a comparison of looks that share nothing, as when an
            object comes out from behind another one: a part that grows pulls the whole along.  It goes with the square
            of the share of points that came or went, beside those that the range explains [m].
        search_floor: standard deviation of an expected place that is always searched [m].
        search_doubt: factor of an expectation's covariance.
        pose_turn_sd: of the axes' own turn between two frames, as by an error of the ego's heading [rad].
        turns_axes: whether the sensor's axes are known to turn, where there are no poses.
        refers_to_center: whether velocities are those of the centre that the network sees, or of the first middle.
        knows_parked: whether what stands in the world is taken to stand.
    """

    motion: MotionModel = field(default_factory=lambda: MotionModel(density=2.0, rate_sd=15.0))
    turn: MotionModel = field(default_factory=lambda: MotionModel(density=0.02, rate_sd=0.3))
    shape_lags: tuple[int, ...] = (1, 4)
    learned_lags: tuple[int, ...] = (1, 3, 8)
    offset_floor: float = 0.005
    offset_sampling: float = 0.05
    offset_single: float = 1.0
    offset_near: float = 0.5
    shape_changed: float = 2.0
    learned_changed: float = 0.6
    search_floor: float = 0.1
    search_doubt: float = 4.0
    pose_turn_sd: float = 0.001
    turns_axes: bool = True
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
        self._axes = self._steady = Heading(turns=False, n_frames=self.settings.motion.n_frames)

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
        self._begin_frame(sightings)
        for key, track in known.items():
            self._advance(track, sightings[key])
        is_known = self._ask(known, new)
        is_laid = self._compare_shapes(known, new)
        solve([track.turn for track in known.values()], self._steady)
        for key, track in known.items():
            track.looks.append(new[key])
            if self.settings.refers_to_center:
                track.refer_to_center()
        self._start_tracks(sightings, new)
        may_stand = self.settings.knows_parked and next(iter(sightings.values())).in_world
        return {key: _measurement(track, key in is_known or key in is_laid, may_stand) for key, track in known.items()}

    def _begin_frame(self, sightings: Mapping[int, Sighting]) -> None:
        """Go on with the axes if any object does; else begin them anew."""
        in_world = next(iter(sightings.values())).in_world
        if not self._tracks:
            n_frames = self.settings.motion.n_frames
            self._steady = Heading(turns=False, n_frames=n_frames)
            turns = self.settings.turns_axes and not in_world
            self._axes = Heading(turns=True, n_frames=n_frames) if turns else self._steady
        for axes in {id(axes): axes for axes in (self._steady, self._axes)}.values():
            axes.advance(float(np.mean([sighting.timestamp for sighting in sightings.values()])))

    def _look(self, sightings: Mapping[int, Sighting]) -> dict[int, Look]:
        seen = list(sightings.values())
        encoded = self._learned.encode([s.points for s in seen], [s.sensor for s in seen])
        return {
            key: Look(thinned(s.points), len(s.points), s.sensor, learned, self._learned.center(learned), s.frame)
            for (key, s), learned in zip(sightings.items(), encoded, strict=True)
        }

    def _advance(self, track: _Track, sighting: Sighting) -> None:
        """Expect the object where its motion leads, in axes whose own turn is not known exactly."""
        arm = track.place.state[-1, 0] - sighting.sensor
        across = self.settings.pose_turn_sd * np.array([-arm[1], arm[0]])
        time, offset_sd = sighting.timestamp, self._offset_sd(sighting)
        has_left = track.place.advance(time, self._axes, np.outer(across, across), offset_sd)
        track.turn.advance(time, self._steady)
        if has_left:
            track.looks.pop(0)

    def _offset_sd(self, sighting: Sighting) -> float:
        """Say how far what is seen may be off: more where it is little, or close."""
        n, own = len(sighting.points), self.settings
        near = own.offset_near / max(sighting.range_m, 1.0) ** 2
        return float(np.linalg.norm([own.offset_floor, own.offset_sampling / n**0.5, own.offset_single / n, near]))

    def _ask(self, known: Mapping[int, _Track], new: Mapping[int, Look]) -> set[int]:
        """Hear the network's opinion of each object; say of which it has one."""
        own, told = self.settings, set()
        jobs = [(key, lag) for key, track in known.items() for lag in own.learned_lags if lag <= len(track.looks)]
        answers = self._learned.ask([(known[key].looks[-lag], new[key].learned) for key, lag in jobs])
        for (key, lag), answer in zip(jobs, answers, strict=True):
            if answer is not None:
                track = known[key]
                doubt = own.learned_changed * _changed(track, lag, new[key])
                _hear(
                    track,
                    lag,
                    evidence_of_network(answer, track.looks[-lag], new[key], track.place.seen(-1 - lag)).doubted(doubt),
                    self._axes,
                )
                told.add(key)
        solve([known[key].place for key in told], self._axes)
        return told

    def _compare_shapes(self, known: Mapping[int, _Track], new: Mapping[int, Look]) -> set[int]:
        """Lay earlier looks on the new ones; say which objects have any."""
        own, keys = self.settings, list(known)
        jobs = [(i, lag) for i, key in enumerate(keys) for lag in own.shape_lags if lag <= len(known[key].looks)]
        pairs = [
            Laid(
                known[keys[i]].looks[-lag].points,
                i,
                known[keys[i]].place.seen(-1 - lag),
                self._expected(known[keys[i]], new[keys[i]], lag),
            )
            for i, lag in jobs
        ]
        evidence = self._shape.compare(pairs, [new[key] for key in keys])
        for (i, lag), e in zip(jobs, evidence, strict=True):
            track = known[keys[i]]
            _hear(track, lag, e.doubted(own.shape_changed * _changed(track, lag, new[keys[i]])), self._axes)
        solve([track.place for track in known.values()], self._axes)
        return {keys[i] for i, _ in jobs}

    def _expected(self, track: _Track, new: Look, lag: int) -> Expected:
        older = -1 - lag
        place = track.place.seen(older)
        turn = float(track.turn.state[-1, 0, 0] - track.turn.state[older, 0, 0])
        if not track.place.comparisons:
            shift, covariance = (new.points.mean(axis=0) - track.looks[-1].points.mean(axis=0))[:2], None
            doubt = FIRST_TURN_SD**2
        else:
            own = self.settings
            shift = track.place.seen(-1) - place
            covariance = own.search_doubt * track.place.difference(older, is_seen=True)
            covariance = covariance + own.search_doubt * self._swing(track)
            covariance = covariance + own.search_floor**2 * np.eye(2)
            doubt = float(track.turn.difference(older)[0, 0]) + SEARCHED_TURN_SD**2
        return Expected(planar.to_transform(np.array([*shift, turn]), np.array([*place, 0.0])), covariance, doubt)

    def _swing(self, track: _Track) -> Square:
        """Give the covariance of where an object is that the axes' own turn adds [m^2]."""
        x, y = track.place.seen(-1)
        return self._axes.step_variance() * np.array([[y * y, -x * y], [-x * y, x * x]])

    def _start_tracks(self, sightings: Mapping[int, Sighting], new: Mapping[int, Look]) -> None:
        own = self.settings
        for key, sighting in sightings.items():
            if key in self._tracks:
                continue
            points, time = new[key].points, sighting.timestamp
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))[:2]
            place = Window.start(own.motion, time, self._axes, middle, self._offset_sd(sighting))
            turn = Window.start(own.turn, time, self._steady, np.zeros(1))
            self._tracks[key] = _Track(place, turn, [new[key]])
            if own.refers_to_center:
                self._tracks[key].refer_to_center()


def _changed(track: _Track, lag: int, new: Look) -> float:
    """Say how much of what is seen of an object came or went, beside what its range explains: from 0 to 1, squared."""
    older = track.looks[-lag]
    before, now = (  # as many points as would be seen from 1 m
        look.n_points * float(np.sum((track.place.seen(frame) - look.sensor) ** 2))
        for look, frame in ((older, -1 - lag), (new, -1))
    )
    return (1.0 - min(before, now) / max(before, now)) ** 2


def _hear(track: _Track, lag: int, evidence: Evidence, axes: Heading) -> None:
    """Take evidence about an object into account."""
    newest = len(track.place) - 1
    older = newest - lag
    if newest == 1:
        track.place.place_last(track.place.seen(0) + evidence.step)
    track.place.compare(Comparison(older, newest, track.place.seen(older), evidence.step, evidence.information))
    if np.isfinite(evidence.turn_variance):
        turn, information = np.array([evidence.turn]), np.array([[1.0 / evidence.turn_variance]])
        track.turn.compare(Comparison(older, newest, np.zeros(1), turn, information))
        axes.hear(track.place.axes[older], evidence.turn, evidence.turn_variance)


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
