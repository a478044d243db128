"""Where the sensor was: GPS/IMU records (`oxts`) or a file of poses."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from registration import se3
from registration.types import Transform
from tracker.errors import DataError
from tracker.kitti.text import read_lines

N_OXTS_COLUMNS = 30
LONGEST_STEP = 0.25  # between two records that a pose is interpolated from [s]; KITTI has ten a second

Poses = Float64[np.ndarray, "n 4 4"]


def read_poses(path: Path) -> Poses:
    """Read T_world_lidar of each frame: 12 numbers a line, the rows of a 3x4 matrix.

    The world is the file's own frame (usually the LiDAR's first).  Its rotations are made orthonormal when
    rounding has bent them by less than 1e-3, and refused otherwise.

    Raises:
        DataError: a line does not hold 12 finite numbers, or no rotation; the message has path and line.
    """
    rows = []
    for number, line in enumerate(read_lines(path), start=1):
        values = _numbers(path, number, line.split())
        if len(values) != 12:  # a blank line too: line k + 1 is frame k
            raise DataError(path, f"expected 12 numbers (a 3x4 pose), got {len(values)}", number)
        M = values.reshape(3, 4)
        R = se3.nearest_rotation(M[:, :3])
        if not np.allclose(R, M[:, :3], atol=1e-3):
            raise DataError(path, "expected a rotation in the first three columns, got another matrix", number)
        rows.append(se3.pose(R, M[:, 3]))
    if not rows:
        raise DataError(path, "expected one pose a line, got an empty file")
    return np.array(rows)


def read_oxts(files: Sequence[Path], T_lidar_imu: Transform) -> Poses:
    """Turn GPS/IMU records into T_world_lidar: pykitti's Mercator projection, east-north-up, first IMU at 0.

    Args:
        files: one file with a record a line (tracking), or several with one record each (raw).
        T_lidar_imu: the IMU's pose in the LiDAR frame.

    Raises:
        DataError: a record does not hold 30 finite numbers, or one of several files not one record.
    """
    for path in files:
        lines = read_lines(path)
        if len(files) > 1 and len(lines) != 1:  # else the records after it would move to other frames
            raise DataError(path, f"expected one record, got {len(lines)}")
        for number, line in enumerate(lines, start=1):
            values = _numbers(path, number, line.split())
            if len(values) != N_OXTS_COLUMNS:
                raise DataError(path, f"expected {N_OXTS_COLUMNS} columns, got {len(values)}", number)
    from pykitti import utils  # its package pulls in pandas and cv2: seconds that only oxts is worth

    T_imu_lidar = se3.invert(T_lidar_imu)
    return np.array([oxts.T_w_imu @ T_imu_lidar for oxts in utils.load_oxts_packets_and_poses(files)])


def interpolate_poses(
    poses: Poses, times: Float64[np.ndarray, " n"], at: Float64[np.ndarray, " m"]
) -> tuple[Float64[np.ndarray, "m 4 4"], Bool[np.ndarray, " m"]]:
    """Give poses between records: positions on the line, rotations on the shortest turn, from one record to the next.

    Args:
        poses: T_world_lidar of each record, at least 2 of them.
        times: of the records, ascending [s].
        at: times wanted [s]; before the first and after the last record the nearest step goes on.

    Returns:
        T_world_lidar at each of those times, and whether it is to be trusted: it is not where the records around it are
        more than `LONGEST_STEP` apart, or where it lies outside them by more than half of that.
    """
    after = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    before = after - 1
    step = times[after] - times[before]
    share = (at - times[before]) / step
    turns = Rotation.from_matrix(np.swapaxes(poses[before, :3, :3], 1, 2) @ poses[after, :3, :3]).as_rotvec()
    found = poses[before].copy()
    found[:, :3, :3] = poses[before, :3, :3] @ Rotation.from_rotvec(share[:, None] * turns).as_matrix()
    found[:, :3, 3] += share[:, None] * (poses[after, :3, 3] - poses[before, :3, 3])
    outside = np.maximum(times[0] - at, at - times[-1])
    return found, (step <= LONGEST_STEP) & (outside <= 0.5 * LONGEST_STEP)


def _numbers(path: Path, number: int, words: list[str]) -> np.ndarray:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise DataError(path, f"expected numbers, got {' '.join(words)[:80]!r}", number) from None
    if not np.isfinite(values).all():
        raise DataError(path, "expected finite numbers, got NaN or infinity", number)
    return values
