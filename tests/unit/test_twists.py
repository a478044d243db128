"""Twists: steady motions and the poses they lead to."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from registration import se3
from registration.errors import SimulationError
from registration.synthetic.lidar import pose_after, twist_between
from registration.synthetic.lidar.motion import carried, motion_slack


def random_pose(rng: np.random.Generator, reach: float = 50.0):
    return se3.pose(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-reach, reach, 3))


def as_matrix(twist):
    x, y, z = twist[3:]
    return np.vstack([np.column_stack([[[0, -z, y], [z, 0, -x], [-y, x, 0]], twist[:3]]), np.zeros(4)])


@pytest.mark.parametrize("rate", [0.0, 1e-9, 1e-5, 1e-3, 0.3, 20.0])
def test_following_a_twist_is_the_exponential_of_its_matrix(rate):
    rng = np.random.default_rng(3)
    axis = rng.standard_normal(3)
    twist = np.concatenate([rng.uniform(-30.0, 30.0, 3), rate * axis / np.linalg.norm(axis)])
    for t in (-0.05, 0.0, 0.1):
        np.testing.assert_allclose(pose_after(twist, t), expm(t * as_matrix(twist)), atol=1e-10)


@pytest.mark.parametrize("turn", [0.0, 1e-8, 1e-5, 1e-2, 1.0, 3.0])
def test_the_twist_between_two_poses_leads_from_one_to_the_other(turn):
    rng = np.random.default_rng(5)
    for _ in range(20):
        axis = rng.standard_normal(3)
        R = Rotation.from_rotvec(turn * axis / np.linalg.norm(axis)).as_matrix()
        T_before = random_pose(rng)
        T_after = se3.pose(R, rng.uniform(-3.0, 3.0, 3)) @ T_before
        twist = twist_between(T_before, T_after, 0.1)
        np.testing.assert_allclose(pose_after(twist, 0.1) @ T_before, T_after, atol=1e-7)
        np.testing.assert_allclose(twist_between(T_after, T_before, 0.1), -twist, atol=1e-5)


def test_a_twist_is_found_again_whatever_the_time_step():
    twist = np.array([12.0, -3.0, 0.2, 0.01, -0.02, 0.4])
    T = random_pose(np.random.default_rng(0))
    for dt in (1e-3, 0.1, 1.0):
        np.testing.assert_allclose(twist_between(T, pose_after(twist, dt) @ T, dt), twist, atol=1e-8 / dt)


def test_a_car_that_drives_straight_has_its_velocity_as_twist():
    before, after = (se3.from_yaw(0.5, np.array([10.0 + x, 4.0, -1.7])) for x in (0.0, 1.5))
    np.testing.assert_allclose(twist_between(before, after, 0.1), [15.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan])
def test_a_twist_needs_time(dt):
    with pytest.raises(SimulationError, match="needs a time dt > 0"):
        twist_between(np.eye(4), np.eye(4), dt)


def test_no_point_strays_from_its_chords_farther_than_the_slack_says():
    rng = np.random.default_rng(1)
    for _ in range(30):
        twist = np.concatenate([rng.uniform(-60.0, 60.0, 3), rng.uniform(-3.0, 3.0, 3)])
        points = rng.uniform(-40.0, 40.0, (8, 3))
        at = [carried(twist, np.full(8, t), points.T).T for t in (0.0, 0.0125, 0.025)]
        stray = np.linalg.norm(at[1] - 0.5 * (at[0] + at[2]), axis=1)
        assert stray.max() <= 1.1 * motion_slack(twist, points, 0.025)
