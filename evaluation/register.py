"""Registration methods on pairs of clouds: the table of AlignNet-3D's section 4, from KITTI or a set on disk."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

import registration
from evaluation.registration_error import pair_error, score
from evaluation.report import RESULTS_FORMAT, machine, without_nan
from registration.pair_set import CloudPair, PairSet
from registration.types import RegistrationMethod, Status
from tracker.errors import InputError
from tracker.files import write_whole
from tracker.kitti import open_sequences
from tracker.kitti.splits import SPLITS, in_split
from tracker.pairs import track_pairs

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
        """Refuse names that do not exist before any work is done."""
        if self.split not in SPLITS:
            raise InputError(f"unknown split {self.split!r}; expected one of {', '.join(SPLITS)}")
        for name in self.methods:
            registration.create(name)


def register_pairs(
    root: Path, config: RegisterConfig, cache: Path, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Run each method over all pairs; give the rows of `registration.json`.

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
    pairs = list(_choose_pairs(root, config, cache, progress))
    if not pairs:
        raise InputError(f"{root}: no pair of clouds")
    ranges = np.array([np.linalg.norm(pair.start_position) for pair in pairs])
    rows = []
    for name in config.methods:
        errors, failed, ms = run_method(registration.create(name), pairs, config.heading_axis, progress)
        for range_m in config.ranges:
            near = ranges <= range_m
            row = {"method": name, "data": str(root), "range_m": range_m, **asdict(score(errors[near]))}
            rows.append({**row, "ms_per_transform": ms, "failures": int(failed[near].sum())})
    return rows


def _choose_pairs(root: Path, config: RegisterConfig, cache: Path, progress: Progress | None) -> Iterator[CloudPair]:
    if (root / "pointcloud1").is_dir():
        yield from PairSet(root, config.mirrored_angles).pairs(config.part)
        return
    for sequence in open_sequences(root, config.sequences):
        for rank, pair in track_pairs(sequence, config.classes, cache, np.eye(4), progress=progress):
            if in_split(config.split, sequence.name, rank):
                yield pair


def run_method(
    method: RegistrationMethod,
    pairs: Sequence[CloudPair],
    heading_axis: bool,
    progress: Progress | None = None,
) -> tuple[Float64[np.ndarray, "n 2"], Bool[np.ndarray, " n"], float]:
    """Register all pairs one by one; give errors (translation [m], turn [rad]), failures, and ms a pair."""
    errors = np.empty((len(pairs), 2))
    failed = np.zeros(len(pairs), dtype=bool)
    seconds = 0.0
    for i, pair in enumerate(pairs):
        start = perf_counter()
        result = method.register(pair.source, pair.target)
        seconds += perf_counter() - start
        errors[i] = pair_error(result.T_target_source, pair.T_target_source, pair.start_position, heading_axis)
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
