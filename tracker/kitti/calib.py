"""Calibration of a KITTI sequence: where the camera, the LiDAR and the GPS/IMU sit on the car."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.types import Transform
from tracker.errors import DataError, MissingDataError
from tracker.kitti.text import read_lines

# Both spellings exist in the wild: the tracking benchmark's downloads and mirrors disagree.
_RECTIFICATION = ("R0_rect", "R_rect")
_LIDAR_TO_CAM = ("Tr_velo_to_cam", "Tr_velo_cam")
_IMU_TO_LIDAR = ("Tr_imu_to_velo", "Tr_imu_velo")

Entries = dict[str, tuple[int, list[str]]]  # each key's line number and words
Rotation = Float64[np.ndarray, "3 3"]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Where the sensors sit.

    Attributes:
        T_cam_lidar: LiDAR to rectified camera 0, the camera that labels are given in.
        T_lidar_imu: GPS/IMU to LiDAR, or None where the file does not say.
    """

    T_cam_lidar: Transform
    T_lidar_imu: Transform | None


def read_tracking_calib(path: Path) -> Calibration:
    """Read `calib/NNNN.txt` of the tracking benchmark, in either spelling, with or without colons.

    Raises:
        MissingDataError: there is no such file.
        DataError: a matrix is missing, is not made of the expected count of numbers, or is no rotation.
    """
    entries = _read_entries(path)
    R_rect = _matrix(path, entries, _RECTIFICATION, (3, 3))
    T_rect = se3.pose(_rotation(path, entries, _RECTIFICATION, R_rect), np.zeros(3))
    T_cam_lidar = T_rect @ _rigid(path, entries, _LIDAR_TO_CAM)
    has_imu = any(key in entries for key in _IMU_TO_LIDAR)
    return Calibration(T_cam_lidar, _rigid(path, entries, _IMU_TO_LIDAR) if has_imu else None)


def read_projection(path: Path, camera: int = 2) -> Float64[np.ndarray, "3 4"] | None:
    """Read what takes rectified camera 0's axes to a camera's pixels; None where the file does not say.

    Raises:
        MissingDataError: there is no such file.
        DataError: the matrix is not made of 12 numbers.
    """
    entries = _read_entries(path)
    key = f"P{camera}"
    return _matrix(path, entries, (key,), (3, 4)) if key in entries else None


def read_raw_imu(folder: Path) -> Transform | None:
    """Read T_lidar_imu from `calib_imu_to_velo.txt` of a raw day; None where there is no such file.

    A raw drive's boxes are in LiDAR axes: nothing else of its calibration is needed.

    Raises:
        DataError: the file does not hold a rotation R and a translation T.
    """
    path = folder / "calib_imu_to_velo.txt"
    return _raw_rigid(path) if path.exists() else None


def _raw_rigid(path: Path) -> Transform:
    entries = _read_entries(path)
    R = _matrix(path, entries, ("R",), (3, 3))
    t = _matrix(path, entries, ("T",), (3, 1))
    return se3.pose(_rotation(path, entries, ("R",), R), t[:, 0])


def _rigid(path: Path, entries: Entries, keys: tuple[str, ...]) -> Transform:
    M = _matrix(path, entries, keys, (3, 4))
    return se3.pose(_rotation(path, entries, keys, M[:, :3]), M[:, 3])


def _rotation(path: Path, entries: Entries, keys: tuple[str, ...], M: Rotation) -> Rotation:
    """Undo what rounding bent; a matrix farther than 1e-3 from any rotation is none."""
    R = se3.nearest_rotation(M)
    if not np.allclose(R, M, rtol=0.0, atol=1e-3):
        key = next(key for key in keys if key in entries)
        raise DataError(path, f"{key}: expected a rotation, got another matrix", entries[key][0])
    return R


def _read_entries(path: Path) -> Entries:
    """Split `key: numbers` lines."""
    if not path.is_file():
        raise MissingDataError(f"{path}: no such calibration file")
    entries = {}
    for number, line in enumerate(read_lines(path), start=1):
        words = line.replace(":", " ", 1).split()
        if words:
            entries[words[0]] = (number, words[1:])
    return entries


def _matrix(path: Path, entries: Entries, keys: tuple[str, ...], shape: tuple[int, int]) -> np.ndarray:
    key = next((key for key in keys if key in entries), None)
    if key is None:
        raise DataError(path, f"expected a line {' or '.join(keys)}, got {', '.join(entries) or 'nothing'}")
    line, words = entries[key]
    n = shape[0] * shape[1]
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise DataError(path, f"{key}: expected {n} numbers, got {' '.join(words)!r}", line) from None
    if len(values) != n or not np.isfinite(values).all():
        raise DataError(path, f"{key}: expected {n} finite numbers, got {len(values)}", line)
    return values.reshape(shape)
