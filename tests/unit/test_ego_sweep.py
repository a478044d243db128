"""The time of each point, and what moving objects' points to one instant does to static and to moving ones."""

from dataclasses import replace

import numpy as np
import pytest

from registration import se3
from registration.synthetic.lidar import pose_after
from tests.ego_world import Drive, clockwise_times
from tracker.ego_motion.sweep import moved_to_frame_time, point_times, twist_of_step
from tracker.estimators.contract import look
from tracker.tracklets import cut
from tracker.types import Box, Frame, Sweep

TWIST = np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.3])
AROUND = np.array([[10.0, 0.0, 0.0], [0.0, 5.0, -1.0], [0.0, -5.0, 2.0], [-9.0, 1e-6, 0.0], [-9.0, -1e-6, 0.0]])


def test_a_sensor_that_turns_clockwise_from_the_rear_sees_the_left_before_the_right():
    times = point_times(AROUND, Sweep(np.zeros(6)))
    np.testing.assert_allclose(times, [0.0, -0.025, 0.025, -0.05, 0.05], atol=1e-6)


def test_the_other_way_round_it_is_the_other_way_round():
    times = point_times(AROUND, Sweep(np.zeros(6), is_clockwise=False))
    np.testing.assert_allclose(times, [0.0, 0.025, -0.025, 0.05, -0.05], atol=1e-6)


def test_a_sweep_that_is_cut_on_the_left_jumps_there_and_is_forward_at_time_0():
    sweep = Sweep(np.zeros(6), cut_azimuth=0.5 * np.pi, period=0.2)
    beside = np.array([[1e-6, 5.0, 0.0], [-1e-6, 5.0, 0.0]])
    np.testing.assert_allclose(point_times(beside, sweep), [-0.05, 0.15], atol=1e-6)
    assert point_times(AROUND[:1], sweep)[0] == pytest.approx(0.0, abs=1e-12)


def test_static_points_come_back_to_where_they_are_at_the_frames_instant():
    rng = np.random.default_rng(0)
    world = rng.uniform(-30.0, 30.0, (500, 3))
    world = world[(world[:, 0] > -20.0) | (np.abs(world[:, 1]) > 5.0)]  # none at the cut, which may be met twice or not
    drive = Drive(TWIST[0], TWIST[5], rolling=True, noise=0.0)
    seen = drive.points(0, world, reach=1e3)
    assert np.abs(seen - world).max() > 0.5
    np.testing.assert_allclose(moved_to_frame_time(seen, Sweep(TWIST)), world, atol=2e-3)


def test_the_twist_of_a_step_leads_through_the_step():
    np.testing.assert_allclose(twist_of_step(pose_after(TWIST, 0.1), 0.1), TWIST, atol=1e-9)


def frame_of(velocity, index, to_frame_time):
    """See a car-like patch that moves steadily, from a sensor that moves steadily; each point when beams meet it."""
    drive = Drive(TWIST[0], TWIST[5])
    patch = np.array([[x, y, z] for x in (-1.0, 0.0, 1.0) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])

    def seen_at(t):
        center = np.array([6.0, -5.0, -0.5]) + np.array([*velocity, 0.0]) * t
        return se3.transform(se3.invert(drive.pose(t)), patch + center)

    times = np.full(len(patch), 0.1 * index)
    for _ in range(5):
        seen = np.array([seen_at(t)[i] for i, t in enumerate(times)])
        times = 0.1 * index + clockwise_times(seen)
    look = float(times.mean())
    yaw = -TWIST[5] * look
    box = Box(7, "Car", se3.from_yaw(yaw, seen.mean(axis=0)), np.array([2.6, 1.6, 1.4]))
    sweep = Sweep(TWIST, to_frame_time=to_frame_time)
    return cut(Frame(index, 0.1 * index, (box,), seen, drive.pose(0.1 * index), sweep=sweep)), drive, look


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (9.0, 1.0), (-14.0, 0.0)])
def test_steps_in_the_world_take_the_time_between_the_looks(velocity):
    frames = [frame_of(velocity, k, to_frame_time=True) for k in (0, 1)]
    centers, times, raw = [], [], []
    for frame, drive, look_time in frames:
        seen = look(frame.segments[7], drive.pose(frame.timestamp))
        assert len(seen.points) == 12
        assert seen.timestamp == pytest.approx(look_time, abs=1e-4)
        assert seen.frame_timestamp == pytest.approx(frame.timestamp)
        assert frame.time_of(7) == pytest.approx(look_time, abs=5e-4)  # of its box's centre
        centers.append(seen.centroid)
        times.append(seen.timestamp)
        raw.append(frame.timestamp)
    found = (centers[1] - centers[0])[:2] / (times[1] - times[0])
    np.testing.assert_allclose(found, velocity, atol=0.02)
    if velocity[0] < -10.0:  # and by the frames' own clock they are off by more than that
        assert np.abs((centers[1] - centers[0])[0] / (raw[1] - raw[0]) - velocity[0]) > 0.3


def test_relative_to_the_sensor_points_are_those_of_the_look_itself():
    frame, drive, look_time = frame_of((0.0, 0.0), 0, to_frame_time=False)
    expected = se3.transform(se3.invert(drive.pose(look_time)), np.array([[6.0, -5.0, -0.5]]))[0]
    np.testing.assert_allclose(look(frame.segments[7], None).centroid[:2], expected[:2], atol=1e-3)
    assert frame.segments[7].timestamp == pytest.approx(look_time, abs=1e-4)


def test_an_estimator_that_undoes_the_sweep_is_shown_points_as_they_were_seen():
    frame, drive, _ = frame_of((0.0, 0.0), 0, to_frame_time=True)
    segment = replace(frame.segments[7], is_swept=True)
    T_world_lidar = drive.pose(frame.timestamp)
    moved, raw = (look(segment, T_world_lidar, undoes_sweep=undoes) for undoes in (False, True))
    assert (moved.is_swept, raw.is_swept) == (False, True)
    np.testing.assert_array_equal(raw.points_lidar, segment.points_lidar)
    np.testing.assert_allclose(raw.points[:, :2], se3.transform(T_world_lidar, segment.points_lidar)[:, :2])
    assert np.abs(moved.points - raw.points).max() > 0.05


def test_without_a_sweep_nothing_is_moved():
    frame, _, _ = frame_of((0.0, 0.0), 0, to_frame_time=True)
    box = next(iter(frame.boxes.values()))
    points = frame.segments[7].points_lidar
    plain = cut(Frame(0, 3.0, (box,), points, None))
    np.testing.assert_array_equal(plain.segments[7].points_lidar, points)
    assert (plain.seen_at, plain.time_of(7)) == ({}, 3.0)


def test_a_box_without_points_is_looked_at_when_the_beams_pass_its_centre():
    box = Box(1, "Car", se3.from_yaw(0.0, np.array([0.0, 8.0, 0.0])), np.array([4.0, 2.0, 1.5]))
    frame = cut(Frame(0, 1.0, (box,), np.array([[20.0, 0.0, 0.0]]), np.eye(4), sweep=Sweep(TWIST)))
    assert frame.time_of(1) == pytest.approx(0.975)
    moved = se3.transform(pose_after(TWIST, -0.025), box.center_lidar[None])[0]
    np.testing.assert_allclose(frame.boxes[1].center_lidar, moved)
