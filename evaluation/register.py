"""Registration methods on pairs of real segments: the table of AlignNet-3D's section 4, from KITTI tracklets."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float64

import registration
from evaluation.registration_error import box_motion, pair_error, score
from evaluation.report import RESULTS_FORMAT, machine, without_nan
from registration.types import Point, Points, RegistrationMethod, Status, Transform
from tracker.errors import InputError
from tracker.files import write_whole
from tracker.kitti import open_sequence, sequence_names
from tracker.kitti.splits import SPLITS, in_split
from tracker.store import cut_sequence
from tracker.tracklets import of_classes
from tracker.types import Segment, SegmentedFrame

Progress = Callable[[str, int, int], None]

# column of the table: (heading, key of a row, how it is printed)
TABLE = (
    ("method", "method", "{}"),
    ("range", "range_m", "<= {:g} m"),
    ("n", "n", "{}"),
    ("2 cm/1 deg", "share_2cm_1deg", "{:.1%}"),
    ("10 cm/5 deg", "share_10cm_5deg", "{:.1%}"),
    ("20 cm/10 deg", "share_20cm_10deg", "{:.1%}"),
    ("RMSE t [m]", "rmse_t", "{:.3f}"),
    ("RMSE R [deg]", "rmse_r_deg", "{:.2f}"),
    ("ms", "ms_per_transform", "{:.2f}"),
    ("failures", "failures", "{}"),
)


@dataclass(frozen=True, slots=True)
class LabelledPair:
    """Two segments of one object in consecutive scans, each in its own scan's axes, and the labels' motion.

    Attributes:
        source, target: earlier and later cloud, z above the ground [m].
        T_target_source: the label boxes' planar motion; raw, so it jitters by some centimetres itself.
        center: of the earlier box [m]; z is the LiDAR's.
    """

    source: Points
    target: Points
    T_target_source: Transform
    center: Point


@dataclass(frozen=True)
class RegisterConfig:
    """Which pairs, and which methods."""

    methods: tuple[str, ...] = ("centroid", "icp")
    sequences: tuple[str, ...] = ()  # names; empty: all that have scans
    classes: tuple[str, ...] = ("Car", "Van")
    ranges: tuple[float, ...] = (80.0, 20.0, 5.0)  # of the earlier box's centre, in 3-D, as published [m]
    split: str = "all"
    heading_axis: bool = True  # forgive a turn by pi

    def __post_init__(self) -> None:
        """Refuse names that do not exist before any work is done."""
        if self.split not in SPLITS:
            raise InputError(f"unknown split {self.split!r}; expected one of {', '.join(SPLITS)}")
        for name in self.methods:
            registration.create(name)


def register_pairs(
    root: Path, config: RegisterConfig, cache: Path, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Run each method over all pairs of consecutive, non-empty segments; give the rows of `registration.json`.

    Pairs are in the sensor frame, as published: the ego's motion is part of what is to be found.

    Raises:
        InputError: there is no pair.
        TrackerError, RegistrationError: data or a method that cannot be used.
    """
    pairs = list(labelled_pairs(root, config, cache, progress))
    if not pairs:
        raise InputError(f"{root}: no pair of consecutive segments of {', '.join(config.classes)}")
    ranges = np.array([np.linalg.norm(pair.center) for pair in pairs])
    rows = []
    for name in config.methods:
        errors, failed, ms = run_method(registration.create(name), pairs, config.heading_axis, progress)
        for range_m in config.ranges:
            near = ranges <= range_m
            row = {"method": name, "data": str(root), "range_m": range_m, **asdict(score(errors[near]))}
            rows.append({**row, "ms_per_transform": ms, "failures": int(failed[near].sum())})
    return rows


def labelled_pairs(
    root: Path, config: RegisterConfig, cache: Path, progress: Progress | None = None
) -> Iterator[LabelledPair]:
    """Give the pairs of consecutive, non-empty segments of the classes and split asked for."""
    for name in config.sequences or tuple(sequence_names(root)):
        sequence = open_sequence(root, name)
        if not config.sequences and len(sequence.missing_scans()) == len(sequence):
            continue
        report = None if progress is None else lambda k, n, name=name: progress(f"{name}: cutting segments", k, n)
        previous: SegmentedFrame | None = None
        for frame in cut_sequence(sequence, cache, report).frames():
            for track_id, target in of_classes(frame.segments, config.classes).items():
                source = previous.segments.get(track_id) if previous is not None else None
                is_member = in_split(config.split, name, sequence.reindexed[track_id])
                if previous is None or source is None or not is_member:
                    continue
                if len(source.points_lidar) and len(target.points_lidar):
                    before, after = previous.boxes[track_id], frame.boxes[track_id]
                    yield LabelledPair(
                        source=_above_ground(source),
                        target=_above_ground(target),
                        T_target_source=box_motion(before.T_lidar_obj, after.T_lidar_obj),
                        center=before.center_lidar,
                    )
            previous = frame


def run_method(
    method: RegistrationMethod,
    pairs: Sequence[LabelledPair],
    heading_axis: bool,
    progress: Progress | None = None,
) -> tuple[Float64[np.ndarray, "n 2"], np.ndarray, float]:
    """Register all pairs one by one; give errors (translation [m], turn [rad]), failures, and ms a pair."""
    errors = np.empty((len(pairs), 2))
    failed = np.zeros(len(pairs), dtype=bool)
    seconds = 0.0
    for i, pair in enumerate(pairs):
        start = perf_counter()
        result = method.register(pair.source, pair.target)
        seconds += perf_counter() - start
        errors[i] = pair_error(result.T_target_source, pair.T_target_source, pair.center, heading_axis)
        failed[i] = result.status is not Status.CONVERGED
        if progress is not None:
            progress(method.name, i + 1, len(pairs))
    return errors, failed, 1e3 * seconds / len(pairs)


def write(rows: list[dict[str, Any]], root: Path, config: RegisterConfig, out: Path) -> Path:
    """Write `registration.json` into a folder; its names are a contract."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "registration.json"
    found = {
        "format": RESULTS_FORMAT,
        "version": version("regmot"),
        "machine": machine(),
        "data": {"root": str(root), "classes": list(config.classes), "split": config.split},
        "heading_axis": config.heading_axis,
        "rows": rows,
    }
    write_whole(path, json.dumps(without_nan(found), indent=1))
    return path


def _above_ground(segment: Segment) -> Points:
    return segment.points_lidar - [0.0, 0.0, segment.ground_z_lidar]
