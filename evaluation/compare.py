"""Velocity estimators side by side: the same segments, the same truth, the same steps scored."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from time import perf_counter

import numpy as np
from jaxtyping import Float64

from evaluation.scored import Key, Scored, pair_with_truth
from evaluation.truth import TRUTHS, TrueVelocity, true_velocities
from tracker.ego_motion.common_mode import with_pose_covariance
from tracker.ego_motion.modes import EgoConfig, with_ego
from tracker.errors import InputError
from tracker.estimators import CAUSAL, SMOOTHINGS, Estimator, create_estimator, create_smoothing
from tracker.kitti import KittiSequence, check_classes, check_poses, open_sequences, sequence_names
from tracker.kitti.splits import SPLITS, in_split
from tracker.kitti.truth import read_truth
from tracker.store import SegmentStore, cut_sequence
from tracker.tracklets import of_classes
from tracker.types import SENSOR, WORLD, EstimateStatus, SegmentedFrame, VelocityEstimate

Progress = Callable[[str, int, int], None]  # what is under way, how much of it is done, of how much
AUTO = "auto"
WARM_UP_FRAMES = 3


@dataclass(frozen=True)
class CompareConfig:
    """What to compare, and against what."""

    sequences: tuple[str, ...] = ()  # names; empty: all that have scans
    classes: tuple[str, ...] = ("Car", "Van")
    estimators: tuple[str, ...] = ("centroid-kf", "icp")
    smoothing: tuple[str, ...] = ("causal", "window", "rts")
    window: int = 1  # half width of the window mean [frames]; the paper's is 1
    frame: str = WORLD  # world, or sensor: relative to the ego, as in the papers
    truth: str = AUTO  # labels, smoothed or exact; auto: exact where a simulator wrote it, smoothed elsewhere
    ranges: tuple[float, ...] = (80.0, 20.0, 5.0)  # upper ends of the table's ranges [m]
    split: str = "all"  # one of tracker.kitti.splits.SPLITS
    clock: str = AUTO  # recorded stamps where there are any, or `nominal`: 10 Hz
    seed: int = 0  # for methods that draw random numbers
    ego: str = AUTO  # where the ego's poses come from: one of tracker.ego_motion.modes.EGO_MODES
    deskew: bool = False  # move each object's points to one instant by the ego's motion during the sweep
    correct_beam_angles: bool = False  # in odometry: KITTI's 0.205 degrees

    def __post_init__(self) -> None:
        """Refuse names that do not exist and lists that are empty, before any work is done."""
        _one_of("frame", self.frame, (WORLD, SENSOR))
        _one_of("truth", self.truth, (AUTO, *TRUTHS))
        _one_of("split", self.split, SPLITS)
        for name in self.smoothing:
            _one_of("smoothing", name, SMOOTHINGS)
        for field in ("classes", "estimators", "smoothing", "ranges"):
            check_list(field, getattr(self, field))
        check_list("sequences", self.sequences, may_be_empty=True)
        check_ranges(self.ranges)
        if self.window < 0:
            raise InputError(f"window must be 0 or more frames, got {self.window}")
        for name in self.estimators:
            create_estimator(name)
        _ = self.ego_config

    @property
    def ego_config(self) -> EgoConfig:
        """The settings of the ego's poses."""
        return EgoConfig(self.ego, self.deskew, self.correct_beam_angles)


