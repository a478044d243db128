"""Where the sensor was: pose files, and GPS/IMU records checked against Mercator's formula."""

import numpy as np
import pytest

from tests.kitti_folder import IMU_TO_LIDAR, oxts_row, pose_rows, row_of, true_pose, turn, write
from tracker.errors import DataError
from tracker.kitti.poses import read_oxts, read_poses

T_LIDAR_IMU = np.vstack([IMU_TO_LIDAR, [0.0, 0.0, 0.0, 1.0]])
POSE = row_of(np.eye(4)[:3])


def read(tmp_path, *lines):
    return read_poses(write(tmp_path / "poses.txt", "".join(f"{line}\n" for line in lines)))


def test_a_pose_file_gives_one_transform_a_line(tmp_path):
    poses = read_poses(write(tmp_path / "0000.txt", pose_rows(4)))
    assert poses.shape == (4, 4, 4)
    np.testing.assert_allclose(poses[3][:3, :3], turn(2, 0.3), atol=1e-12)
    np.testing.assert_allclose(poses[:, :3, 3], [[0, 0, 0], [2, 0, 0], [4, 0, 0], [6, 0, 0]])
    np.testing.assert_array_equal(poses[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))


def test_rotations_bent_by_rounding_are_made_orthonormal(tmp_path):
    rounded = np.round(np.column_stack([turn(2, 1.0) @ turn(0, 0.5), [1.0, 2.0, 3.0]]), 4)
    R = read(tmp_path, row_of(rounded))[0, :3, :3]
    assert np.abs(rounded[:, :3] @ rounded[:, :3].T - np.eye(3)).max() > 1e-6
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (POSE.rsplit(maxsplit=1)[0], r"expected 12 numbers \(a 3x4 pose\), got 11"),
        (f"{POSE} 0 0 0 1", r"expected 12 numbers \(a 3x4 pose\), got 16"),
        ("", r"expected 12 numbers \(a 3x4 pose\), got 0"),
        ("1 0 0 0 0 1 0 x 0 0 1 0", r"expected numbers, got '1 0 0 0 0 1 0 x"),
        ("1 0 0 0 0 1 0 nan 0 0 1 0", r"expected finite numbers, got NaN or infinity"),
        ("2 0 0 0 0 2 0 0 0 0 2 0", r"expected a rotation in the first three columns"),
        ("0 0 0 0 0 0 0 0 0 0 0 0", r"expected a rotation in the first three columns"),
        ("-1 0 0 0 0 1 0 0 0 0 1 0", r"expected a rotation in the first three columns"),
    ],
)
def test_a_line_that_is_no_pose_is_refused_with_file_and_line(tmp_path, line, message):
    with pytest.raises(DataError, match=rf"poses\.txt:2: {message}"):
        read(tmp_path, POSE, line, POSE)


def test_a_pose_file_without_poses_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"poses\.txt: expected one pose a line, got an empty file"):
        read(tmp_path, "", "")


def test_blank_lines_at_the_end_are_no_poses(tmp_path):
    assert len(read(tmp_path, POSE, POSE, "", "")) == 2


# --- GPS/IMU


def test_records_become_poses_in_mercators_projection_with_the_first_imu_as_origin(tmp_path):
    path = write(tmp_path / "0000.txt", "".join(oxts_row(k) for k in range(6)))
    poses = read_oxts([path], T_LIDAR_IMU)
    # Positions are a few metres out of 1e7: half a micrometre is what float64 leaves of Mercator's differences.
    np.testing.assert_allclose(poses, [true_pose(k) for k in range(6)], atol=1e-6)
    assert np.abs(poses[5][:3, 3] - poses[0][:3, 3]).min() > 0.1
    np.testing.assert_allclose((poses[0] @ T_LIDAR_IMU)[:3, 3], 0.0, atol=1e-9)


def test_one_file_a_record_gives_the_same_poses_as_one_file_for_all(tmp_path):
    together = write(tmp_path / "0000.txt", "".join(oxts_row(k) for k in range(3)))
    apart = [write(tmp_path / f"{k:010d}.txt", oxts_row(k)) for k in range(3)]
    np.testing.assert_array_equal(read_oxts(apart, T_LIDAR_IMU), read_oxts([together], T_LIDAR_IMU))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (oxts_row(1).rsplit(maxsplit=1)[0], r"expected 30 columns, got 29"),
        (f"{oxts_row(1).strip()} 7", r"expected 30 columns, got 31"),
        (oxts_row(1).replace("0.25", "abc", 1), r"expected numbers, got '49\.000002"),
        (oxts_row(1).replace("0.25", "nan", 1), r"expected finite numbers, got NaN or infinity"),
        ("", r"expected 30 columns, got 0"),
    ],
)
def test_a_malformed_record_is_refused_with_file_and_line(tmp_path, row, message):
    path = write(tmp_path / "oxts.txt", f"{oxts_row(0)}{row.strip()}\n{oxts_row(2)}")
    with pytest.raises(DataError, match=rf"oxts\.txt:2: {message}"):
        read_oxts([path], T_LIDAR_IMU)


@pytest.mark.parametrize("n_records", [0, 2])
def test_a_file_among_several_that_holds_no_one_record_is_refused(tmp_path, n_records):
    files = [write(tmp_path / f"{k}.txt", oxts_row(k)) for k in range(3)]
    write(files[1], oxts_row(1) * n_records)
    with pytest.raises(DataError, match=rf"1\.txt: expected one record, got {n_records}"):
        read_oxts(files, T_LIDAR_IMU)
