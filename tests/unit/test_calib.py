"""Calibration files, in all the spellings that are about."""

import numpy as np
import pytest

from tests.kitti_folder import IDENTITY, IMU_TO_LIDAR, LIDAR_TO_CAM, calib_text, row_of, turn, write
from tracker.errors import DataError, MissingDataError
from tracker.kitti.calib import read_raw_imu, read_tracking_calib

BENCHMARK = ("R0_rect", "Tr_velo_to_cam", "Tr_imu_to_velo")
MIRROR = ("R_rect", "Tr_velo_cam", "Tr_imu_velo")
CROOKED = np.column_stack([turn(1, 0.02) @ np.array(LIDAR_TO_CAM)[:, :3], [0.1, -0.08, -0.27]])


def square(matrix) -> np.ndarray:
    """Complete a 3x3 or 3x4 matrix to 4x4."""
    whole = np.eye(4)
    whole[:3, : np.shape(matrix)[1]] = matrix
    return whole


def replaced(tmp_path, key, line):
    """Write a good calibration file, but for one line."""
    lines = [line if old.startswith(key) else old for old in calib_text().splitlines()]
    return write(tmp_path / "0000.txt", "\n".join(lines))


@pytest.mark.parametrize("colon", [":", ""])
@pytest.mark.parametrize("keys", [BENCHMARK, MIRROR])
def test_both_spellings_read_the_same_with_and_without_colons(tmp_path, keys, colon):
    rows = zip(keys, (turn(0, 0.1), CROOKED, IMU_TO_LIDAR), strict=True)
    path = write(tmp_path / "0000.txt", "".join(f"{key}{colon} {row_of(matrix)}  \n" for key, matrix in rows))
    calibration = read_tracking_calib(path)
    np.testing.assert_allclose(calibration.T_cam_lidar, square(turn(0, 0.1)) @ square(CROOKED), atol=1e-12)
    np.testing.assert_allclose(calibration.T_lidar_imu, square(IMU_TO_LIDAR), atol=1e-12)


def test_a_file_without_the_imus_place_gives_none_for_it(tmp_path):
    calibration = read_tracking_calib(write(tmp_path / "0000.txt", calib_text(with_imu=False)))
    assert calibration.T_lidar_imu is None
    np.testing.assert_allclose(calibration.T_cam_lidar, square(LIDAR_TO_CAM), atol=1e-12)


def test_rotations_bent_by_rounding_are_made_orthonormal(tmp_path):
    rounded = np.round(CROOKED, 3)
    R = read_tracking_calib(replaced(tmp_path, "Tr_velo", f"Tr_velo_to_cam: {row_of(rounded)}")).T_cam_lidar[:3, :3]
    assert np.abs(rounded[:, :3] @ rounded[:, :3].T - np.eye(3)).max() > 1e-6
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, CROOKED[:, :3], atol=1e-3)


@pytest.mark.parametrize(
    ("key", "line", "message"),
    [
        ("R0_rect", "R0_rect: 1 0 0 0 1 0 0 0", r"0000\.txt:5: R0_rect: expected 9 finite numbers, got 8"),
        ("Tr_velo", f"Tr_velo_to_cam: {row_of(LIDAR_TO_CAM)} 1", r":6: Tr_velo_to_cam: expected 12 .*, got 13"),
        ("Tr_velo", "Tr_velo_to_cam:", r":6: Tr_velo_to_cam: expected 12 finite numbers, got 0"),
        ("Tr_imu", "Tr_imu_to_velo: 1 0 0 x", r":7: Tr_imu_to_velo: expected 12 numbers, got '1 0 0 x'"),
        ("Tr_imu", "Tr_imu_to_velo: 1 0 0 nan 0 1 0 0 0 0 1 0", r":7: Tr_imu_to_velo: expected 12 finite numbers"),
        ("R0_rect", "R0_rect: 1 0 0 0 inf 0 0 0 1", r":5: R0_rect: expected 9 finite numbers"),
        ("R0_rect", "R0_rect: 0 0 0 0 0 0 0 0 0", r":5: R0_rect: expected a rotation"),
        ("Tr_velo", "Tr_velo_to_cam: 2 0 0 0 0 2 0 0 0 0 2 0", r":6: Tr_velo_to_cam: expected a rotation"),
        ("R0_rect", "R0_rect: 1 0 0 0 1 0 0 0 -1", r":5: R0_rect: expected a rotation"),
        ("R0_rect", "", r"0000\.txt: expected a line R0_rect or R_rect, got P0, P1, P2, P3, Tr_velo_to_cam"),
    ],
)
def test_a_matrix_that_is_none_is_refused_with_file_and_line(tmp_path, key, line, message):
    with pytest.raises(DataError, match=message):
        read_tracking_calib(replaced(tmp_path, key, line))


def test_an_empty_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="expected a line R0_rect or R_rect, got nothing"):
        read_tracking_calib(write(tmp_path / "0000.txt", ""))


def test_bytes_that_are_no_text_are_refused_with_file_and_line(tmp_path):
    with pytest.raises(DataError, match=r"0000\.txt:2: expected text, got the byte 0xff"):
        read_tracking_calib(write(tmp_path / "0000.txt", b"P0: 1\nP1: \xff\n"))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MissingDataError, match=r"0007\.txt: no such calibration file"):
        read_tracking_calib(tmp_path / "0007.txt")


# --- raw drives


def test_a_raw_days_imu_file_is_read_past_its_date(tmp_path):
    text = f"calib_time: 25-May-2012 16:47:16\nR: {row_of(turn(2, 0.3))}\nT: -0.81 0.32 -0.8\n"
    write(tmp_path / "calib_imu_to_velo.txt", text)
    expected = square(np.column_stack([turn(2, 0.3), [-0.81, 0.32, -0.8]]))
    np.testing.assert_allclose(read_raw_imu(tmp_path), expected, atol=1e-12)


def test_a_raw_day_without_an_imu_file_has_no_place_for_the_imu(tmp_path):
    assert read_raw_imu(tmp_path) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"R: {row_of(IDENTITY)}\n", r"calib_imu_to_velo\.txt: expected a line T, got R"),
        (f"R: {row_of(IDENTITY)}\nT: 0 0\n", r"calib_imu_to_velo\.txt:2: T: expected 3 finite numbers, got 2"),
        ("R: 1 1 1 1 1 1 1 1 1\nT: 0 0 0\n", r"calib_imu_to_velo\.txt:1: R: expected a rotation"),
    ],
)
def test_a_malformed_raw_calibration_is_refused(tmp_path, text, message):
    write(tmp_path / "calib_imu_to_velo.txt", text)
    with pytest.raises(DataError, match=message):
        read_raw_imu(tmp_path)
