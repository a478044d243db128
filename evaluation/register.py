"""Registration methods on pairs of clouds: the table of AlignNet-3D's section 4, from KITTI or a set on disk."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float64

import registration
from evaluation.compare import check_list, check_ranges
from evaluation.registration_error import pair_error, score
from evaluation.report import RESULTS_FORMAT, machine, without_nan
from registration.pair_set import CloudPair, PairSet
from registration.types import RegistrationMethod, Status
from tracker.errors import InputError
from tracker.files import write_whole
from tracker.kitti import check_classes, open_sequences
from tracker.kitti.splits import SPLITS, in_split
from tracker.pairs import track_pairs

Progress = Callable[[str, int, int | None], None]

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


@dataclass(frozen=True)
class RegisterConfig:
    """Which pairs, and which methods.  The first three settings of pairs are KITTI's, the last two a set's on disk."""

    methods: tuple[str, ...] = ("centroid", "icp")
    ranges: tuple[float, ...] = (80.0, 20.0, 5.0)  # of the earlier box's centre, in 3-D, as published [m]
    sequences: tuple[str, ...] = ()  # names; empty: all that have scans
    classes: tuple[str, ...] = ("Car", "Van")
    split: str = "all"
    part: str = "test"  # train, val or test
    mirrored_angles: bool = False  # of the released KITTI sets
    heading_axis: bool = True  # forgive a turn by pi

    def __post_init__(self) -> None:
        """Refuse names that do not exist and lists that cannot be, before any work is done."""
        if self.split not in SPLITS:
            raise InputError(f"unknown split {self.split!r}; expected one of {', '.join(SPLITS)}")
        for field in ("methods", "classes", "ranges"):
            check_list(field, getattr(self, field))
        check_list("sequences", self.sequences, may_be_empty=True)
        check_ranges(self.ranges)
        for name in self.methods:
            registration.create(name)


@dataclass
class _Tally:
    """What one method did on the pairs so far."""

    method: RegistrationMethod
    errors: list[Float64[np.ndarray, "2"]]  # translation [m], turn [rad]
    failed: list[bool]
    seconds: float = 0.0

    def add(self, pair: CloudPair, heading_axis: bool) -> None:
        """Register a pair and note how far off the answer is."""
        start = perf_counter()
        result = self.method.register(pair.source, pair.target)
        self.seconds += perf_counter() - start
        center = pair.start_position
        self.errors.append(pair_error(result.T_target_source, pair.T_target_source, center, heading_axis))
        self.failed.append(result.status is not Status.CONVERGED)


def register_pairs(
    root: Path, config: RegisterConfig, cache: Path, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Run each method over all pairs; give the rows of `registration.json`.  One pair is in memory at a time.

    Args:
        root: a set of pairs on disk, or a KITTI folder: its consecutive, non-empty segments in LiDAR axes, not
            compensated for the ego's motion (as published), against the raw label boxes' motion.
        config: which pairs, and which methods.
        cache: where segments cut from KITTI are kept.
        progress: told of every frame and pair.

    Raises:
        InputError: there is no pair.
        TrackerError, RegistrationError: data or a method that cannot be used.
    """
    tallies = [_Tally(registration.create(name), [], []) for name in config.methods]
    ranges: list[float] = []
    for pair in _choose_pairs(root, config, cache, progress):
        if not ranges:
            for tally in tallies:  # what is compiled or loaded on first use is no cost of a pair
                tally.method.register(pair.source, pair.target)
        for tally in tallies:
            tally.add(pair, config.heading_axis)
        ranges.append(float(np.linalg.norm(pair.start_position)))
        if progress is not None:
            progress("pairs registered", len(ranges), None)
    if not ranges:
        what = f"in its {config.part} part" if is_pair_set(root) else f"of {', '.join(config.classes)}, {config.split}"
        raise InputError(f"{root}: no pair of clouds {what}")
    return [row for tally in tallies for row in _rows(tally, root, np.array(ranges), config)]


def _rows(
    tally: _Tally, root: Path, ranges: Float64[np.ndarray, " n"], config: RegisterConfig
) -> Iterator[dict[str, Any]]:
    errors, failed = np.array(tally.errors), np.array(tally.failed)
    for range_m in config.ranges:
        near = ranges <= range_m
        named = {"method": tally.method.name, "data": str(root), "range_m": range_m}
        ms = 1e3 * tally.seconds / len(ranges)
        yield {**named, **asdict(score(errors[near])), "ms_per_transform": ms, "failures": int(failed[near].sum())}


def is_pair_set(root: Path) -> bool:
    """Tell a set of pairs on disk from a KITTI folder."""
    return (root / "pointcloud1").is_dir()


def heading(root: Path, config: RegisterConfig) -> list[str]:
    """Say what a registration table is made of, line by line."""
    about = {k: v for k, v in _resolved(root, config).items() if v not in ((), False)}
    words = [f"{key}: {', '.join(map(str, v)) if isinstance(v, tuple) else v}" for key, v in about.items()]
    axis = "a turn by 180 degrees is forgiven" if config.heading_axis else "the full heading counts"
    return [f"data: {root}; {'; '.join(words)}", f"{axis}; regmot {version('regmot')}, {machine()}"]


def _resolved(root: Path, config: RegisterConfig) -> dict[str, Any]:
    """Give the settings of pairs that were in force: a set's on disk, or KITTI's."""
    if is_pair_set(root):
        return {"part": config.part, "mirrored_angles": config.mirrored_angles}
    sequences = tuple(s.name for s in open_sequences(root, config.sequences))
    return {"sequences": sequences, "classes": config.classes, "split": config.split}


def _choose_pairs(root: Path, config: RegisterConfig, cache: Path, progress: Progress | None) -> Iterator[CloudPair]:
    if is_pair_set(root):
        yield from PairSet(root, config.mirrored_angles).pairs(config.part)
        return
    sequences = open_sequences(root, config.sequences)
    check_classes(sequences, config.classes)
    for sequence in sequences:
        for rank, pair in track_pairs(sequence, config.classes, cache, np.eye(4), progress=progress):
            if in_split(config.split, sequence.name, rank):
                yield pair


def write(rows: list[dict[str, Any]], root: Path, config: RegisterConfig, out: Path) -> Path:
    """Write `registration.json` into a folder; its names are a contract."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "registration.json"
    found = {
        "format": RESULTS_FORMAT,
        "version": version("regmot"),
        "machine": machine(),
        "data": {"root": str(root), **_resolved(root, config)},
        "heading_axis": config.heading_axis,
        "rows": rows,
    }
    write_whole(path, json.dumps(without_nan(found), indent=1))
    return path
