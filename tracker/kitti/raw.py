"""KITTI raw drives: `date/date_drive_NNNN_sync` with `velodyne_points`, `oxts` and `tracklet_labels.xml`."""

from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.types import Point
from tracker.errors import DataError, MissingDataError
from tracker.kitti.calib import read_raw_imu
from tracker.kitti.clock import NOMINAL_PERIOD, read_times
from tracker.kitti.poses import Poses, interpolate_poses, read_oxts
from tracker.kitti.sequence import KittiSequence, check_recorded, choose_times, count_frames
from tracker.kitti.text import read_lines
from tracker.types import Box

TRACKLETS = "tracklet_labels.xml"
MIN_RECORDS = 2  # that poses are interpolated between

Times = Float64[np.ndarray, " n"]


def drive_folders(root: Path) -> list[Path]:
    """Find raw drives: the root itself, or those below a day's folder that have tracklets (most have none)."""
    root = root.absolute()  # a drive is named by its folder, also when ROOT is `.`
    if (root / "velodyne_points").is_dir() or (root / TRACKLETS).is_file():
        return [root]
    return sorted(path for path in root.glob("*_drive_*_*") if (path / TRACKLETS).is_file())


def open_raw(root: Path, folder: Path, clock: str = "auto", recorded: str = "auto") -> KittiSequence:
    """Read a drive's tracklets, times and GPS/IMU poses; scans stay on disk and are found by frame number.

    Raises:
        MissingDataError: the drive has no tracklets, or not the poses asked for.
        DataError: a file is malformed, or a frame has no time or GPS/IMU record.
    """
    label_path, scans = folder / TRACKLETS, folder / "velodyne_points" / "data"
    by_frame = read_tracklets(label_path)
    n_frames = count_frames(max(by_frame, default=-1), scans)
    times, clock_source, time_files = _choose_times(folder, n_frames, clock)
    poses, ego, flagged, pose_files = _choose_poses(folder, n_frames, recorded)
    track_ids = {box.track_id for boxes in by_frame.values() for box in boxes}
    return KittiSequence(
        name=folder.name,
        root=root,
        timestamps=times,
        clock=clock_source,
        poses=poses,
        ego=ego,
        scan_path=lambda frame: scans / f"{frame:010d}.bin",
        boxes_of=lambda frame: by_frame.get(frame, ()),
        reindexed={track_id: rank for rank, track_id in enumerate(sorted(track_ids))},
        class_names=tuple(sorted({box.class_name for boxes in by_frame.values() for box in boxes})),
        sources=(label_path, *time_files, *pose_files),
        flagged=flagged,
    )


def read_tracklets(path: Path) -> dict[int, tuple[Box, ...]]:
    """Read `tracklet_labels.xml`: the boxes of each frame; a tracklet's place in the file is its track id.

    Raises:
        MissingDataError: there is no such file.
        DataError: it is no XML, or a tracklet lacks a field.
    """
    if not path.is_file():
        raise MissingDataError(f"{path}: no such file; a raw drive's objects are in its {TRACKLETS}")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise DataError(path, f"expected XML, got {error.msg}", error.position[0]) from None
    frames: dict[int, list[Box]] = defaultdict(list)
    items = root.findall("item") if root.tag == "tracklets" else root.findall("tracklets/item")
    for track_id, item in enumerate(items):
        where = f"tracklet {track_id}"
        size = np.array([_number(path, item, key, where) for key in ("l", "w", "h")])
        first = _integer(path, item, "first_frame", where)
        class_name = item.findtext("objectType", default="").strip()
        if not class_name or size.min() <= 0.0 or first < 0:
            raise DataError(path, f"{where}: expected objectType, positive h w l and first_frame >= 0")
        for step, pose in enumerate(item.findall("poses/item")):
            box = _box(path, pose, track_id, class_name, size)
            frames[first + step].append(box)
    return {frame: tuple(boxes) for frame, boxes in frames.items()}


def _box(path: Path, pose: ElementTree.Element, track_id: int, class_name: str, size: Point) -> Box:
    where = f"tracklet {track_id}"
    x, y, z, yaw = (_number(path, pose, key, where) for key in ("tx", "ty", "tz", "rz"))
    bottom_to_center = 0.5 * size[2]  # tz is the height of the bottom
    return Box(
        track_id=track_id,
        class_name=class_name,
        T_lidar_obj=se3.from_yaw(yaw, np.array([x, y, z + bottom_to_center])),
        size=size,
        truncation=_integer(path, pose, "truncation", where, default="-1"),
        occlusion=_integer(path, pose, "occlusion", where, default="-1"),
    )


