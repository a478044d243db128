"""Derive the statistics that `kitti-like-*` sets follow from KITTI tracking labels: summaries, no trajectories.

python -m regmot.kitti_statistics ROOT [FILE]

Only the eleven sequences that neither AlignNet-3D's protocol holds out nor our checks use (0000) are read.  Labels
are enough; no scan is opened.
"""

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.signal import savgol_coeffs, savgol_filter

from registration import planar, se3
from registration.synthetic import traffic
from tracker.files import write_whole
from tracker.kitti.calib import read_tracking_calib
from tracker.kitti.labels import read_labels
from tracker.kitti.splits import HELD_OUT_SEQUENCES
from tracker.kitti.tracking import sequence_names, training_folder
from tracker.pairs import hard_frames
from tracker.types import Box

from .kitti_scenery import polar, summarise_scenery

CHECKED = frozenset({"0000"})  # kept for checks, as the held-out sequences are
WINDOW, ORDER = 9, 2  # of the Savitzky-Golay filter that tells motion from jitter
FEW = 60  # samples of a cell below which a wider one stands in

Values = Float64[np.ndarray, " n"]


class Run(NamedTuple):
    """One object in frames without a gap."""

    class_name: str
    size: Float64[np.ndarray, "3"]
    center: Float64[np.ndarray, "n 3"]
    yaw: Float64[np.ndarray, " n"]  # unwrapped
    occlusion: Int64[np.ndarray, " n"]


class Steps(NamedTuple):
    """Smoothed states of objects, one a row, and what smoothing took away."""

    place: Float64[np.ndarray, "n 2"]  # (range [m], bearing [rad])
    lateral: Values  # y in the sensor's axes [m]
    yaw: Values
    velocity: Float64[np.ndarray, "n 2"]  # relative to the sensor, in the object's axes [m/s]
    turn_rate: Values  # relative to the sensor [rad/s]
    lever: Values  # of the sensor's own turn: distance along the object's axis [m]
    jitter: Float64[np.ndarray, "n 4"]  # along, across, up [m], yaw [rad]


def main(arguments: Sequence[str] | None = None) -> None:
    """Read labels below a KITTI root and write the statistics."""
    root, *out = sys.argv[1:] if arguments is None else arguments
    path = Path(out[0]) if out else traffic.STATISTICS_PATH
    folder = training_folder(Path(root))
    if folder is None:
        raise SystemExit(f"{root}: expected a KITTI tracking folder with label_02")
    names = source_names(folder)
    frames = [read_frames(folder, name) for name in names]
    found: dict[str, Any] = {"sequences": names, "levels": traffic.LEVELS.tolist()}
    for group, classes in traffic.GROUPS.items():
        found[group] = _rounded(group_statistics(frames, classes))
    write_whole(path, json.dumps(found, separators=(",", ":")) + "\n")


def source_names(folder: Path) -> list[str]:
    """List the sequences that may be read."""
    return [name for name in sequence_names(folder) if name not in HELD_OUT_SEQUENCES | CHECKED]


def read_frames(folder: Path, name: str) -> dict[int, list[Box]]:
    """Read a sequence's boxes in LiDAR axes, by frame."""
    T_lidar_cam = se3.invert(read_tracking_calib(folder / "calib" / f"{name}.txt").T_cam_lidar)
    frames: dict[int, list[Box]] = defaultdict(list)
    for label in read_labels(folder / "label_02" / f"{name}.txt"):
        frames[label.frame].append(label.to_box(T_lidar_cam))
    return frames


def group_statistics(sequences: Sequence[dict[int, list[Box]]], classes: Sequence[str]) -> dict[str, Any]:
    """Summarise the objects of some classes."""
    runs = [run for frames in sequences for run in find_runs(frames, classes)]
    steps = join_steps([smooth(run) for run in runs if len(run.yaw) >= WINDOW])
    place = np.array([polar(center) for run in runs for center in run.center])
    heading = np.concatenate([run.yaw for run in runs]) - place[:, 1]
    return {
        "n_boxes": len(place),
        "classes": _classes(runs),
        "place": traffic.count_places(place).tolist(),
        "heading": _headings(place, heading),
        **summarise_motion(steps),
        "ground": _ground(runs, place),
        "occlusion": _occlusion(runs, place),
        "occlusion_later": [_transitions(runs, gap) for gap in range(1, traffic.MAX_GAP + 1)],
        "jitter": _jitter(steps),
        **summarise_scenery(sequences, classes),
        "hard": _hard(runs),
    }


def find_runs(frames: dict[int, list[Box]], classes: Sequence[str]) -> list[Run]:
    """Cut tracks where frames are missing."""
    tracks: dict[int, list[tuple[int, Box]]] = defaultdict(list)
    for frame in sorted(frames):
        for box in frames[frame]:
            if box.class_name in classes:
                tracks[box.track_id].append((frame, box))
    runs = []
    for track in tracks.values():
        breaks = np.flatnonzero(np.diff([frame for frame, _ in track]) != 1) + 1
        runs += [_run(track[first:last]) for first, last in zip([0, *breaks], [*breaks, len(track)], strict=True)]
    return runs


