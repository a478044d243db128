"""How real are simulated segments?  The same boxes, once scanned by a real sensor and once ray-cast, side by side."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from evaluation.compare import run_causal
from evaluation.truth import true_velocities
from registration.types import Points
from tracker.estimators import create_estimator
from tracker.files import write_whole
from tracker.kitti import open_sequence
from tracker.store import SegmentStore, cut_sequence
from tracker.tracklets import of_classes
from tracker.types import SENSOR, EstimateStatus, SegmentedFrame

RANGES = (0.0, 10.0, 20.0, 40.0, 80.0)  # edges of the bins, of the box centre, horizontally [m]
METHODS = ("icp", "adh-3d")

# column of the table: (heading, key of a row, how it is printed)
TABLE = (
    ("range", "range_m", "{0[0]:g}-{0[1]:g} m"),
    ("n", "n", "{}"),
    ("median over segments", "quantity", "{}"),
    ("real", "real", "{:.3g}"),
    ("simulated", "simulated", "{:.3g}"),
    ("ratio", "ratio", "{:.2f}"),
)
LARGEST_HOLE = 6  # azimuth steps; wider gaps on a ring are the shape of the object, or a window
AZIMUTH_STEP = float(np.deg2rad(0.18))  # of an HDL-64E at 10 Hz, as measured on KITTI

Progress = Callable[[str, int, int | None], None]
Key = tuple[int, int]  # track id, frame


@dataclass(frozen=True, slots=True)
class Look:
    """What one segment looks like to the sensor.

    Attributes:
        range_m: of the box centre, horizontally [m].
        n_points: size of the segment.
        n_rings: number of rings, runs of growing azimuth.
        missing: share of azimuth steps on the rings that have no return, in holes of up to `LARGEST_HOLE` steps.
        roughness: of ranges about the mean of both neighbours on the ring, as a standard deviation of one range
            [m]; NaN where no three returns are neighbours.
    """

    range_m: float
    n_points: int
    n_rings: int
    missing: float
    roughness: float


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two folders: the looks of its segments, and the velocity errors [m/s] of each method."""

    looks: dict[Key, Look]
    errors: dict[str, dict[Key, float]]


def look_at(points_lidar: Points, range_m: float) -> Look:
    """Measure a non-empty segment whose points are in the sensor's order: ring by ring, by growing azimuth."""
    azimuth = np.arctan2(points_lidar[:, 1], points_lidar[:, 0])
    reach = np.linalg.norm(points_lidar, axis=1)
    gap = np.mod(np.diff(azimuth) + np.pi, 2.0 * np.pi) - np.pi
    is_same_ring = (gap > 0.0) & (gap < np.pi / 2.0)
    steps = np.rint(gap / AZIMUTH_STEP)
    held: Int64[np.ndarray, " _"] = np.maximum(steps, 1.0)[is_same_ring & (steps <= LARGEST_HOLE)].astype(np.int64)
    is_triple = is_same_ring[1:] & is_same_ring[:-1] & (steps[1:] <= 1.0) & (steps[:-1] <= 1.0)
    bend = (reach[1:-1] - 0.5 * (reach[2:] + reach[:-2]))[is_triple]
    return Look(
        range_m=range_m,
        n_points=len(points_lidar),
        n_rings=1 + int(np.count_nonzero(~is_same_ring)),
        missing=float(1.0 - len(held) / held.sum()) if len(held) else 0.0,
        roughness=_spread(bend) / np.sqrt(1.5) if len(bend) else float("nan"),
    )


