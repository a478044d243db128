"""The tracking benchmark's folder: `velodyne/NNNN`, `label_02`, `calib`, and where there `oxts`, `poses`, `times`."""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

from registration import se3
from registration.synthetic.lidar import HDL_64E_KITTI, beam_models
from tracker.errors import DataError, MissingDataError
from tracker.kitti.calib import Calibration, read_tracking_calib
from tracker.kitti.labels import Label, class_names, read_labels
from tracker.kitti.poses import Poses, read_oxts, read_poses
from tracker.kitti.sequence import KittiSequence, check_recorded, choose_times, count_frames
from tracker.kitti.splits import reindex
from tracker.types import Box

RECORD = "simulation.json"  # says that a folder is our simulator's, and what is in it


def training_folder(root: Path) -> Path | None:
    """Find the folder with `label_02`: the root itself or its `training`; None where there is none."""
    return next((folder for folder in (root, root / "training") if (folder / "label_02").is_dir()), None)


def sequence_names(folder: Path) -> list[str]:
    """List the sequences that have labels."""
    return sorted(path.stem for path in (folder / "label_02").glob("*.txt"))


def open_tracking(root: Path, folder: Path, name: str, clock: str = "auto", recorded: str = "auto") -> KittiSequence:
    """Read a sequence's labels, calibration, times and poses; scans stay on disk.

    Raises:
        MissingDataError: labels or calibration are not there, or the poses asked for.
        DataError: a file is malformed, or has fewer rows than there are frames.
    """
    label_path, calib_path = folder / "label_02" / f"{name}.txt", folder / "calib" / f"{name}.txt"
    labels = read_labels(label_path)
    calibration = read_tracking_calib(calib_path)
    scans = folder / "velodyne" / name
    n_frames = count_frames(max((label.frame for label in labels), default=-1), scans)
    times, clock_source, time_files = choose_times([folder / "times" / f"{name}.txt"], n_frames, clock)
    poses, ego, pose_files = _choose_poses(folder, name, calibration, n_frames, recorded)
    by_frame: dict[int, list[Label]] = defaultdict(list)
    for label in labels:
        by_frame[label.frame].append(label)
    T_lidar_cam = se3.invert(calibration.T_cam_lidar)
    simulation = simulation_of(folder, name)

    def boxes_of(frame: int) -> tuple[Box, ...]:
        return tuple(label.to_box(T_lidar_cam) for label in by_frame.get(frame, []))

    return KittiSequence(
        name=name,
        root=root,
        timestamps=times,
        clock=clock_source,
        poses=poses,
        ego=ego,
        scan_path=lambda frame: scans / f"{frame:06d}.bin",
        boxes_of=boxes_of,
        reindexed=reindex(label.track_id for label in labels),
        class_names=tuple(class_names(labels)),
        sources=(label_path, calib_path, *time_files, *pose_files),
        truth_path=folder / "truth" / f"{name}.csv",
        T_cam_lidar=calibration.T_cam_lidar,
        is_swept=simulation is None or bool(simulation.get("rolling_shutter", True)),
        lasers=HDL_64E_KITTI.name if simulation is None else _known_lasers(simulation),
        is_simulated=simulation is not None,
    )


def simulation_of(folder: Path, name: str) -> dict[str, Any] | None:
    """Give what our simulator's record says of a sequence: its seed and settings; None where it is not simulated.

    Args:
        folder: see `training_folder`; the record is in it, or beside it.
        name: of the sequence.

    Raises:
        DataError: the record is damaged.
    """
    path = next((place / RECORD for place in (folder, folder.parent) if (place / RECORD).is_file()), None)
    if path is None:
        return None
    try:
        settings = json.loads(path.read_bytes())["sequences"].get(name)
        return None if settings is None else dict(settings)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"expected a simulator's record, sequences with their settings, got a damaged file ({error})"
        raise DataError(path, what) from error


def _known_lasers(simulation: dict[str, Any]) -> str | None:
    """Give the name of the beam model that a sequence was simulated with; None where it was a table of somebody's."""
    name = str(simulation.get("beam_model"))
    return name if name.lower() in beam_models() else None


def _choose_poses(
    folder: Path, name: str, calibration: Calibration, n_frames: int, recorded: str
) -> tuple[Poses | None, str, tuple[Path, ...]]:
    """Prefer a pose file, which somebody put there on purpose, to GPS/IMU records, to nothing."""
    check_recorded(recorded)
    pose_path, oxts_path = folder / "poses" / f"{name}.txt", folder / "oxts" / f"{name}.txt"
    wanted = {"auto": (pose_path, oxts_path), "poses": (pose_path,), "oxts": (oxts_path,), "none": ()}[recorded]
    if recorded != "none" and recorded != "auto" and not wanted[0].is_file():
        raise MissingDataError(f"{wanted[0]}: no such file; sequence {name} has no {recorded}")
    if pose_path in wanted and pose_path.is_file():
        path, poses, source = pose_path, read_poses(pose_path), "poses"
    elif oxts_path in wanted and oxts_path.is_file():
        if calibration.T_lidar_imu is None:
            raise MissingDataError(f"{oxts_path} needs the IMU's place: no Tr_imu_to_velo in calib/{name}.txt")
        path, poses, source = oxts_path, read_oxts([oxts_path], calibration.T_lidar_imu), "oxts"
    else:
        return None, "none", ()
    if len(poses) < n_frames:
        raise DataError(path, f"expected a pose for each of {n_frames} frames, got {len(poses)}")
    return poses[:n_frames], source, (path,)
