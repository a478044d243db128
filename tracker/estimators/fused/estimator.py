"""The estimator `fused`: each look at an object is compared with several earlier ones, and all of it weighed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from registration import planar
from registration.methods.plane_icp import PointToPlaneICP
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.estimators.fused import parked, scene
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.look import Look, looked_at
from tracker.estimators.fused.sensor import Sensor
from tracker.estimators.fused.solving import solve
from tracker.estimators.fused.sources import (
    PLANES,
    Expected,
    Laid,
    Learned,
    Shape,
    evidence_of_network,
)
from tracker.estimators.fused.track import Steps, Track
from tracker.estimators.fused.window import MotionModel, Square
from tracker.smoothing import FixedLag, RauchTungStriebel, Smoothing, WindowMean, in_hindsight
from tracker.types import EstimateStatus, Hindsight, VelocityEstimate

FIRST_TURN_SD = 0.05  # of a turn between the first two looks [rad]
ONE = np.eye(2)
SEARCHED_TURN_SD = 0.01  # of a turn that is always searched [rad]


@dataclass(frozen=True)
class FusedSettings:
    """From physics and the sensor; what is fitted was fitted on simulated training sequences.

    Attributes:
        motion: of a car: accelerations of 2.6 m/s^2 that last for a tenth of a second, of 1.2 m/s^2 that last for half
            of one, and that change by 0.8 m/s^2 in a tenth of a second; objects faster than 30 m/s soon prove it.
            Without a world, velocities are relative to a sensor that moves as fast.
        turn: of a car's heading.
        planes: how shapes are laid on each other.
        shape_lags: how many looks ago are the points compared by shape; the first is the step itself.
        learned_lags: and by the network.
        shape_changed, learned_changed: standard deviation of a comparison of looks that share nothing, by histograms
            and by the network, as when an object comes out from behind another one: a part that grows pulls the whole
            along.  It goes with the square of the share of points that came or went, beside those that the range
            explains [m].
        single_point: standard deviation of where an object is by a single point of it; by n points, an n-th of that:
            which of its points are seen is chance [m].  These three are of a single comparison; see `_doubt`.
        shape_turned, learned_turned: standard deviation of a comparison along the way between the looks relative to the
            sensor, by histograms or planes and by the network, for each radian that the object turned against the line
            of sight: other sides of it are seen [m/rad].
        shape_moved: standard deviation of a comparison by shape along that way, as a share of it: other lasers meet the
            object.
        untimed_moved: the same where nobody knows when each laser fires.
        torn: standard deviation of a comparison by shape with a look of which the end of a sweep saw a part, and the
            start of the same one the rest: its label's box, of one moment, cuts off some of either [m].
        search_floor: standard deviation of an expected place that is always searched [m].
        search_doubt: factor of an expectation's covariance.
        covariance_share: that errors have of the windows' covariances.
        simulated_share: the same on simulated scans: near and far, slow and fast, of training sequences and scenes.
        pose_turn_sd: of the axes' own turn between two frames, as by an error of the ego's heading [rad].
        weighs_looks: whether looks may be off as a whole, and what contradicts an expected place is searched for.
        undoes_sweep: whether what objects and the sensor move until the beams pass them is undone, where scans are raw
            sweeps.
        knows_lasers: whether it is known, for that, when each laser fires; else all do as the sensor's head passes.
        turns_axes: whether the sensor's axes are known to turn, where there are no poses.
        refers_to_center: whether velocities are those of the centre that the network sees, or of the first middle.
        knows_parked: whether velocities are weighed with how fast objects are before they are measured; and what stands
            is taken to stand in the world, or to move as most objects do without a world.
    """

    motion: MotionModel = field(default_factory=lambda: MotionModel(density=0.7, rate_sd=15.0, change=7.0))
    turn: MotionModel = field(default_factory=lambda: MotionModel(density=0.02, rate_sd=0.3, claimed=math.inf))
    planes: PointToPlaneICP = PLANES
    shape_lags: tuple[int, ...] = (1, 4)
    learned_lags: tuple[int, ...] = (1, 3, 8)
    shape_changed: float = 0.7
    learned_changed: float = 0.5
    single_point: float = 0.25
    shape_turned: float = 0.01
    learned_turned: float = 0.2
    shape_moved: float = 0.002
    untimed_moved: float = 0.008
    torn: float = 0.02
    search_floor: float = 0.1
    search_doubt: float = 8.0
    covariance_share: float = 1.0
    simulated_share: float = 0.55
    pose_turn_sd: float = 0.001
    weighs_looks: bool = True
    undoes_sweep: bool = True
    knows_lasers: bool = True
    turns_axes: bool = True
    refers_to_center: bool = True
    knows_parked: bool = True

    def __post_init__(self) -> None:
        """Refuse lags that cannot work."""
        lags = (*self.shape_lags, *self.learned_lags)
        if not lags or min(lags) < 1 or max(lags) >= self.motion.n_frames:
            raise ValueError(f"expected lags of 1 to {self.motion.n_frames - 1} frames, got {lags}")


class FusedEstimator(FrameEstimator):
    """Weigh comparisons of an object with its own past, several frames back, by shape and by AlignNet.

    A step between neighbouring scans is precise to centimetres, which are decimetres a second; the same centimetres
    over eight scans are a tenth of that, if the motion between is smooth.  A `Window` of the last frames finds the
    places that agree with all comparisons and with a motion of nearly constant velocity, where single comparisons
    and accelerations may be far off (Student's t).  Nothing is accumulated that a wrong velocity could smear.

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
        self.undoes_sweep = self.settings.undoes_sweep
        self._shape, self._learned = Shape(self.settings.planes), Learned()
        self._tracks: dict[int, Track] = {}
        self._axes = Heading(turns=False, n_frames=self.settings.motion.n_frames)
        self._common = scene.UNKNOWN  # how all that stands moves, where there are no poses
        self._sensor: Sensor | None = None  # in the latest frame

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
        known = {key: self._tracks[key] for key in sightings if key in self._tracks}
        new = self._look(sightings, self._begin_frame(sightings))
        for key, track in known.items():
            pose_turn_sd = 0.0 if self._axes.turns else self.settings.pose_turn_sd
            track.advance(new[key], self._axes, pose_turn_sd)
        is_known = self._ask(known, new)
        is_laid = self._compare_shapes(known, new)
        solve([track.turn for track in known.values()])
        for key, track in known.items():
            if self.settings.weighs_looks:
                track.place.weigh_look(self._axes)
            track.looks.append(new[key])
            if self.settings.refers_to_center:
                track.refer_to_center()
            track.note_met()
        self._start_tracks(sightings, new)
        steps = self._steps(known, next(iter(sightings.values())))
        return {key: _measurement(steps[key], key in is_known or key in is_laid) for key in known}

    def _steps(self, known: Mapping[int, Track], any_one: Sighting) -> dict[int, Steps]:
        """Read all velocities; what stands is taken to stand, in the world, or to move as others that stand do."""
        share = self.settings.simulated_share if any_one.is_simulated else self.settings.covariance_share
        steps = {key: track.steps(share) for key, track in known.items()}
        if self.settings.knows_parked and steps:
            own = list(steps.values())
            if any_one.in_world:
                settled = parked.settle([track.place for track in known.values()], own)
            else:
                settled, self._common = scene.settle(own, self._common)
            steps = dict(zip(steps, settled, strict=True))
        return {key: s.told() for key, s in steps.items()}

    def _begin_frame(self, sightings: Mapping[int, Sighting]) -> Sensor:
        """Go on with the axes if any object does, else begin them anew; tell how the sensor moves."""
        any_one = next(iter(sightings.values()))
        if not self._tracks:
            turns = self.settings.turns_axes and not any_one.in_world
            self._axes = Heading(turns=turns, n_frames=self.settings.motion.n_frames)
            self._common, self._sensor = scene.UNKNOWN, None
        self._axes.advance(any_one.frame_timestamp)
        now, before = Sensor(any_one.sensor, any_one.sensor_yaw), self._sensor
        if before is not None:
            seconds = self._axes.times[-1] - self._axes.times[-2]
            self._common = self._common.later(seconds)
            now = now.since(before, seconds)
            if not before.is_moving:  # what it saw then is put right
                for track in self._tracks.values():
                    track.looks[-1] = track.looks[-1].seen_by(before.as_of(now))
        self._sensor = now
        return now

    def _look(self, sightings: Mapping[int, Sighting], sensor: Sensor) -> dict[int, Look]:
        encoded = self._learned.encode(list(sightings.values()))
        return {
            key: looked_at(sighting, sensor, learned, self.settings.knows_lasers)
            for (key, sighting), learned in zip(sightings.items(), encoded, strict=True)
        }

    def _ask(self, known: Mapping[int, Track], new: Mapping[int, Look]) -> set[int]:
        """Hear the network's opinions of each object; say of which it has one."""
        jobs = self._jobs(known, self.settings.learned_lags)
        answers = self._learned.ask([(known[key].looks[-lag], new[key]) for key, lag in jobs])
        told = {}
        for (key, lag), answer in zip(jobs, answers, strict=True):
            if answer is not None:
                track = known[key]
                evidence = evidence_of_network(answer, track.looks[-lag], new[key], track.place.at(-1 - lag))
                doubts = self.settings.learned_changed, self.settings.learned_turned, 0.0
                doubt = self._doubt(doubts, track, lag, new[key])
                track.hear(lag, evidence, doubt, self._axes)
                told[key] = track
        solve([track.place for track in told.values()], self._axes)
        return set(told)

    def _compare_shapes(self, known: Mapping[int, Track], new: dict[int, Look]) -> set[int]:
        """Lay earlier looks on the new ones, which are straightened; say of which objects there are any."""
        if self.settings.undoes_sweep:
            new.update((key, track.straighten(new[key])) for key, track in known.items())
        jobs, number = self._jobs(known, self.settings.shape_lags), {key: i for i, key in enumerate(known)}
        laid = []
        for key, lag in jobs:
            track, expected = known[key], self._expected(known[key], new[key], lag)
            laid.append(Laid(track.looks[-lag], number[key], track.place.at(-1 - lag), expected))
        found = self._shape.compare(laid, [new[key] for key in known])
        for (key, lag), evidence in zip(jobs, found, strict=True):
            by_change = self.settings.shape_changed if evidence.was_searched else 0.0
            by_way = self.settings.shape_moved if new[key].is_timed else self.settings.untimed_moved
            doubt = self._doubt((by_change, self.settings.shape_turned, by_way), known[key], lag, new[key])
            if new[key].is_torn or known[key].looks[-lag].is_torn:
                doubt = doubt + self.settings.torn**2 * ONE
            known[key].hear(lag, evidence, doubt, self._axes)
        solve([track.place for track in known.values()], self._axes)
        return {key for key, _ in jobs}

    def _doubt(self, doubts: tuple[float, float, float], track: Track, lag: int, new: Look) -> Square:
        """Give the covariance that looks which differ, few points and a long way add to a comparison [m^2].

        Args:
            doubts: standard deviations by change, where nothing is shared; by turns, for each radian; by the way, for
                each metre.
            track: of the object.
            lag: how many looks ago the earlier one was.
            new: the later one.

        All comparisons with a look share the error that it has since it shows few points, or fewer than the other: it
        counts for so many times its variance as there are comparisons, so that many are worth no more than one.
        """
        (by_change, by_turn, by_way), before, single = doubts, track.looks[-lag], self.settings.single_point
        older = math.sqrt(1.0 + track.place.n_told(lag))
        n_lags = (len(_lags(len(track.looks), lags)) for lags in (self.settings.learned_lags, self.settings.shape_lags))
        newer = math.sqrt(sum(n_lags))
        changed = by_change * track.changed(lag, new) * (older if before.n_from_1m < new.n_from_1m else newer)
        x, y = track.way(lag, new).tolist()
        length = math.hypot(x, y)
        share = math.hypot(by_way, by_turn * track.turned(lag, new) / length) if length > 0.0 else 0.0
        x, y = share * x, share * y
        everywhere = changed**2 + (older * single / before.n_points) ** 2 + (newer * single / new.n_points) ** 2
        return np.array([[everywhere + x * x, x * y], [x * y, everywhere + y * y]])

    def _jobs(self, known: Mapping[int, Track], lags: tuple[int, ...]) -> list[tuple[int, int]]:
        """List which looks are compared with the new ones; of a track that is not long enough yet, the first."""
        return [(key, lag) for key, track in known.items() for lag in _lags(len(track.looks), lags)]

    def _expected(self, track: Track, new: Look, lag: int) -> Expected:
        older = -1 - lag
        place = track.place.at(older)
        turn = float(track.turn.state[-1, 0, 0] - track.turn.state[older, 0, 0])
        if not track.place.comparisons:
            shift, covariance = (new.points.mean(axis=0) - track.looks[-1].points.mean(axis=0))[:2], None
            doubt = FIRST_TURN_SD**2
        else:
            own = self.settings
            shift = track.place.at(-1) - place
            covariance = own.search_doubt * track.step_covariance(lag)
            covariance = covariance + own.search_doubt * self._swing(track) + own.search_floor**2 * ONE
            doubt = float(track.turn.difference(older)[0, 0]) + SEARCHED_TURN_SD**2
        T = planar.to_transform(np.array([*shift, turn]), np.array([*place, 0.0]))
        contrary = self.settings.search_doubt * self.settings.weighs_looks * track.place.told.spread()
        return Expected(T, covariance, doubt, contrary)

    def _swing(self, track: Track) -> Square:
        """Give the covariance of where an object is that the axes' own turn adds [m^2]."""
        x, y = track.place.at(-1)
        return self._axes.step_variance() * np.array([[y * y, -x * y], [-x * y, x * x]])

    def _start_tracks(self, sightings: Mapping[int, Sighting], new: Mapping[int, Look]) -> None:
        own = self.settings
        for key, sighting in sightings.items():
            if key in self._tracks:
                continue
            rate_sd = own.motion.rate_sd * (1.0 if sighting.in_world else math.sqrt(2.0))
            models = replace(own.motion, rate_sd=rate_sd), own.turn
            self._tracks[key] = Track.start(models, new[key], self._axes)
            if own.refers_to_center:
                self._tracks[key].refer_to_center()
            self._tracks[key].note_met()


@cache
def _lags(n_looks: int, lags: tuple[int, ...]) -> tuple[int, ...]:
    """Say how many looks ago a track of so many looks is compared; the first one stands for those before it."""
    return tuple(sorted({min(lag, n_looks) for lag in lags}))


def _measurement(steps: Steps, is_measured: bool) -> Measurement:
    """Give the step to the latest look, and what is now known of those before."""
    hindsight = zip(steps.frames.tolist(), steps.velocities, steps.covariances, strict=True)
    return Measurement(
        position=steps.center,
        velocity=steps.velocities[-1],
        covariance=steps.covariances[-1],
        yaw_rate=steps.yaw_rate,
        status=EstimateStatus.CONVERGED if is_measured else EstimateStatus.NOT_CONVERGED,
        hindsight=tuple(Hindsight(*step) for step in list(hindsight)[-2::-1]),
    )
