"""Exact truth that a simulator wrote beside a tracking folder: `truth/NNNN.csv`, poses of box centres."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from registration.types import Point
from tracker.errors import DataError, MissingDataError

COLUMNS = (
    "frame", "track_id", "class_name",
    "x_world", "y_world", "z_world", "yaw_world",
    "x_lidar", "y_lidar", "z_lidar", "yaw_lidar",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ExactPose:
    """Where an object's box centre is at the time of a scan, in both frames [m]."""

    center_world: Point
    center_lidar: Point


def read_truth(path: Path) -> dict[tuple[int, int], ExactPose]:
    """Read exact poses by (track id, frame).

    Raises:
        MissingDataError: there is no such file.
        DataError: other columns, or a malformed row; the message has path and line.
    """
    if not path.is_file():
        raise MissingDataError(f"{path}: no such file; only simulated sequences come with exact truth")
    poses = {}
    with path.open(newline="") as file:
        reader = csv.reader(file)
        header = next(reader, [])
        if tuple(header) != COLUMNS:
            raise DataError(path, f"expected columns {','.join(COLUMNS)}, got {','.join(header)}", 1)
        for number, row in enumerate(reader, start=2):
            try:
                frame, track_id = int(row[0]), int(row[1])
                values = np.array([float(word) for word in row[3:]])
                center_world, center_lidar = values[0:3], values[4:7]
            except (ValueError, IndexError):
                raise DataError(path, f"expected a frame, a track and 8 numbers, got {row}", number) from None
            if len(row) != len(COLUMNS) or not np.isfinite(values).all():
                raise DataError(path, f"expected {len(COLUMNS)} finite values, got {row}", number)
            poses[track_id, frame] = ExactPose(center_world, center_lidar)
    return poses