def _integer(path: Path, element: ElementTree.Element, key: str, where: str, default: str | None = None) -> int:
    text = element.findtext(key, default=default)
    try:
        return int(text if text is not None else "nothing")
    except ValueError:
        raise DataError(path, f"{where}: expected an integer in <{key}>, got {text!r}") from None


def _number(path: Path, element: ElementTree.Element, key: str, where: str) -> float:
    text = element.findtext(key)
    try:
        value = float(text if text is not None else "nothing")
    except ValueError:
        raise DataError(path, f"{where}: expected a number in <{key}>, got {text!r}") from None
    if not np.isfinite(value):
        raise DataError(path, f"{where}: expected a finite number in <{key}>, got {text!r}")
    return value


def _choose_times(folder: Path, n_frames: int, clock: str) -> tuple[Float64[np.ndarray, " n"], str, tuple[Path, ...]]:
    """Prefer the scans' own stamps; where they leave out missing scans, the GPS/IMU's, one a frame."""
    scan_stamps, imu_stamps = (folder / name / "timestamps.txt" for name in ("velodyne_points", "oxts"))
    prefers_imu = imu_stamps.is_file() and scan_stamps.is_file() and _leaves_out_frames(scan_stamps, n_frames)
    return choose_times([imu_stamps] if prefers_imu else [scan_stamps, imu_stamps], n_frames, clock)


def _leaves_out_frames(stamps: Path, n_frames: int) -> bool:
    """Tell whether stamps are missing: drive 0009 of 2011-09-26 has blank lines where it has no scan."""
    lines = read_lines(stamps)
    return len(lines) < n_frames or not all(line.strip() for line in lines)


def _choose_poses(
    folder: Path, n_frames: int, recorded: str
) -> tuple[Poses | None, str, tuple[int, ...], tuple[Path, ...]]:
    """Give the GPS/IMU's poses at the scans' own times where both are stamped, or else record by record.

    Frames whose pose had to be bridged over lost records are flagged; without stamps there is nothing to bridge by.
    """
    check_recorded(recorded)
    records = folder / "oxts" / "data"
    if recorded == "poses":
        raise MissingDataError(f"{folder}: a raw drive has no poses file, only oxts")
    if recorded == "none" or not any(records.glob("*.txt")):
        if recorded == "oxts":
            raise MissingDataError(f"{records}: no records; drive {folder.name} has no oxts")
        return None, "none", (), ()
    T_lidar_imu = read_raw_imu(folder.parent)
    if T_lidar_imu is None:
        raise MissingDataError(f"{folder}: oxts needs the IMU's place: no {folder.parent}/calib_imu_to_velo.txt")
    files = [records / f"{frame:010d}.txt" for frame in range(n_frames)]
    there = np.array([path.is_file() for path in files])
    sources = tuple(path for path in files if path.is_file())
    stamps = _both_stamps(folder, n_frames)
    if stamps is not None and there.sum() >= MIN_RECORDS:
        scan_times, imu_times, stamp_files = stamps
        poses, is_sound = interpolate_poses(read_oxts(sources, T_lidar_imu), imu_times[there], scan_times)
        return poses, "oxts at the scans' times", tuple(np.flatnonzero(~is_sound).tolist()), (*sources, *stamp_files)
    if not there.all():
        missing = files[int(np.argmin(there))]
        raise DataError(missing, f"expected a record for each of {n_frames} frames, got no such file")
    return read_oxts(files, T_lidar_imu), "oxts", (), sources


def _both_stamps(folder: Path, n_frames: int) -> tuple[Times, Times, tuple[Path, ...]] | None:
    """Read the times of scans and records; None where one is not there for every frame, or they tell of other times."""
    paths = tuple(folder / name / "timestamps.txt" for name in ("velodyne_points", "oxts"))
    if not all(path.is_file() and not _leaves_out_frames(path, n_frames) for path in paths):
        return None
    scan_times, imu_times = (read_times(path)[:n_frames] for path in paths)
    if np.abs(scan_times - imu_times).max() > NOMINAL_PERIOD:
        return None
    return scan_times, imu_times, paths