def _run(track: list[tuple[int, Box]]) -> Run:
    boxes = [box for _, box in track]
    return Run(
        class_name=boxes[0].class_name,
        size=boxes[0].size,
        center=np.array([box.center_lidar for box in boxes]),
        yaw=np.unwrap([box.yaw_lidar for box in boxes]),
        occlusion=np.array([box.occlusion for box in boxes]),
    )


def smooth(run: Run) -> Steps:
    """Tell an object's motion from the jitter of its labels.

    White noise leaves sqrt(1 - c) of itself behind a filter whose middle coefficient is c: residuals are divided by it.
    """
    center = savgol_filter(run.center, WINDOW, ORDER, axis=0)
    yaw = savgol_filter(run.yaw, WINDOW, ORDER)
    velocity = savgol_filter(run.center, WINDOW, ORDER, deriv=1, delta=traffic.PERIOD, axis=0)
    along = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    off = run.center - center
    left_over = np.sqrt(1.0 - savgol_coeffs(WINDOW, ORDER)[WINDOW // 2])
    parts = [(off[:, :2] * along).sum(axis=1), (off[:, :2] * across).sum(axis=1), off[:, 2], run.yaw - yaw]
    return Steps(
        place=np.array([polar(c) for c in center]),
        lateral=center[:, 1],
        yaw=yaw,
        velocity=np.stack([(velocity[:, :2] * axis).sum(axis=1) for axis in (along, across)], axis=1),
        turn_rate=savgol_filter(run.yaw, WINDOW, ORDER, deriv=1, delta=traffic.PERIOD),
        lever=(center[:, :2] * along).sum(axis=1),
        jitter=np.stack(parts, axis=1) / left_over,
    )


def join_steps(steps: Sequence[Steps]) -> Steps:
    """Put the steps of many runs under each other."""
    return Steps(*(np.concatenate(columns) for columns in zip(*steps, strict=True)))


def _classes(runs: Sequence[Run]) -> dict[str, Any]:
    """How often each class is, frame by frame, and how large, object by object."""
    found = {}
    n_all = sum(len(run.yaw) for run in runs)
    for name in sorted({run.class_name for run in runs}):
        own = [run for run in runs if run.class_name == name]
        sizes = np.log([run.size for run in own])
        share = sum(len(run.yaw) for run in own) / n_all
        found[name] = {"share": share, "log_size": sizes.mean(axis=0), "log_size_cov": np.cov(sizes.T)}
    return found


def _headings(place: Float64[np.ndarray, "n 2"], heading: Values) -> list[Any]:
    """Count headings relative to the line of sight, by range and side."""
    rows = traffic.bins_of(place[:, 0], traffic.FAR_EDGES), traffic.bins_of(place[:, 1], traffic.SIDE_EDGES)
    counts = np.zeros((len(traffic.FAR_EDGES) - 1, len(traffic.SIDE_EDGES) - 1, traffic.N_HEADINGS))
    np.add.at(counts, (*rows, traffic.heading_bin(heading)), 1)
    return counts.tolist()


def summarise_motion(steps: Steps) -> dict[str, Any]:
    """Summarise turn rates and speeds, by where an object heads and where it is.

    A turn relative to the sensor is the ego's where the object then moves sideways as a turning sensor makes it,
    and the object's own where it does not.
    """
    kind = traffic.heading_kind(steps.yaw)
    lane = traffic.bins_of(steps.lateral, traffic.LANE_EDGES)
    is_turning = np.abs(steps.turn_rate) >= traffic.TURNING
    swing = steps.turn_rate * steps.lever
    by_ego = np.abs(steps.velocity[:, 1] - swing) < np.abs(steps.velocity[:, 1])
    sideways = steps.velocity[:, 1] - np.where(is_turning & by_ego, swing, 0.0)

    def table(values: Values, *keys: tuple[Int64[np.ndarray, " n"], int]) -> list[Any]:
        return quantiles_by(values, list(keys))

    turning_kinds = [is_turning & (kind == k) for k in range(traffic.N_KINDS)]
    kinds, lanes = (kind, traffic.N_KINDS), (lane, len(traffic.LANE_EDGES) - 1)
    turning = (is_turning.astype(np.int64), 2)
    return {
        "turn_rate": table(steps.turn_rate, kinds),
        "ego_turns": [float(by_ego[m].sum() / max(m.sum(), 1)) for m in turning_kinds],
        "speed": table(steps.velocity[:, 0], turning, kinds, lanes),
        "sideways": table(sideways, turning, kinds),
    }


def quantiles_by(values: Values, keys: list[tuple[Int64[np.ndarray, " n"], int]]) -> Any:
    """Tabulate quantiles in nested cells; a cell of few samples shows those of the cell around it."""

    def cells(rows: Int64[np.ndarray, " m"], depth: int, around: Int64[np.ndarray, " k"]) -> Any:
        used = rows if len(rows) >= FEW else around
        if depth == len(keys):
            return np.quantile(values[used], traffic.LEVELS)
        key, n = keys[depth]
        return [cells(rows[key[rows] == k], depth + 1, used) for k in range(n)]

    everything = np.arange(len(values))
    return cells(everything, 0, everything)


def _ground(runs: Sequence[Run], place: Float64[np.ndarray, "n 2"]) -> list[Any]:
    """Summarise the height of boxes' bottoms in LiDAR axes, by range."""
    bottom = np.concatenate([run.center[:, 2] - 0.5 * run.size[2] for run in runs])
    key = traffic.bins_of(place[:, 0], traffic.FAR_EDGES)
    return quantiles_by(bottom, [(key, len(traffic.FAR_EDGES) - 1)])


def _occlusion(runs: Sequence[Run], place: Float64[np.ndarray, "n 2"]) -> list[Any]:
    """Share of KITTI's levels 0, 1, 2 by range; unknown ones do not count."""
    level = np.concatenate([run.occlusion for run in runs])
    key = traffic.bins_of(place[:, 0], traffic.FAR_EDGES)
    counts = np.zeros((len(traffic.FAR_EDGES) - 1, traffic.N_LEVELS))
    known = (level >= 0) & (level < traffic.N_LEVELS)
    np.add.at(counts, (key[known], level[known]), 1)
    return (counts / counts.sum(axis=1, keepdims=True)).tolist()


def _transitions(runs: Sequence[Run], gap: int) -> list[Any]:
    """Share of each level `gap` frames later, by the level now."""
    counts = np.zeros((traffic.N_LEVELS, traffic.N_LEVELS))
    for run in runs:
        now, later = run.occlusion[:-gap], run.occlusion[gap:]
        known = (np.maximum(now, later) < traffic.N_LEVELS) & (np.minimum(now, later) >= 0)
        np.add.at(counts, (now[known], later[known]), 1)
    counts += 1e-6 * np.eye(traffic.N_LEVELS)  # a level that never occurs stays what it is
    return (counts / counts.sum(axis=1, keepdims=True)).tolist()


def _jitter(steps: Steps) -> list[Any]:
    """Summarise the labels' jitter along, across, up and about, by range."""
    key = traffic.bins_of(steps.place[:, 0], traffic.FAR_EDGES)
    n = len(traffic.FAR_EDGES) - 1
    columns = [quantiles_by(steps.jitter[:, k], [(key, n)]) for k in range(4)]
    return [[column[k] for column in columns] for k in range(n)]


def _hard(runs: Sequence[Run]) -> dict[str, Any]:
    """Summarise hard pairs: far apart in time, and turned.  Every track counts alike, however many pairs it gives."""
    rows, weights = [], []
    for run in runs:
        pairs = list(hard_frames({frame: planar.wrap(float(yaw)) for frame, yaw in enumerate(run.yaw)}))
        for first, second in pairs:
            start, end = polar(run.center[first]), polar(run.center[second])
            turned = planar.wrap(float(run.yaw[second] - run.yaw[first]))
            rows.append([second - first, turned, *start, *end, float(run.yaw[first]) - start[1]])
            weights.append(1.0 / len(pairs))
    found, weight = np.array(rows), np.array(weights)
    gap, turn, heading = found[:, 0], found[:, 1], found[:, 6]
    return {
        "gap": _weighted_quantiles(gap, weight),
        "turn": _weighted_quantiles(np.abs(turn), weight),
        "left": float((weight * (turn > 0)).sum() / weight.sum()),
        "start": traffic.count_places(found[:, 2:4], weight).tolist(),
        "end": traffic.count_places(found[:, 4:6], weight).tolist(),
        "heading": np.bincount(traffic.heading_bin(heading), weight, traffic.N_HEADINGS).tolist(),
    }


def _weighted_quantiles(values: Values, weight: Values) -> Values:
    order = np.argsort(values)
    return np.interp(traffic.LEVELS, (np.cumsum(weight[order]) - 0.5 * weight[order]) / weight.sum(), values[order])


def _rounded(found: Any) -> Any:
    """Write numbers short: four digits say all that there is to say."""
    if isinstance(found, dict):
        return {key: _rounded(value) for key, value in found.items()}
    if isinstance(found, (list, tuple, np.ndarray)):
        return [_rounded(value) for value in found]
    return found if isinstance(found, (str, int)) else float(f"{found:.4g}")


if __name__ == "__main__":
    main()
