"""The estimator `fused`: each look at an object is compared with several earlier ones, and all of it weighed."""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64, Int64

from registration.methods.plane_icp import PointToPlaneICP
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.estimators.fused import parked, scene, steps
from tracker.estimators.fused.comparisons import Doubts, Pairs, doubted, lags_of, paired
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.look import Look, looked_at
from tracker.estimators.fused.sensor import Sensor
from tracker.estimators.fused.solving import solve
from tracker.estimators.fused.sources import PLANES, Evidence, Laid, Learned, Shape
from tracker.estimators.fused.steps import Steps
from tracker.estimators.fused.track import Track, note_met, straightened
from tracker.estimators.fused.window import MotionModel
from tracker.smoothing import FixedLag, RauchTungStriebel, Smoothing, WindowMean, in_hindsight
from tracker.types import EstimateStatus, Hindsight, VelocityEstimate

Numbers = Float64[np.ndarray, " m"]

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
            which of its points are seen is chance [m].  These three are of a single comparison; see
            `comparisons.doubted`.
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
        if not known:
            self._start_tracks(sightings, new)
            return {}
        tracks, looks = list(known.values()), [new[key] for key in known]
        pose_turn_sd = 0.0 if self._axes.turns else self.settings.pose_turn_sd
        for track, look in zip(tracks, looks, strict=True):
            track.advance(look, self._axes, pose_turn_sd)
        told = self._ask(tracks, looks)
        if self.settings.undoes_sweep:
            looks = straightened(tracks, looks)
        told |= self._compare_shapes(tracks, looks)
        solve([track.turn for track in tracks])
        for track, look in zip(tracks, looks, strict=True):
            if self.settings.weighs_looks:
                track.place.weigh_look(self._axes)
            track.looks.append(look)
            if self.settings.refers_to_center:
                track.refer_to_center()
        note_met(tracks)
        self._start_tracks(sightings, new)
        return _measurements(list(known), self._steps(tracks, next(iter(sightings.values()))), told)

    def _steps(self, known: Sequence[Track], any_one: Sighting) -> Steps:
        """Read all velocities; what stands is taken to stand, in the world, or to move as others that stand do."""
        share = self.settings.simulated_share if any_one.is_simulated else self.settings.covariance_share
        found = steps.read(known, share)
        if self.settings.knows_parked and any_one.in_world:
            found = parked.settle([track.place for track in known], found)
        elif self.settings.knows_parked:
            found, self._common = scene.settle(found, self._common)
        return found.told()

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
        seen = list(sightings.values())
        looks = looked_at(seen, sensor, self._learned.encode(seen), self.settings.knows_lasers)
        return dict(zip(sightings, looks, strict=True))

    def _ask(self, tracks: Sequence[Track], looks: Sequence[Look]) -> set[int]:
        """Hear the network's opinions of objects; give the numbers of those of which it has one."""
        own, pairs = self.settings, paired(tracks, looks, self.settings.learned_lags)
        if not len(pairs):
            return set()
        found = self._learned.ask(list(zip(pairs.before, pairs.now, strict=True)), pairs.olders)
        m, told = len(pairs), np.flatnonzero(np.isfinite(found.turn_variances))
        doubts = doubted(pairs, self._doubts(tracks, np.full(m, own.learned_changed), own.learned_turned, np.zeros(m)))
        self._hear(tracks, pairs, told, found, doubts)
        numbers = dict.fromkeys(pairs.owners[told].tolist())
        solve([tracks[k].place for k in numbers], self._axes)
        return set(numbers)

    def _compare_shapes(self, tracks: Sequence[Track], looks: Sequence[Look]) -> set[int]:
        """Lay earlier looks on the latest ones, and solve; give the numbers of the objects of which there are any."""
        pairs = paired(tracks, looks, self.settings.shape_lags)
        if len(pairs):
            self._lay(tracks, looks, pairs)
        solve([track.place for track in tracks], self._axes)
        return set(pairs.owners.tolist())

    def _lay(self, tracks: Sequence[Track], looks: Sequence[Look], pairs: Pairs) -> None:
        own, found = self.settings, self._shape.compare(self._laid(tracks, looks, pairs), looks)
        by_change = np.where(found.was_searched, own.shape_changed, 0.0)
        by_way = np.where([look.is_timed for look in pairs.now], own.shape_moved, own.untimed_moved)
        doubts = doubted(pairs, self._doubts(tracks, by_change, own.shape_turned, by_way))
        is_torn = [a.is_torn or b.is_torn for a, b in zip(pairs.before, pairs.now, strict=True)]
        doubts[is_torn] += own.torn**2 * ONE
        self._hear(tracks, pairs, np.arange(len(pairs)), found, doubts)

    def _doubts(self, tracks: Sequence[Track], by_change: Numbers, by_turn: float, by_way: Numbers) -> Doubts:
        lags = self.settings.learned_lags, self.settings.shape_lags
        n_lags = [sum(len(lags_of(len(track.looks), own)) for own in lags) for track in tracks]
        return Doubts(by_change, by_turn, by_way, self.settings.single_point, np.array(n_lags))

    def _hear(
        self,
        tracks: Sequence[Track],
        pairs: Pairs,
        told: Int64[np.ndarray, " t"],
        found: Evidence,
        doubts: Float64[np.ndarray, "m 2 2"],
    ) -> None:
        """Tell objects of those comparisons that tell anything."""
        firsts, m = pairs.olders + found.steps, len(pairs)
        steps = np.concatenate([pairs.olders, firsts, found.informations.reshape(m, 4), doubts.reshape(m, 4)], axis=1)
        turns = np.column_stack([np.zeros(m), found.turns, 1.0 / found.turn_variances, np.zeros(m)])
        is_step, is_turn = (found.informations != 0.0).any(axis=(1, 2)), np.isfinite(found.turn_variances)
        owners, lags = pairs.owners.tolist(), pairs.lags.tolist()
        for k in told.tolist():
            step, turn = steps[k] if is_step[k] else None, turns[k] if is_turn[k] else None
            tracks[owners[k]].hear(lags[k], step, firsts[k], turn)
        turned = told[is_turn[told]]
        olders = [tracks[owners[k]].place.axes[-1 - lags[k]] for k in turned.tolist()]
        self._axes.hear(olders, found.turns[turned], found.turn_variances[turned])

    def _laid(self, tracks: Sequence[Track], looks: Sequence[Look], pairs: Pairs) -> Laid:
        """Say where earlier looks are expected in the latest ones."""
        own, owners, lags = self.settings, pairs.owners.tolist(), pairs.lags.tolist()
        is_expected = np.array([bool(track.place.comparisons) for track in tracks])[pairs.owners]
        shifts, turn_variances = pairs.newers - pairs.olders, np.full(len(pairs), FIRST_TURN_SD**2)
        covariances = np.zeros((len(pairs), 2, 2))
        for m in np.flatnonzero(is_expected).tolist():
            place, turn, older = tracks[owners[m]].place, tracks[owners[m]].turn, -1 - lags[m]
            covariances[m] = place.difference(older)
            turn_variances[m] = turn.difference(older)[0, 0] + SEARCHED_TURN_SD**2
        for m in np.flatnonzero(~is_expected).tolist():
            before, now = tracks[owners[m]].looks[-1].points, looks[owners[m]].points
            shifts[m] = (now.mean(axis=0) - before.mean(axis=0))[:2]
        across = pairs.newers[:, ::-1] * [-1.0, 1.0]  # as the axes' own turn swings objects
        swing = self._axes.step_variance() * across[:, :, None] * across[:, None, :]
        contraries = np.array([track.place.told.spread() for track in tracks])[pairs.owners]
        return Laid(
            earlier=pairs.before,
            newer=owners,
            places=pairs.olders,
            shifts=shifts,
            turns=pairs.turns,
            covariances=is_expected[:, None, None]
            * (own.search_doubt * (covariances + swing) + own.search_floor**2 * ONE),
            is_expected=is_expected,
            turn_variances=turn_variances,
            contraries=own.search_doubt * own.weighs_looks * contraries,
        )

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
            note_met([self._tracks[key]])


def _measurements(keys: Sequence[int], found: Steps, measured: Set[int]) -> dict[int, Measurement]:
    """Give each object's step to its latest look, and what is now known of those before.

    Args:
        keys: of the objects.
        found: their steps.
        measured: numbers of those of which anything was measured.
    """
    ends, frames, measurements = found.ends.tolist(), found.frames.tolist(), {}
    for k, (key, begin, end) in enumerate(zip(keys, [0, *ends[:-1]], ends, strict=True)):
        words = [Hindsight(frames[i], found.velocities[i], found.covariances[i]) for i in range(end - 1, begin - 1, -1)]
        measurements[key] = Measurement(
            position=found.centers[k],
            velocity=words[0].velocity,
            covariance=words[0].covariance,
            yaw_rate=float(found.yaw_rates[k]),
            status=EstimateStatus.CONVERGED if k in measured else EstimateStatus.NOT_CONVERGED,
            hindsight=tuple(words[1:]),
        )
    return measurements
