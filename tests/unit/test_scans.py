"""Velodyne scans: bytes in, points out."""

import numpy as np
import pytest

from tests.kitti_folder import write
from tracker.errors import DataError, MissingDataError
from tracker.kitti.scans import read_scan

ROWS = np.array([[1.5, -2.25, 0.1, 0.9], [30.0, 4.0, -1.73, 0.0], [-7.0, 0.0, 2.5, np.nan]], dtype="<f4")


def test_a_scan_gives_its_coordinates_unrounded_and_leaves_reflectance_out(tmp_path):
    points = read_scan(write(tmp_path / "000000.bin", ROWS.tobytes()))
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, ROWS[:, :3])


def test_an_empty_file_is_a_sweep_without_returns(tmp_path):
    assert read_scan(write(tmp_path / "000000.bin", b"")).shape == (0, 3)


@pytest.mark.parametrize("n_bytes", [1, 12, 16 + 8, 2 * 16 + 15])
def test_a_scan_cut_off_within_a_point_is_refused(tmp_path, n_bytes):
    path = write(tmp_path / "000004.bin", ROWS.tobytes()[:n_bytes])
    with pytest.raises(DataError, match=rf"000004\.bin: expected a multiple of 16 bytes .*, got {n_bytes}: the last"):
        read_scan(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_coordinate_that_is_no_number_is_refused_and_counted(tmp_path, value):
    broken = np.concatenate([ROWS, ROWS])
    broken[[2, 5], 1] = value
    path = write(tmp_path / "000004.bin", broken.tobytes())
    with pytest.raises(DataError, match=r"000004\.bin: .* got 2 of 6 points with NaN or infinity, first at point 2"):
        read_scan(path)


def test_a_missing_scan_is_named(tmp_path):
    with pytest.raises(MissingDataError, match=r"000009\.bin: no such scan"):
        read_scan(tmp_path / "000009.bin")
