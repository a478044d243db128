"""Segments on disk: cut once from a sequence's scans, in parts, resumable, and read again frame by frame."""

import json
import re
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from tracker.errors import DataError, MissingDataError
from tracker.files import UNFINISHED, whole_file, write_whole
from tracker.kitti import KittiSequence
from tracker.tracklets import cut, segment_of
from tracker.types import Box, SegmentedFrame, Sweep

FORMAT, FORMAT_VERSION = "regmot-segments", 5
FRAMES_PER_PART = 50
UNCLAIMED = np.full((3, 3), np.nan)  # stands for a covariance that nobody claims
AS_SEEN = np.full(10, np.nan)  # stands for a sweep whose points and times are to be taken as they are

_OURS = re.compile(
    rf"(manifest\.json|part-\d{{4,}}\.npz)({re.escape(UNFINISHED)})?"
)  # all that a store's folder ever holds
_COLUMNS = (
    "index", "timestamp", "has_pose", "T_world_lidar", "ego_step_covariance", "sweep",
    "box_frame", "track_id", "class_name", "T_lidar_obj", "size", "truncation", "occlusion", "n_points", "seen_at",
    "seen_after", "points_lidar",
)  # fmt: skip
# What NumPy and zipfile raise on damaged archives, by where the damage is.
_DAMAGES = (OSError, ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile)

SCANNED = ("is_swept", "lasers", "is_simulated")  # of a sequence and all its segments: how scans were made

Progress = Callable[[int, int], None]  # frames done, frames in all


@dataclass(frozen=True, slots=True)
class SegmentStore:
    """The segments and boxes of one sequence, in a folder of parts.

    Attributes:
        folder: holds `manifest.json` and `part-NNNN.npz`.
        manifest: format, version, sequence, clock, ego, flagged_poses, deskewed, is_swept, lasers, is_simulated,
            n_frames, missing_scans, fingerprint.
    """

    folder: Path
    manifest: dict[str, Any]

    def __len__(self) -> int:
        """Count the frames."""
        return int(self.manifest["n_frames"])

    def frames(self) -> Iterator[SegmentedFrame]:
        """Read frame by frame; one part is in memory at a time.

        Raises:
            DataError: a part is damaged.
        """
        scanned = {key: self.manifest[key] for key in SCANNED}
        for start in range(0, len(self), FRAMES_PER_PART):
            for frame in _read_part(_part_path(self.folder, start)):
                segments = {key: replace(segment, **scanned) for key, segment in frame.segments.items()}
                yield replace(frame, segments=segments)


def cut_sequence(sequence: KittiSequence, out: Path, progress: Progress | None = None) -> SegmentStore:
    """Cut all segments of a sequence into `out/<name>`; parts that are there already are kept.

    A store made from other files (labels, poses, times, scans), with other ego poses, or by another format version, is
    made anew.

    Args:
        sequence: what to cut.
        out: where stores live; one folder a sequence.
        progress: told of every frame.

    Raises:
        MissingDataError: the sequence has no scan at all.
        DataError: a scan is damaged.
    """
    missing = sequence.missing_scans()
    if len(missing) == len(sequence):
        raise MissingDataError(
            f"sequence {sequence.name}: none of its {len(sequence)} frames has a scan ({sequence.scan_path(0)} ...)"
        )
    folder = out / sequence.name
    manifest = _describe(sequence, missing)
    _prepare_folder(folder, manifest)
    for start in range(0, len(sequence), FRAMES_PER_PART):
        stop = min(start + FRAMES_PER_PART, len(sequence))
        path = _part_path(folder, start)
        if not path.is_file():
            frames = []
            for frame in sequence.frames(start, stop):
                frames.append(cut(frame))
                if progress is not None:
                    progress(frame.index + 1, len(sequence))
            _write_part(path, frames)
        if progress is not None:
            progress(stop, len(sequence))
    return SegmentStore(folder, manifest)


def _describe(sequence: KittiSequence, missing: list[int]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "regmot": version("regmot"),
        "sequence": sequence.name,
        "clock": sequence.clock,
        "ego": sequence.ego,
        "flagged_poses": list(sequence.flagged),
        "deskewed": sequence.sweep is not None,
        **{key: getattr(sequence, key) for key in SCANNED},
        "n_frames": len(sequence),
        "missing_scans": missing,
        "frames_per_part": FRAMES_PER_PART,
        "fingerprint": sequence.fingerprint(),
    }


def _prepare_folder(folder: Path, manifest: dict[str, Any]) -> None:
    """Keep a store made from the same files; clear any other, whole or half-made; refuse files of somebody else."""
    path = folder / "manifest.json"
    if path.is_file() and _read_manifest(path) == manifest:
        return
    folder.mkdir(parents=True, exist_ok=True)
    found = list(folder.iterdir())
    foreign = sorted(file.name for file in found if not (_OURS.fullmatch(file.name) and file.is_file()))
    if foreign:
        what = f"expected an empty folder or a store of segments, got other files ({', '.join(foreign[:3])})"
        raise DataError(folder, what)
    for file in found:
        file.unlink()
    write_whole(path, json.dumps(manifest, indent=1))


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_bytes())
    except ValueError:
        found = None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise DataError(path, f"expected the manifest of a store of segments ({FORMAT}), got another file")
    return found


