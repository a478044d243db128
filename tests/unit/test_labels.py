"""Rows of label files, and the way of a box from camera axes to the LiDAR's."""

from math import cos, pi, sin, sqrt

import numpy as np
import pytest

from registration import se3
from tests.kitti_folder import LIDAR_TO_CAM, dont_care_row, label_row, things, turn, write
from tracker.errors import DataError, MissingDataError
from tracker.kitti.labels import class_names, read_labels

ROW = "7 3 Car 1 2 -1.5 10 20 110 120 1.5 1.6 4.0 2.0 1.7 12.0 -1.25"


def read(tmp_path, text):
    return read_labels(write(tmp_path / "0000.txt", text))


def with_column(column, value):
    words = ROW.split()
    return " ".join([*words[:column], value, *words[column + 1 :]])


def test_a_row_is_read_column_by_column(tmp_path):
    (label,) = read(tmp_path, f"{ROW}\n")
    assert (label.frame, label.track_id, label.class_name) == (7, 3, "Car")
    assert (label.truncation, label.occlusion) == (1, 2)
    np.testing.assert_array_equal(label.size, [4.0, 1.6, 1.5])  # length, width, height; the row has h w l
    np.testing.assert_array_equal(label.bottom_cam, [2.0, 1.7, 12.0])
    np.testing.assert_allclose(label.center_cam, [2.0, 1.7 - 1.5 / 2, 12.0])
    assert label.rotation_y == -1.25


def test_a_score_in_an_eighteenth_column_changes_nothing(tmp_path):
    (plain,), (scored,) = read(tmp_path, ROW), read(tmp_path, f"{ROW} 0.93")
    assert (plain.frame, plain.rotation_y) == (scored.frame, scored.rotation_y)
    np.testing.assert_array_equal(plain.bottom_cam, scored.bottom_cam)


def test_dont_care_rows_are_left_out_also_among_the_classes(tmp_path):
    labels = read(tmp_path, dont_care_row(7) + ROW + "\n" + dont_care_row(7) + dont_care_row(8))
    assert [(label.frame, label.track_id) for label in labels] == [(7, 3)]
    assert class_names(labels) == ["Car"]


def test_class_names_are_listed_once_and_sorted(tmp_path):
    labels = read(tmp_path, "".join(label_row(k, thing) for k in range(4) for thing in things(k)))
    assert class_names(labels) == ["Car", "Pedestrian", "Van"]


def test_blank_lines_are_no_rows_and_do_not_shift_line_numbers(tmp_path):
    assert len(read(tmp_path, f"\n{ROW}\n\n{with_column(0, '8')}\n\n")) == 2
    with pytest.raises(DataError, match=r"0000\.txt:4: expected 17 columns"):
        read(tmp_path, f"\n{ROW}\n\nCar\n")


def test_a_file_without_rows_has_no_labels(tmp_path):
    assert read(tmp_path, "") == []


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (ROW.rsplit(maxsplit=1)[0], r"expected 17 columns \(18 with a score\), got 16"),
        (f"{ROW} 0.9 1", r"expected 17 columns \(18 with a score\), got 19"),
        ("7 -1 DontCare", r"expected 17 columns .*, got 3"),
        (with_column(0, "7.5"), r"expected an integer frame, got '7\.5'"),
        (with_column(1, "x"), r"expected an integer track id, got 'x'"),
        (with_column(0, "-1"), r"expected frame and track id >= 0, got -1 and 3"),
        (with_column(1, "-1"), r"expected frame and track id >= 0, got 7 and -1"),
        (with_column(13, "2.0.1"), r"expected numbers after the class, got '1 2 .*2\.0\.1"),
        (with_column(15, "nan"), r"expected finite numbers, got .*nan"),
        (with_column(16, "inf"), r"expected finite numbers, got .*inf"),
        (with_column(10, "0"), r"expected height, width and length > 0 m, got 0 1\.6 4"),
        (with_column(12, "-4.0"), r"expected height, width and length > 0 m, got 1\.5 1\.6 -4"),
    ],
)
def test_a_truncated_or_malformed_row_is_refused_with_file_and_line(tmp_path, row, message):
    with pytest.raises(DataError, match=rf"0000\.txt:2: {message}"):
        read(tmp_path, f"{with_column(0, '6')}\n{row}\n")


