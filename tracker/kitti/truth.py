"""Exact truth that a simulator wrote beside a tracking folder: `truth/NNNN.csv`, poses of box centres."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from registration import se3
from registration.types import Point, Transform
from tracker.errors import DataError, MissingDataError
from tracker.types import Box

_WORLD = ("x_world", "y_world", "z_world", "yaw_world")
_LIDAR = ("x_lidar", "y_lidar", "z_lidar", "yaw_lidar")
COLUMNS = ("frame", "track_id", "class_name", *_WORLD, *_LIDAR)
SENSOR_COLUMNS = ("frame", "track_id", "class_name", *_LIDAR)  # of a sequence whose ego motion nobody knows


@dataclass(frozen=True, slots=True)
class ExactPose:
    """Where an object's box centre is at the time of a scan [m].

    Attributes:
        center_world: in the world; None where the simulator knows no world, only the sensor.
        center_lidar: in the sensor's axes.
    """

    center_world: Point | None
    center_lidar: Point


def format_header(has_world: bool) -> str:
    """Write the first row of a truth file."""
    return ",".join(COLUMNS if has_world else SENSOR_COLUMNS) + "\n"


def format_truth(frame: int, boxes: Iterable[Box], T_world_lidar: Transform | None) -> str:
    """Write where the boxes of a frame exactly are, every digit of the numbers; one row a box.

    Args:
        frame: its number.
        boxes: exact ones.
        T_world_lidar: pose of the sensor; without it the rows have no world columns.
    """
    rows = []
    for box in boxes:
        pose = [*box.center_lidar, box.yaw_lidar]
        if T_world_lidar is not None:
            T_world_box = T_world_lidar @ box.T_lidar_obj
            pose = [*T_world_box[:3, 3], se3.yaw(T_world_box), *pose]
        numbers = ",".join(repr(float(value)) for value in pose)
        rows.append(f"{frame},{box.track_id},{box.class_name},{numbers}\n")
    return "".join(rows)


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
        header = tuple(next(reader, []))
        if header not in (COLUMNS, SENSOR_COLUMNS):
            expected = f"{','.join(COLUMNS)} (or these without {', '.join(_WORLD)})"
            raise DataError(path, f"expected columns {expected}, got {','.join(header)}", 1)
        for number, row in enumerate(reader, start=2):
            track_id, frame, pose = _parse_row(path, number, row, header)
            poses[track_id, frame] = pose
    return poses


def _parse_row(path: Path, number: int, row: list[str], header: tuple[str, ...]) -> tuple[int, int, ExactPose]:
    try:
        frame, track_id = int(row[0]), int(row[1])
        values = np.array([float(word) for word in row[3:]])
    except (ValueError, IndexError):
        what = f"expected a frame, a track and {len(header) - 3} numbers, got {row}"
        raise DataError(path, what, number) from None
    if len(row) != len(header) or not np.isfinite(values).all():
        raise DataError(path, f"expected {len(header)} finite values, got {row}", number)
    center_world = values[0:3] if header == COLUMNS else None
    return track_id, frame, ExactPose(center_world, values[-4:-1])