def _part_path(folder: Path, start: int) -> Path:
    return folder / f"part-{start // FRAMES_PER_PART:04d}.npz"


def _write_part(path: Path, frames: list[SegmentedFrame]) -> None:
    """Write columns: one row a frame, one row a box, one row a point (scans are float32, so nothing is lost)."""
    boxes = [(row, box) for row, frame in enumerate(frames) for box in frame.boxes.values()]
    segments = [frames[row].segments.get(box.track_id) for row, box in boxes]
    clouds = [segment.points_lidar for segment in segments if segment is not None]
    columns: dict[str, Any] = {
        "index": np.array([frame.index for frame in frames]),
        "timestamp": np.array([frame.timestamp for frame in frames]),
        "has_pose": np.array([frame.T_world_lidar is not None for frame in frames]),
        "T_world_lidar": np.array(
            [np.eye(4) if frame.T_world_lidar is None else frame.T_world_lidar for frame in frames]
        ),
        "ego_step_covariance": np.array(
            [UNCLAIMED if frame.ego_step_covariance is None else frame.ego_step_covariance for frame in frames]
        ).reshape(-1, 3, 3),
        "sweep": np.array([_sweep_row(frame) for frame in frames]).reshape(-1, len(AS_SEEN)),
        "box_frame": np.array([row for row, _ in boxes], dtype=np.int64),
        "track_id": np.array([box.track_id for _, box in boxes], dtype=np.int64),
        "class_name": np.array([box.class_name for _, box in boxes], dtype=np.str_),
        "T_lidar_obj": np.array([box.T_lidar_obj for _, box in boxes]).reshape(-1, 4, 4),
        "size": np.array([box.size for _, box in boxes]).reshape(-1, 3),
        "truncation": np.array([box.truncation for _, box in boxes], dtype=np.int64),
        "occlusion": np.array([box.occlusion for _, box in boxes], dtype=np.int64),
        "seen_at": np.array([frames[row].time_of(box.track_id) for row, box in boxes], dtype=np.float64),
        "seen_after": np.array([0.0 if s is None else s.seen_after for s in segments], dtype=np.float64),
        "n_points": np.array([-1 if s is None else len(s.points_lidar) for s in segments], dtype=np.int64),
        "points_lidar": np.concatenate([np.empty((0, 3)), *clouds]).astype(np.float32),
    }
    with whole_file(path, "wb") as file:
        np.savez(file, **columns)


def _sweep_row(frame: SegmentedFrame) -> Float64[np.ndarray, "10"]:
    """Pack what the segments of a frame know of its sweep; it is the same for all of them."""
    sweep = next((segment.sweep for segment in frame.segments.values()), None)
    if sweep is None:
        return AS_SEEN
    return np.array([*sweep.twist_lidar, sweep.period, sweep.is_clockwise, sweep.cut_azimuth, sweep.to_frame_time])


def _read_sweep(row: Float64[np.ndarray, "10"]) -> Sweep | None:
    period, is_clockwise, cut_azimuth, to_frame_time = row[6:].tolist()
    if np.isnan(period):
        return None
    return Sweep(row[:6], period, bool(is_clockwise), cut_azimuth, bool(to_frame_time))


def _read_part(path: Path) -> Iterator[SegmentedFrame]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            columns = {key: archive[key] for key in _COLUMNS}
    except _DAMAGES as error:
        what = f"expected a part of a segment store, got a damaged file ({error}); delete it to have it cut anew"
        raise DataError(path, what) from error
    points = columns["points_lidar"].astype(np.float64)
    ends = np.cumsum(np.maximum(columns["n_points"], 0))
    for row, index in enumerate(columns["index"]):
        timestamp = float(columns["timestamp"][row])
        T_world_lidar = columns["T_world_lidar"][row] if columns["has_pose"][row] else None
        covariance, sweep = columns["ego_step_covariance"][row], _read_sweep(columns["sweep"][row])
        boxes, segments, seen_at = {}, {}, {}
        for i in np.flatnonzero(columns["box_frame"] == row):
            box = _read_box(columns, int(i))
            boxes[box.track_id] = box
            time = float(columns["seen_at"][i])
            if time != timestamp:
                seen_at[box.track_id] = time
            n = int(columns["n_points"][i])
            if n >= 0:
                cloud = points[ends[i] - n : ends[i]].copy()  # a view would keep the whole part in memory
                seen_after = float(columns["seen_after"][i])
                segment = segment_of(box, cloud, int(index), timestamp + seen_after, T_world_lidar)
                segments[box.track_id] = replace(segment, sweep=sweep, seen_after=seen_after)
        claimed = None if np.isnan(covariance).any() else covariance
        yield SegmentedFrame(int(index), timestamp, segments, boxes, T_world_lidar, claimed, seen_at)


def _read_box(columns: dict[str, np.ndarray], i: int) -> Box:
    return Box(
        track_id=int(columns["track_id"][i]),
        class_name=str(columns["class_name"][i]),
        T_lidar_obj=columns["T_lidar_obj"][i],
        size=columns["size"][i],
        truncation=int(columns["truncation"][i]),
        occlusion=int(columns["occlusion"][i]),
    )
