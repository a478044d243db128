"""The estimator `fused`: each look at an object is compared with several earlier ones, and all of it weighed."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from registration.methods.plane_icp import PointToPlaneICP
from tracker.estimators.contract import FrameEstimator, Measurement, Sighting
from tracker.estimators.fused import parked, scene, steps
from tracker.estimators.fused.comparisons import ascending, expected, hear, looks_of, paired
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.look import Look, looked_at
from tracker.estimators.fused.pair_kernels import Doubts, Found, Pairs
from tracker.estimators.fused.sensor import Sensor
from tracker.estimators.fused.solving import solve
from tracker.estimators.fused.sources import PLANES, Evidence, Laid, Learned, Shape
from tracker.estimators.fused.steps import Steps
from tracker.estimators.fused.track import Track, Tracks, straightened
from tracker.estimators.fused.window import MotionModel, Rows
from tracker.smoothing import FixedLag, RauchTungStriebel, Smoothing, WindowMean, in_hindsight
from tracker.types import VelocityEstimate

Flags = Bool[np.ndarray, " m"]


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
            `pair_kernels.hear`.
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
    over eight scans are a tenth of that, if the motion between is smooth.  A window of the last frames finds the
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
        self._known = Tracks(self.settings.motion, self.settings.turn)
        self._lags = ascending(self.settings.learned_lags), ascending(self.settings.shape_lags)
        self._axes = Heading(turns=False, n_frames=self.settings.motion.n_frames)
        self._common = scene.UNKNOWN  # how all that stands moves, where there are no poses
        self._sensor: Sensor | None = None  # in the latest frame

    def forget(self, track_id: int) -> None:
        """Drop a track."""
        track = self._tracks.pop(track_id, None)
        if track is not None:
            self._known.drop(track)

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
        at, tracks, looks = _rows(known.values()), list(known.values()), [new[key] for key in known]
        self._known.advance(at, looks, self._axes, 0.0 if self._axes.turns else self.settings.pose_turn_sd)
        told = self._ask(at, tracks, looks)
        if self.settings.undoes_sweep:
            looks = straightened(self._known, tracks, at, looks)
        told |= self._compare_shapes(at, tracks, looks)
        solve(self._known.turns, at)
        if self.settings.weighs_looks:
            self._known.places.weigh_looks(at, self._axes)
        for track, look in zip(tracks, looks, strict=True):
            track.append(look, self.settings.motion.n_frames)
        self._known.look_back(at, looks, self.settings.refers_to_center)
        self._start_tracks(sightings, new)
        return steps.measurements(list(known), self._steps(at, next(iter(sightings.values()))), told)

    def _steps(self, at: Rows, any_one: Sighting) -> Steps:
        """Read all velocities; what stands is taken to stand, in the world, or to move as others that stand do."""
        share = self.settings.simulated_share if any_one.is_simulated else self.settings.covariance_share
        found = steps.read(self._known, at, share)
        if self.settings.knows_parked and any_one.in_world:
            found = parked.settle(self._known.places, at, found)
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
            self._common = self._common if any_one.in_world else self._common.later(seconds)
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

    def _ask(self, at: Rows, tracks: Sequence[Track], looks: Sequence[Look]) -> set[int]:
        """Hear the network's opinions of objects; give the numbers of those of which it has one."""
        own, (lags, others) = self.settings, self._lags
        pairs = paired(self._known, at, lags, others)
        if not len(pairs.lags):
            return set()
        found = self._learned.ask(looks_of(tracks, looks, pairs), pairs.olders)
        told = np.isfinite(found.turn_variances)
        doubts = Doubts(own.learned_changed, own.learned_turned, 0.0, 0.0, 0.0, own.single_point)
        self._hear(pairs, found, np.ones(len(told), np.bool_), told, doubts)
        numbers = sorted(set(pairs.owners[told].tolist()))
        solve(self._known.places, at[numbers], self._axes)
        return set(numbers)

    def _compare_shapes(self, at: Rows, tracks: Sequence[Track], looks: Sequence[Look]) -> set[int]:
        """Lay earlier looks on the latest ones, and solve; give the numbers of the objects of which there are any."""
        own, (others, lags) = self.settings, self._lags
        pairs = paired(self._known, at, lags, others)
        if len(pairs.lags):
            found = self._shape.compare(self._laid(tracks, looks, pairs), looks)
            ways = own.shape_moved, own.untimed_moved
            doubts = Doubts(own.shape_changed, own.shape_turned, *ways, own.torn, own.single_point)
            self._hear(pairs, found, found.was_searched, np.ones(len(pairs.lags), np.bool_), doubts)
        solve(self._known.places, at, self._axes)
        return set(pairs.owners.tolist())

    def _hear(self, pairs: Pairs, found: Evidence, may_change: Flags, told: Flags, doubts: Doubts) -> None:
        """Tell objects of comparisons that tell anything, and their axes of the turns.

        Args:
            pairs: that were compared.
            found: what was found.
            may_change: whether looks that share nothing are less sure.
            told: which are told of at all.
            doubts: about all.
        """
        turns, variances = found.turns, found.turn_variances
        hear(self._known, pairs, Found(found.steps, found.informations, turns, variances, may_change, told), doubts)
        if self._axes.turns:
            turned, frames = np.flatnonzero(told & np.isfinite(variances)), self._known.places.rows.frames
            rows = pairs.rows[turned]
            olders = frames.axes[rows, frames.sizes[rows] - 1 - pairs.lags[turned]]
            self._axes.hear(olders.tolist(), turns[turned], variances[turned])

    def _laid(self, tracks: Sequence[Track], looks: Sequence[Look], pairs: Pairs) -> Laid:
        """Say where earlier looks are expected in the latest ones."""
        own, owners, shifts = self.settings, pairs.owners.tolist(), pairs.newers - pairs.olders
        search, swing = (own.search_floor, own.search_doubt), self._axes.step_variance()
        is_expected, covariances, turn_variances, contraries = expected(self._known, pairs, search, swing)
        for m in np.flatnonzero(~is_expected).tolist():
            before, now = tracks[owners[m]].looks[-1].points, looks[owners[m]].points
            shifts[m] = (now.mean(axis=0) - before.mean(axis=0))[:2]
        return Laid(
            earlier=[before for before, _ in looks_of(tracks, looks, pairs)],
            newer=owners,
            places=pairs.olders,
            shifts=shifts,
            turns=pairs.turns,
            covariances=covariances,
            is_expected=is_expected,
            turn_variances=turn_variances,
            contraries=contraries if own.weighs_looks else np.zeros_like(contraries),
        )

    def _start_tracks(self, sightings: Mapping[int, Sighting], new: Mapping[int, Look]) -> None:
        keys = [key for key in sightings if key not in self._tracks]
        if not keys:
            return
        any_one, looks = sightings[keys[0]], [new[key] for key in keys]
        rate_sd = self.settings.motion.rate_sd * (1.0 if any_one.in_world else math.sqrt(2.0))
        tracks = self._known.start(looks, self._axes, rate_sd)
        self._tracks.update(zip(keys, tracks, strict=True))
        self._known.look_back(_rows(tracks), looks, self.settings.refers_to_center)


def _rows(tracks: Iterable[Track]) -> Rows:
    return np.array([track.row for track in tracks], dtype=np.int64)