@dataclass(frozen=True)
class SequenceSummary:
    """What a sequence consists of, for the heading of a table and for pictures.

    Attributes:
        n_without_points: steps left out because a segment at either end is empty.
        n_parked, n_tracks: tracks scored.
        flagged_poses: frames whose pose is a guess.
        ego_path: horizontal positions of the sensor (n, 2) in the comparison's frame [m]; zeros in SENSOR.
    """

    name: str
    n_frames: int
    missing_scans: tuple[int, ...]
    clock: str
    ego: str
    n_without_points: int
    n_tracks: int
    n_parked: int
    flagged_poses: tuple[int, ...]
    ego_path: Float64[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Comparison:
    """The outcome of `compare`: scored steps, and what they were made of."""

    root: Path
    config: CompareConfig
    truth: str
    sequences: tuple[SequenceSummary, ...]
    scored: tuple[Scored, ...]
    without_scans: tuple[str, ...] = ()  # sequences below the root that were passed over


def compare(root: Path, config: CompareConfig, cache: Path, progress: Progress | None = None) -> Comparison:
    """Run estimators over sequences and pair each estimate with its truth.

    A step from frame k - 1 to k is scored when the object has a box and points in both; every estimator is
    scored on the same steps, with its fallback where it abstains.

    Args:
        root: a KITTI tracking folder or raw drives.
        config: what to compare.
        cache: where cut segments are kept; resumable.
        progress: told of every frame.

    Raises:
        InputError: an unknown sequence, or nothing to score.
        TrackerError, RegistrationError: data or a method that cannot be used; the message says which.
    """
    sequences = open_sequences(root, config.sequences, config.clock, config.ego_config.recorded)
    check_classes(sequences, config.classes)
    in_world = config.frame == WORLD
    sequences = [with_ego(s, config.ego_config, cache / "ego-motion", in_world, progress) for s in sequences]
    if in_world:
        check_poses(sequences)
    opened = {sequence.name for sequence in sequences}
    without_scans = tuple(name for name in sequence_names(root) if not config.sequences and name not in opened)
    truth = _choose_truth(config.truth, sequences)
    summaries: list[SequenceSummary] = []
    scored: list[Scored] = []
    for sequence in sequences:
        store = cut_sequence(sequence, cache, _named(progress, f"{sequence.name}: cutting segments"))
        frames = [_without_points(frame) for frame in store.frames()]
        exact = read_truth(sequence.truth_path) if truth == "exact" and sequence.truth_path else None
        truths = true_velocities(frames, config.frame, truth, exact)
        keys, n_without_points = _scorable(store, sequence, config, truths)
        summaries.append(_summarise(sequence, frames, config, truths, keys, n_without_points))
        for name in config.estimators:
            scored += _run(store, name, config, keys, truths, progress)
    if not any(len(part.velocity) for part in scored):
        raise InputError(f"{root}: no pair of consecutive frames of {', '.join(config.classes)} to score")
    return Comparison(root, config, truth, tuple(summaries), tuple(scored), without_scans)


def check_list(what: str, items: Sequence[object], may_be_empty: bool = False) -> None:
    """Refuse an empty list, and one that names something twice: it would count twice."""
    if not items and not may_be_empty:
        raise InputError(f"{what} is empty; expected at least one")
    twice = next((item for item in items if list(items).count(item) > 1), None)
    if twice is not None:
        raise InputError(f"{what} has {twice} twice")


def check_ranges(ranges: Sequence[float]) -> None:
    """Refuse ranges that are no positive lengths."""
    if not all(0.0 < range_m < math.inf for range_m in ranges):
        raise InputError(f"ranges must be positive and finite [m], got {', '.join(f'{r:g}' for r in ranges)}")


def _one_of(what: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise InputError(f"unknown {what} {value!r}; expected one of {', '.join(known)}")


def _named(progress: Progress | None, what: str) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, total: progress(what, done, total)


def _choose_truth(wish: str, sequences: Sequence[KittiSequence]) -> str:
    if wish != AUTO:
        return wish
    has_exact = all(s.truth_path is not None and s.truth_path.is_file() for s in sequences)
    return "exact" if has_exact else "smoothed"


def _without_points(frame: SegmentedFrame) -> SegmentedFrame:
    """Keep what truth needs of a frame: memory must not grow with the clouds of a long sequence."""
    return replace(frame, segments={})


def _scorable(
    store: SegmentStore,
    sequence: KittiSequence,
    config: CompareConfig,
    truths: dict[Key, TrueVelocity],
) -> tuple[list[Key], int]:
    """List the steps whose object has points at both ends, and count those that lack them at one."""
    keys, n_without_points = [], 0
    before: dict[int, int] = {}
    for frame in store.frames():
        now = {key: len(s.points_lidar) for key, s in of_classes(frame.segments, config.classes).items()}
        for track_id, n_points in now.items():
            is_member = in_split(config.split, sequence.name, sequence.reindexed[track_id])
            if not is_member or track_id not in before or (track_id, frame.index) not in truths:
                continue
            if n_points and before[track_id]:
                keys.append((track_id, frame.index))
            else:
                n_without_points += 1
        before = now
    return keys, n_without_points


def _summarise(
    sequence: KittiSequence,
    frames: Sequence[SegmentedFrame],
    config: CompareConfig,
    truths: dict[Key, TrueVelocity],
    keys: Sequence[Key],
    n_without_points: int,
) -> SequenceSummary:
    poses = [frame.T_world_lidar for frame in frames if frame.T_world_lidar is not None]
    in_world = config.frame == WORLD and bool(poses)
    parked = {track_id: truths[track_id, frame].is_parked for track_id, frame in keys}
    return SequenceSummary(
        name=sequence.name,
        n_frames=len(sequence),
        missing_scans=tuple(sequence.missing_scans()),
        clock=sequence.clock,
        ego=sequence.ego,
        n_without_points=n_without_points,
        n_tracks=len(parked),
        n_parked=sum(parked.values()),
        flagged_poses=sequence.flagged,
        ego_path=np.array([T[:2, 3] for T in poses]) if in_world else np.zeros((1, 2)),
    )


def _run(
    store: SegmentStore,
    name: str,
    config: CompareConfig,
    keys: Sequence[Key],
    truths: dict[Key, TrueVelocity],
    progress: Progress | None,
) -> Iterator[Scored]:
    """Run one estimator over a sequence once; give a table for each smoothing of its output."""
    sequence = store.manifest["sequence"]
    report = _named(progress, f"{sequence}: {name}")
    _warm_up(create_estimator(name, seed=config.seed), store, config)
    tracklets, seconds = run_causal(
        create_estimator(name, seed=config.seed), store, config.classes, config.frame, report
    )
    n_transforms = sum(e.status is not EstimateStatus.NEW_TRACK for run in tracklets for e in run)
    for smoothing in config.smoothing:
        start = perf_counter()
        if smoothing == CAUSAL:
            runs = tracklets
        else:
            estimator = create_estimator(name, create_smoothing(smoothing, config.window))
            runs = [estimator.smoothed(run) for run in tracklets]
        total = seconds + perf_counter() - start
        ms = 1e3 * total / max(n_transforms, 1)
        yield pair_with_truth((sequence, name, smoothing), runs, keys, truths, ms)


def _warm_up(estimator: Estimator, store: SegmentStore, config: CompareConfig) -> None:
    """Step through a few frames untimed: what is compiled or loaded on first use is no cost of a transform."""
    for frame in islice(store.frames(), WARM_UP_FRAMES):
        T_world_lidar = frame.T_world_lidar if config.frame == WORLD else None
        estimator.step(of_classes(frame.segments, config.classes), frame.timestamp, T_world_lidar)


def run_causal(
    estimator: Estimator,
    store: SegmentStore,
    classes: Sequence[str],
    frame_name: str,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[list[VelocityEstimate]], float]:
    """Step an estimator through a sequence; give its estimates by tracklet, and the seconds it took."""
    under_way: dict[int, list[VelocityEstimate]] = {}
    tracklets: list[list[VelocityEstimate]] = []
    seconds, last_time = 0.0, None
    for frame in store.frames():
        T_world_lidar = frame.T_world_lidar if frame_name == WORLD else None
        segments = of_classes(frame.segments, classes)
        start = perf_counter()
        estimates = estimator.step(segments, frame.timestamp, T_world_lidar)
        seconds += perf_counter() - start
        estimates = with_pose_covariance(estimates, frame, None if last_time is None else frame.timestamp - last_time)
        last_time = frame.timestamp
        under_way = {track_id: run for track_id, run in under_way.items() if track_id in estimates}
        for track_id, estimate in estimates.items():
            if track_id not in under_way:
                under_way[track_id] = []
                tracklets.append(under_way[track_id])
            under_way[track_id].append(estimate)
        if progress is not None:
            progress(frame.index + 1, len(store))
    return tracklets, seconds
