"""Registration errors: about the object's centre, with levels that are strict."""

import numpy as np
import pytest

from evaluation.registration_error import box_motion, pair_error, score
from registration import planar, se3


def test_errors_are_taken_about_the_objects_centre_not_about_the_sensor():
    center = np.array([30.0, 0.0, 0.0])
    turned = planar.to_transform(np.array([0.0, 0.0, np.deg2rad(2.0)]), center)
    t, r = pair_error(turned, np.eye(4), center)
    assert t == pytest.approx(0.0, abs=1e-12)
    assert np.rad2deg(r) == pytest.approx(2.0)


def test_a_turned_round_heading_is_forgiven_only_about_the_axis():
    center = np.zeros(3)
    flipped = se3.from_yaw(np.pi - 0.01, np.zeros(3))
    assert pair_error(flipped, np.eye(4), center)[1] == pytest.approx(0.01)
    assert pair_error(flipped, np.eye(4), center, heading_axis=False)[1] == pytest.approx(np.pi - 0.01)


def test_turns_that_differ_by_a_full_circle_are_the_same():
    a, b = se3.from_yaw(np.pi - 0.01, np.zeros(3)), se3.from_yaw(-np.pi + 0.01, np.zeros(3))
    assert pair_error(a, b, np.zeros(3), heading_axis=False)[1] == pytest.approx(0.02)


def test_height_does_not_count():
    lifted = se3.pose(np.eye(3), np.array([0.0, 0.0, 0.7]))
    assert pair_error(lifted, np.eye(4), np.zeros(3))[0] == 0.0


def test_levels_need_both_and_are_strict():
    degrees = np.deg2rad([0.5, 0.5, 4.0, 9.0, 0.0])
    errors = np.column_stack([[0.01, 0.02, 0.05, 0.15, 0.3], degrees])
    found = score(errors)
    assert found.share_2cm_1deg == pytest.approx(1 / 5)  # 0.02 m is not below 0.02 m
    assert found.share_10cm_5deg == pytest.approx(3 / 5)
    assert found.share_20cm_10deg == pytest.approx(4 / 5)
    assert found.rmse_t == pytest.approx(np.sqrt((0.01**2 + 0.02**2 + 0.05**2 + 0.15**2 + 0.3**2) / 5))
    assert found.rmse_r_deg == pytest.approx(np.sqrt((0.5**2 + 0.5**2 + 4**2 + 9**2) / 5))


def test_no_pairs_give_undefined_figures():
    assert np.isnan(score(np.empty((0, 2))).rmse_t)


def test_a_boxs_motion_carries_its_corners():
    first = se3.from_yaw(0.3, np.array([10.0, -2.0, 0.5]))
    second = se3.from_yaw(0.5, np.array([10.8, -1.5, 0.6]))
    corner = np.array([[2.0, 0.9, -0.7]])
    moved = se3.transform(box_motion(first, second), se3.transform(first, corner))
    np.testing.assert_allclose(moved, se3.transform(second, corner), atol=1e-12)
