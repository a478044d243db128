"""Tracking labels: rows of `label_02/NNNN.txt` in, boxes in LiDAR axes out; KITTI's camera axes end here."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from registration import se3
from registration.types import Point, Transform
from tracker.errors import DataError, MissingDataError
from tracker.kitti.text import read_lines
from tracker.types import Box

DONT_CARE = "DontCare"
N_COLUMNS = 17  # frame id type truncated occluded alpha bbox(4) h w l x y z rotation_y; an 18th is a score


@dataclass(frozen=True, slots=True)
class Label:
    """One row of a label file, still in rectified camera axes (x right, y down, z forward).

    Attributes:
        bottom_cam: centre of the box's bottom [m].
        size: length, width, height [m].
        rotation_y: heading about the camera's y axis [rad]; 0 along the camera's x.
    """

    frame: int
    track_id: int
    class_name: str
    truncation: int
    occlusion: int
    bottom_cam: Point
    size: Point
    rotation_y: float

    @property
    def center_cam(self) -> Point:
        """Centre of the box [m]; KITTI's y points down."""
        return self.bottom_cam - [0.0, 0.5 * self.size[2], 0.0]

    def to_box(self, T_lidar_cam: Transform) -> Box:
        """Leave camera axes: centre and heading move to the LiDAR frame, where the box stands upright again.

        A label is upright in the camera's axes, which lean by about a degree against the LiDAR's; like the
        tools that KITTI's own users compare with, we keep the heading and drop that lean.
        """
        heading_cam = np.array([np.cos(self.rotation_y), 0.0, -np.sin(self.rotation_y)])
        heading_lidar = T_lidar_cam[:3, :3] @ heading_cam
        center_lidar = se3.transform(T_lidar_cam, self.center_cam[None])[0]
        return Box(
            track_id=self.track_id,
            class_name=self.class_name,
            T_lidar_obj=se3.from_yaw(float(np.arctan2(heading_lidar[1], heading_lidar[0])), center_lidar),
            size=self.size,
            truncation=self.truncation,
            occlusion=self.occlusion,
        )


def read_labels(path: Path) -> list[Label]:
    """Read a label file; `DontCare` rows are left out.

    Raises:
        MissingDataError: there is no such file.
        DataError: a row is malformed, or a track appears twice in one frame; the message has path and line.
    """
    if not path.is_file():
        raise MissingDataError(f"{path}: no such label file")
    labels = []
    seen: dict[tuple[int, int], int] = {}
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split()
        if not words:
            continue
        label = _parse_row(path, number, words)
        if label is None:
            continue
        first = seen.setdefault((label.frame, label.track_id), number)
        if first != number:
            what = f"track {label.track_id} stands in frame {label.frame} already (line {first})"
            raise DataError(path, what, number)
        labels.append(label)
    return labels


def class_names(labels: Iterable[Label]) -> list[str]:
    """List the classes that occur."""
    return sorted({label.class_name for label in labels})


def _parse_row(path: Path, number: int, words: list[str]) -> Label | None:
    if len(words) not in (N_COLUMNS, N_COLUMNS + 1):
        raise DataError(path, f"expected {N_COLUMNS} columns (18 with a score), got {len(words)}", number)
    if words[2] == DONT_CARE:
        return None
    frame, track_id = _integer(path, number, words[0], "frame"), _integer(path, number, words[1], "track id")
    if frame < 0 or track_id < 0:
        raise DataError(path, f"expected frame and track id >= 0, got {frame} and {track_id}", number)
    numbers = _floats(path, number, words[3:N_COLUMNS])
    height, width, length = numbers[7:10]
    if min(height, width, length) <= 0.0:
        what = f"expected height, width and length > 0 m, got {height:g} {width:g} {length:g}"
        raise DataError(path, what, number)
    return Label(
        frame=frame,
        track_id=track_id,
        class_name=words[2],
        truncation=int(numbers[0]),
        occlusion=int(numbers[1]),
        bottom_cam=numbers[10:13],
        size=np.array([length, width, height]),
        rotation_y=float(numbers[13]),
    )


def _integer(path: Path, number: int, word: str, what: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise DataError(path, f"expected an integer {what}, got {word!r}", number) from None


def _floats(path: Path, number: int, words: list[str]) -> np.ndarray:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise DataError(path, f"expected numbers after the class, got {' '.join(words)!r}", number) from None
    if not np.isfinite(values).all():
        raise DataError(path, f"expected finite numbers, got {' '.join(words)!r}", number)
    return values