def test_a_track_that_is_twice_in_a_frame_is_refused_with_both_lines(tmp_path):
    with pytest.raises(DataError, match=r"0000\.txt:3: track 3 stands in frame 7 already \(line 1\)"):
        read(tmp_path, f"{ROW}\n{with_column(1, '4')}\n{ROW}\n")


def test_bytes_that_are_no_text_are_refused_with_file_and_line(tmp_path):
    with pytest.raises(DataError, match=r"0000\.txt:2: expected text, got the byte 0x9c"):
        read(tmp_path, f"{ROW}\n".encode() + b"\x9c\x00\x01")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MissingDataError, match=r"0003\.txt: no such label file"):
        read_labels(tmp_path / "0003.txt")


# --- from camera axes to the LiDAR's

T_LIDAR_CAM = np.linalg.inv(np.vstack([LIDAR_TO_CAM, [0, 0, 0, 1]]))


@pytest.mark.parametrize(
    ("rotation_y", "yaw"), [(-pi / 2, 0.0), (0.0, -pi / 2), (pi / 2, pi), (pi, pi / 2), (-pi / 4, -pi / 4)]
)
def test_a_heading_about_the_cameras_y_becomes_a_yaw_about_the_lidars_z(tmp_path, rotation_y, yaw):
    (label,) = read(tmp_path, with_column(16, repr(rotation_y)))
    found = label.to_box(T_LIDAR_CAM).yaw_lidar
    assert (cos(found), sin(found)) == pytest.approx((cos(yaw), sin(yaw)), abs=1e-12)


def test_a_bottom_centre_in_camera_axes_becomes_the_centre_in_the_lidars(tmp_path):
    (label,) = read(tmp_path, ROW)
    box = label.to_box(T_LIDAR_CAM)
    # x = z_cam + 0.27, y = -x_cam, z = -(y_cam - h / 2) - 0.08
    np.testing.assert_allclose(box.center_lidar, [12.0 + 0.27, -2.0, -(1.7 - 0.75) - 0.08], atol=1e-12)
    assert box.ground_z_lidar == pytest.approx(-1.7 - 0.08)
    assert (box.track_id, box.class_name, box.truncation, box.occlusion) == (3, "Car", 1, 2)


def test_a_leaning_camera_moves_the_centre_and_leaves_the_box_upright(tmp_path):
    lean = 0.1  # the camera looks down: its z axis leans towards the LiDAR's -z
    (label,) = read(tmp_path, with_column(16, "0.0"))  # heading along the camera's x
    T_lidar_cam = se3.pose(turn(1, lean) @ T_LIDAR_CAM[:3, :3], np.zeros(3))
    box = label.to_box(T_lidar_cam)
    forward, up = 12.0, -(1.7 - 0.75)
    expected = [forward * cos(lean) + up * sin(lean), -2.0, up * cos(lean) - forward * sin(lean)]
    np.testing.assert_allclose(box.center_lidar, expected, atol=1e-12)
    np.testing.assert_array_equal(box.T_lidar_obj[2, :3], [0.0, 0.0, 1.0])
    assert box.yaw_lidar == pytest.approx(-pi / 2)


def test_the_corners_of_a_box_go_round_its_bottom_and_then_its_top(tmp_path):
    (label,) = read(tmp_path, with_column(16, repr(-pi / 2 - pi / 4)))  # yaw 45 degrees
    box = label.to_box(T_LIDAR_CAM)
    front_left = [(4.0 - 1.6) / 2 / sqrt(2), (4.0 + 1.6) / 2 / sqrt(2), -0.75]
    corners = box.corners_lidar - box.center_lidar
    np.testing.assert_allclose(corners[0], front_left, atol=1e-12)
    np.testing.assert_allclose(corners[2], [-front_left[0], -front_left[1], -0.75], atol=1e-12)
    np.testing.assert_allclose(corners[4:], corners[:4] + [0.0, 0.0, 1.5], atol=1e-12)
