"""Poses refined against the static scene: from good, bad and missing starts, and where there is nothing to see."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.pose_error import score_steps, step_errors
from registration import se3
from tests.ego_world import Drive, street
from tracker.ego_motion.contract import EgoPose, EgoPoses, RecordedPoses
from tracker.ego_motion.refine import Refiner, carried_to
from tracker.ego_motion.scan_to_map import LocalMap, RefineSettings, fit
from tracker.ego_motion.smooth import smooth_poses
from tracker.ego_motion.static_scene import SceneSettings, static_points
from tracker.types import Box

WORLD = street(density=3.0)
N = 10
JITTER = 0.06  # 5 ms at 12 m/s [m]


def jittered(poses, seed=0):
    """Move poses along their way by what a few milliseconds make."""
    shifts = JITTER * np.random.default_rng(seed).standard_normal(len(poses))
    return np.array([pose @ se3.from_yaw(0.0, np.array([s, 0.0, 0.0])) for pose, s in zip(poses, shifts, strict=True)])


def run(refiner, frames):
    return [refiner.update(frame) for frame in frames]


def poses_of(found):
    return np.array([pose.T_world_lidar for pose in found])


@pytest.fixture(scope="module")
def drive():
    return Drive()


@pytest.fixture(scope="module")
def frames(drive):
    return [drive.frame(k, WORLD, pose) for k, pose in enumerate(jittered(drive.poses(N)))]


@pytest.fixture(scope="module")
def refined(frames):
    return run(Refiner(RecordedPoses()), frames)


def test_jitter_between_records_and_scans_is_taken_out(drive, frames, refined):
    before = score_steps(np.array([frame.T_world_lidar for frame in frames]), drive.poses(N))
    after = score_steps(poses_of(refined), drive.poses(N))
    assert before.rms_shift > 0.04
    assert after.rms_shift < 0.002
    assert after.rms_yaw < 1e-4
    assert not any(pose.is_flagged for pose in refined)
    np.testing.assert_array_equal(refined[0].T_world_lidar, frames[0].T_world_lidar)  # the world is the records'


def test_the_covariance_of_a_step_is_that_of_its_two_ends(refined):
    for before, after in zip(refined[1:], refined[2:], strict=False):
        shift = (after.T_world_lidar - before.T_world_lidar)[:2, 3]
        np.testing.assert_allclose(after.step_covariance, after.covariance + carried_to(before.covariance, shift))
    np.testing.assert_array_equal(refined[1].step_covariance, refined[1].covariance)  # the first scan is the map


@pytest.mark.parametrize("shared", [0.0, 0.02])
def test_the_covariance_of_a_pose_is_honest_where_neighbours_are_off_together_too(drive, shared):
    settings = RefineSettings(floor_shift=1e-9, floor_turn=1e-9)
    local_map = LocalMap.of(WORLD, np.zeros(3), settings)
    rng = np.random.default_rng(4)
    errors, claimed = [], []
    for _ in range(30):
        seen = WORLD[rng.uniform(size=len(WORLD)) < 0.1]
        cells = np.unique(np.floor(seen[:, :2] / 2.0), axis=0, return_inverse=True)[1].ravel()
        off = shared * rng.standard_normal((cells.max() + 1, 3))[cells] + 0.02 * rng.standard_normal(seen.shape)
        found = fit(local_map, seen + off, np.eye(4), settings)
        planar = np.ix_([0, 1, 5], [0, 1, 5])
        errors.append([*found.T_world_lidar[:2, 3], se3.yaw(found.T_world_lidar)])
        claimed.append(found.covariance[planar])
    scatter = np.array(errors) - np.mean(errors, axis=0)  # the map's own error is the same in all scans
    squared = np.einsum("ni,ni->n", scatter, np.linalg.solve(claimed, scatter[..., None])[..., 0])
    assert 0.5 < squared.mean() / 3.0 < 2.0
    assert np.sqrt(np.mean(claimed, axis=0)[0, 0]) > (1.5e-3 if shared else 3e-4)


def test_nothing_but_the_scans_is_enough_once_the_motion_is_known(drive):
    slow = Drive(speed=3.0)
    found = run(Refiner(None), [slow.frame(k, WORLD) for k in range(8)])
    assert score_steps(poses_of(found), slow.poses(8)).max_shift < 0.01
    np.testing.assert_array_equal(found[0].T_world_lidar, np.eye(4))


def test_the_sweeps_own_motion_is_allowed_for(drive):
    rolling = Drive(rolling=True)
    frames = [rolling.frame(k, WORLD, pose) for k, pose in enumerate(rolling.poses(7))]
    taken_as_they_are = run(Refiner(RecordedPoses()), [replace(frame, sweep=None) for frame in frames])
    allowed_for = run(Refiner(RecordedPoses()), frames)
    rough = score_steps(poses_of(taken_as_they_are), rolling.poses(7))
    good = score_steps(poses_of(allowed_for), rolling.poses(7))
    assert good.max_shift < 0.006
    assert rough.rms_shift > 2.0 * good.rms_shift


def test_an_object_that_moves_is_no_part_of_the_scene_where_it_has_a_box(drive):
    rng = np.random.default_rng(3)
    body = rng.uniform([-6.0, -1.2, -1.7], [6.0, 1.2, 2.0], (12000, 3)) + [9.0, 3.5, 0.0]
    box = Box(0, "Truck", se3.from_yaw(0.0, np.array([9.0, 3.5, 0.15])), np.array([12.0, 2.4, 3.7]))

    def with_lorry(k, boxes):  # that keeps up with the sensor
        frame = drive.frame(k, WORLD[::8], drive.pose(0.1 * k), boxes)
        return replace(frame, points_lidar=np.concatenate([frame.points_lidar, body]))

    assert len(static_points(with_lorry(0, (box,)), SceneSettings())) < len(drive.points(0, WORLD[::8])) + 1
    errors = [
        score_steps(poses_of(run(Refiner(RecordedPoses()), [with_lorry(k, boxes) for k in range(5)])), drive.poses(5))
        for boxes in ((box,), ())
    ]
    assert errors[0].rms_shift < 0.005
    assert errors[1].rms_shift > 3.0 * errors[0].rms_shift


def test_a_drive_that_starts_fast_is_followed_and_odometry_that_is_lost_is_not():
    class Lost:
        """Odometry that thinks that the car stands still."""

        def update(self, frame):
            return EgoPose(np.eye(4))

    fast = Drive(speed=33.0)
    frames = [fast.frame(k, WORLD) for k in range(5)]
    for prior in (None, Lost()):
        assert score_steps(poses_of(run(Refiner(prior), frames)), fast.poses(5)).max_shift < 0.01


# --- where there is nothing to see


def emptied(frame):
    return replace(frame, points_lidar=np.empty((0, 3)))


@pytest.mark.parametrize("lose", [emptied, lambda frame: replace(frame, points_lidar=None)])
def test_a_scan_without_a_scene_gets_the_records_step_flagged_and_the_others_stay(drive, frames, refined, lose):
    found = run(Refiner(RecordedPoses()), [*frames[:5], lose(frames[5]), *frames[6:]])
    assert [pose.is_flagged for pose in found] == [k == 5 for k in range(N)]
    records = se3.invert(frames[4].T_world_lidar) @ frames[5].T_world_lidar
    np.testing.assert_allclose(se3.invert(found[4].T_world_lidar) @ found[5].T_world_lidar, records, atol=1e-9)
    assert found[5].covariance is None
    for k in (5, 6):
        assert np.sqrt(found[k].step_covariance[0, 0]) > 0.5  # [m]: ten metres a second
    for k in (*range(1, 5), *range(7, N)):
        assert np.sqrt(found[k].step_covariance[0, 0]) < 0.01
    errors = step_errors(poses_of(found), drive.poses(N))
    assert np.hypot(*errors[[0, 1, 2, 3, 6, 7, 8], :2].T).max() < 0.01


def test_a_scan_that_is_all_boxes_has_no_scene(drive, frames):
    everything = Box(0, "Misc", se3.from_yaw(0.0, np.zeros(3)), np.array([500.0, 500.0, 50.0]))
    found = run(Refiner(RecordedPoses()), [*frames[:3], replace(frames[3], boxes=(everything,)), frames[4]])
    assert [pose.is_flagged for pose in found] == [False, False, False, True, False]


def test_a_first_scan_without_a_scene_only_delays_the_map(drive, frames):
    found = run(Refiner(RecordedPoses()), [emptied(frames[0]), *frames[1:6]])
    assert [pose.is_flagged for pose in found] == [True, True, False, False, False, False]
    assert score_steps(poses_of(found)[1:], drive.poses(6)[1:]).max_shift < 0.01


def test_bare_ground_does_not_hold_the_pose_and_says_so(drive):
    rng = np.random.default_rng(2)
    plane = np.column_stack([rng.uniform(-50.0, 80.0, (60000, 2)), np.full(60000, -1.7)])
    found = run(Refiner(RecordedPoses()), [drive.frame(k, plane, drive.pose(0.1 * k)) for k in range(4)])
    assert [pose.is_flagged for pose in found] == [False, True, True, True]
    assert min(np.sqrt(pose.step_covariance[0, 0]) for pose in found[1:]) > 0.05
    np.testing.assert_allclose(poses_of(found)[:, :2, 3], drive.poses(4)[:, :2, 3], atol=0.05)


def test_a_scan_of_another_place_starts_a_new_map(drive, frames):
    elsewhere = street(seed=5) + [0.0, 0.0, 30.0]
    later = [drive.frame(k, elsewhere, drive.pose(0.1 * k)) for k in range(5, 9)]
    found = run(Refiner(RecordedPoses()), [*frames[:5], *later])
    assert [pose.is_flagged for pose in found] == [k == 5 for k in range(9)]
    assert np.hypot(*step_errors(poses_of(found), drive.poses(9))[6:, :2].T).max() < 0.01


def test_a_heading_that_drifts_is_drawn_back_slowly(drive):
    class Turned(RecordedPoses):
        """Records whose heading is 0.02 rad off from the second frame on."""

        def update(self, frame):
            off = 0.02 if frame.index else 0.0
            return EgoPose(drive.pose(0.1 * frame.index) @ se3.from_yaw(off, np.zeros(3)))

    found = run(Refiner(Turned()), [drive.frame(k, WORLD) for k in range(4)])
    off = np.array([se3.yaw(pose.T_world_lidar) - 0.01 * k for k, pose in enumerate(found)])
    np.testing.assert_allclose(np.diff(off), 0.02 * 0.1 / 30.0, rtol=0.6)  # towards the records, in half a minute


# --- a whole sequence


def rough_poses(drive, sigma, n=60, seed=1):
    noise = np.random.default_rng(seed).normal(0.0, sigma, (n, 3))
    exact = drive.poses(n)
    rough = np.array([se3.from_yaw(e[2], np.zeros(3)) @ T for e, T in zip(noise, exact, strict=True)])
    rough[:, :2, 3] = exact[:, :2, 3] + noise[:, :2]
    return EgoPoses(rough, "noise", np.tile(np.diag(np.square(sigma)), (n, 1, 1)), np.full((n, 3, 3), np.nan)), exact


def test_smoothing_takes_out_what_a_car_cannot_do_and_knows_what_is_left(drive):
    times = 0.1 * np.arange(60)
    scores, before = [], []
    for seed in range(6):
        rough, exact = rough_poses(drive, (0.004, 0.004, 3e-4), seed=seed)
        smoothed = smooth_poses(rough, times)
        scores.append(score_steps(smoothed.T_world_lidar, exact, smoothed.step_covariances))
        before.append(score_steps(rough.T_world_lidar, exact).rms_shift)
    assert np.mean([score.rms_shift for score in scores]) < 0.35 * np.mean(before)
    assert 0.3 < np.mean([score.nees for score in scores]) / 3.0 < 1.5
    assert np.isnan(smoothed.step_covariances[0]).all()


def test_smoothing_leads_past_a_guess(drive):
    rough, exact = rough_poses(drive, (0.004, 0.004, 3e-4))
    T, covariances = rough.T_world_lidar.copy(), rough.covariances.copy()
    T[20, :2, 3] += 2.0
    covariances[20] = np.nan
    smoothed = smooth_poses(
        replace(rough, T_world_lidar=T, covariances=covariances, flagged=(20,)), 0.1 * np.arange(60)
    )
    assert smoothed.flagged == (20,)
    assert np.hypot(*(smoothed.T_world_lidar[20, :2, 3] - exact[20, :2, 3])) < 0.02
    assert smoothed.step_covariances[20, 0, 0] > smoothed.step_covariances[30, 0, 0]


def test_an_unsure_heading_makes_places_far_off_unsure():
    C = carried_to(np.diag([0.0, 0.0, 0.01**2]), np.array([0.0, 50.0]))
    np.testing.assert_allclose(np.diag(C), [0.5**2, 0.0, 0.01**2])