def _spread(values: Float64[np.ndarray, " n"]) -> float:
    """Give a standard deviation that edges, which are few, do not move: 1.4826 times the median deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def compare_folders(
    real: Path,
    simulated: Path,
    sequence: str,
    classes: Sequence[str],
    cache: Path,
    progress: Progress | None = None,
) -> tuple[Side, Side]:
    """Measure both folders on the segments that both have, in the sensor's frame.

    Velocity errors of either are those against its own smoothed labels, so that the truth is equally good.

    Raises:
        TrackerError: a folder that cannot be read.
    """
    sides = [
        _measure(cut_sequence(open_sequence(root, sequence, clock="nominal"), cache / name), classes, name, progress)
        for name, root in (("real", real), ("simulated", simulated))
    ]
    both = sides[0].looks.keys() & sides[1].looks.keys()
    first, second = (_only(side, both) for side in sides)
    return first, second


def _measure(store: SegmentStore, classes: Sequence[str], name: str, progress: Progress | None) -> Side:
    frames = list(store.frames())
    looks = {}
    for frame in frames:
        for track_id, segment in of_classes(frame.segments, classes).items():
            if len(segment.points_lidar):
                range_m = float(np.hypot(*frame.boxes[track_id].center_lidar[:2]))
                looks[track_id, frame.index] = look_at(segment.points_lidar, range_m)
    errors = {}
    for k, method in enumerate(METHODS):
        errors[method] = _errors(store, frames, classes, method)
        if progress is not None:
            progress(f"{name}: estimators", k + 1, len(METHODS))
    return Side(looks, errors)


def _errors(
    store: SegmentStore, frames: Sequence[SegmentedFrame], classes: Sequence[str], method: str
) -> dict[Key, float]:
    truths = true_velocities(frames, SENSOR, "smoothed")
    runs, _ = run_causal(create_estimator(method), store, classes, SENSOR)
    steps = {(e.track_id, e.frame): e for run in runs for e in run if e.status is not EstimateStatus.NEW_TRACK}
    return {
        key: float(np.hypot(*(e.velocity - truths[key].velocity)))
        for key, e in steps.items()
        if key in truths and e.n_points
    }


def _only(side: Side, keys: set[Key]) -> Side:
    errors = {name: {key: e for key, e in found.items() if key in keys} for name, found in side.errors.items()}
    return Side({key: side.looks[key] for key in keys}, errors)


def table(real: Side, simulated: Side) -> list[dict[str, Any]]:
    """Give medians over the segments of each range bin, and of all, of both sides and their ratio.

    One row a bin and quantity.
    """
    rows = []
    for low, high in [*zip(RANGES[:-1], RANGES[1:], strict=True), (RANGES[0], RANGES[-1])]:
        keys = sorted(key for key, look in real.looks.items() if low <= look.range_m < high)
        for name, value in quantities().items():
            pair = [[v for key in keys if (v := value(side, key)) is not None] for side in (real, simulated)]
            medians = [float(np.nanmedian(values)) if np.isfinite(values).any() else None for values in pair]
            ratio = medians[1] / medians[0] if medians[0] and medians[1] is not None else None
            rows.append(
                {
                    "range_m": [low, high],
                    "quantity": name,
                    "n": len(keys),
                    "real": medians[0],
                    "simulated": medians[1],
                    "ratio": ratio,
                }
            )
    return rows


def quantities() -> Mapping[str, Callable[[Side, Key], float | None]]:
    """Say how each quantity of the report is read from a side, by its name; None where there is none."""
    return {
        "points": lambda side, key: float(side.looks[key].n_points),
        "rings": lambda side, key: float(side.looks[key].n_rings),
        "points per ring": lambda side, key: side.looks[key].n_points / side.looks[key].n_rings,
        "missing returns": lambda side, key: side.looks[key].missing,
        "roughness [m]": lambda side, key: side.looks[key].roughness,
        **{f"{method} error [m/s]": _error_of(method) for method in METHODS},
    }


def _error_of(method: str) -> Callable[[Side, Key], float | None]:
    return lambda side, key: side.errors[method].get(key)


def write(rows: Sequence[Mapping[str, Any]], real: Path, simulated: Path, sequence: str, out: Path) -> Path:
    """Write the table to `out/realism.json`."""
    path = out / "realism.json"
    about = {"version": version("regmot"), "real": str(real), "simulated": str(simulated), "sequence": sequence}
    write_whole(path, json.dumps({**about, "rows": list(rows)}, indent=1))
    return path
