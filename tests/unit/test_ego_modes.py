"""Where poses come from: the modes and what they name, odometry, what is kept on disk, and the errors in between."""

import logging
import sys
from dataclasses import replace

import numpy as np
import pytest

from evaluation.pose_error import score_steps
from registration import se3
from registration.errors import MissingLibraryError
from tests.ego_world import Drive, street
from tests.kitti_folder import oxts_row, pose_rows, row_of, write, write_tracking
from tracker.ego_motion import modes
from tracker.ego_motion.common_mode import with_pose_covariance
from tracker.ego_motion.modes import EgoConfig, create_ego_estimator, estimate_poses, with_ego
from tracker.ego_motion.odometry import LidarOdometry, OdometrySettings, raised
from tracker.ego_motion.stored import load_poses
from tracker.errors import InputError, MissingDataError
from tracker.kitti import check_poses, open_sequence
from tracker.kitti.poses import interpolate_poses
from tracker.store import cut_sequence
from tracker.types import UNKNOWN_STEP, EstimateStatus, SegmentedFrame, VelocityEstimate

pytest.importorskip("kiss_icp")
WORLD = street(seed=1)
N = 6


@pytest.fixture(scope="module")
def drive():
    return Drive(speed=6.0)


@pytest.fixture(scope="module")
def training(tmp_path_factory, drive):
    """Write a folder whose scans show a street, with the car and the others of `kitti_folder` in the labels."""
    training = write_tracking(tmp_path_factory.mktemp("street"), n_frames=N)
    for k in range(N):
        points = np.column_stack([drive.points(k, WORLD), np.zeros(len(drive.points(k, WORLD)))])
        write(training / "velodyne" / "0000" / f"{k:06d}.bin", points.astype("<f4").tobytes())
    return training


def opened(training, mode, **settings):
    config = EgoConfig(mode, **settings)
    return with_ego(open_sequence(training.parent, "0000", recorded=config.recorded), config)


# --- words


@pytest.mark.parametrize(
    ("mode", "kind", "prior", "recorded"),
    [
        ("auto", "auto", "auto", "auto"),
        ("poses", "poses", "auto", "poses"),
        ("odometry", "odometry", "auto", "none"),
        ("refined", "refined", "auto", "auto"),
        ("refined:odometry", "refined", "odometry", "none"),
        ("refined-smooth:oxts", "refined-smooth", "oxts", "oxts"),
    ],
)
def test_a_mode_says_what_is_read_and_what_it_starts_from(mode, kind, prior, recorded):
    config = EgoConfig(mode)
    assert (config.kind, config.prior, config.recorded) == (kind, prior, recorded)


@pytest.mark.parametrize("mode", ["gps", "", "poses:oxts", "refined:gps", "refined:auto"])
def test_a_mode_that_there_is_not_is_refused(mode):
    with pytest.raises(InputError, match=r"unknown ego poses .*expected one of auto, oxts, poses, odometry, refined"):
        EgoConfig(mode)


def test_recorded_poses_are_nothing_to_estimate():
    with pytest.raises(InputError, match="ego poses 'oxts' are not estimated"):
        create_ego_estimator(EgoConfig("oxts"))


# --- choices


def test_auto_takes_what_is_recorded_and_says_which(training, tmp_path):
    recorded = write_tracking(tmp_path)
    write(recorded / "oxts" / "0000.txt", "".join(oxts_row(k) for k in range(5)))
    assert opened(recorded, "auto").ego == "oxts"
    write(recorded / "poses" / "0000.txt", pose_rows(5))
    assert opened(recorded, "auto").ego == "poses"
    assert opened(recorded, "oxts").ego == "oxts"
    assert (opened(recorded, "none").ego, opened(recorded, "none").poses) == ("none", None)


def test_auto_without_records_estimates_and_says_so(training, drive):
    sequence = opened(training, "auto")
    assert sequence.ego == "refined from odometry"
    assert score_steps(sequence.poses, drive.poses(N)).rms_shift < 0.01


def test_auto_relative_to_the_sensor_estimates_nothing(training):
    sequence = open_sequence(training.parent, "0000")
    assert with_ego(sequence, EgoConfig("auto"), in_world=False).poses is None


def test_auto_without_the_library_has_no_poses_and_the_world_is_refused(training, monkeypatch):
    monkeypatch.setattr(modes, "has_kiss_icp", lambda: False)
    sequence = opened(training, "auto")
    assert (sequence.ego, sequence.poses) == ("none", None)
    with pytest.raises(MissingDataError, match="has no ego poses .* or for odometry"):
        check_poses([sequence])


@pytest.mark.parametrize("kind", ["poses", "oxts"])
def test_records_that_were_asked_for_must_be_there(training, kind):
    with pytest.raises(MissingDataError, match=rf"{kind}.0000\.txt: no such file; sequence 0000 has no {kind}"):
        opened(training, kind)


def test_broken_records_do_no_harm_to_odometry(training, tmp_path):
    broken = write_tracking(tmp_path, n_frames=N)
    for path in (training / "velodyne" / "0000").iterdir():
        write(broken / "velodyne" / "0000" / path.name, path.read_bytes())
    write(broken / "poses" / "0000.txt", f"{row_of(np.full((3, 4), np.nan))}\n")
    assert opened(broken, "odometry").ego == "odometry"


def test_a_missing_library_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    with pytest.raises(MissingLibraryError, match=r"pip install 'regmot\[odometry\]'"):
        LidarOdometry()


# --- odometry


def test_odometry_finds_the_way_from_scans_alone(training, drive):
    sequence = opened(training, "odometry")
    score = score_steps(sequence.poses, drive.poses(N))
    assert score.rms_shift < 0.1  # of 0.6 m a step
    assert score.rms_yaw < 3e-3
    assert sequence.step_covariance(3) is None
    again = opened(training, "odometry")
    np.testing.assert_array_equal(again.poses, sequence.poses)


def test_refining_makes_odometry_several_times_better(training, drive):
    rough, fine = (
        score_steps(opened(training, mode).poses, drive.poses(N)) for mode in ("odometry", "refined:odometry")
    )
    assert fine.rms_shift < 0.25 * rough.rms_shift


def test_odometry_allows_for_the_sweeps_own_motion():
    rolling = Drive(speed=10.0, rolling=True)
    frames = [rolling.frame(k, WORLD) for k in range(N)]
    as_they_are = [LidarOdometry() for _ in range(2)]
    found = [
        np.array(
            [
                estimator.update(replace(frame, sweep=sweep) if sweep is None else frame).T_world_lidar
                for frame in frames
            ]
        )
        for estimator, sweep in zip(as_they_are, (None, True), strict=True)
    ]
    errors = [np.abs(score_steps(poses, rolling.poses(N)).mean_forward) for poses in found]
    assert errors[1] < 0.03  # of 1 m a step
    assert errors[1] < errors[0] + 0.01


def test_a_scan_without_points_is_a_guess_at_constant_velocity(drive):
    frames = [drive.frame(k, WORLD) for k in range(N)]
    frames[3] = replace(frames[3], points_lidar=None)
    estimator = LidarOdometry()
    found = [estimator.update(frame) for frame in frames]
    assert [pose.is_flagged for pose in found] == [k == 3 for k in range(N)]
    poses = np.array([pose.T_world_lidar for pose in found])
    np.testing.assert_allclose(se3.invert(poses[2]) @ poses[3], se3.invert(poses[1]) @ poses[2], atol=1e-6)
    assert score_steps(poses, drive.poses(N)).max_shift < 0.3


def test_beams_are_raised_as_kiss_icp_does_it():
    pybind = pytest.importorskip("kiss_icp.pybind.kiss_icp_pybind")
    points = np.random.default_rng(0).uniform(-40.0, 40.0, (200, 3))
    expected = np.asarray(pybind._correct_kitti_scan(pybind._Vector3dVector(points)))
    np.testing.assert_allclose(raised(points), expected, atol=1e-9)


def test_the_correction_of_the_beams_is_a_setting(drive):
    frame, flat = drive.frame(0, WORLD), LidarOdometry(OdometrySettings(correct_beam_angles=True))
    flat.update(frame)
    plain = LidarOdometry()
    plain.update(frame)
    heights = [np.median(e._kiss.local_map.point_cloud()[:, 2]) for e in (flat, plain)]
    assert heights[0] > heights[1] + 0.02  # 0.2 degrees at 20 m


# --- scans that hold nothing


def test_scans_with_nothing_in_them_are_an_error_where_odometry_was_asked_for(tmp_path, caplog):
    empty = write_tracking(tmp_path)  # a dozen points a scan
    with pytest.raises(MissingDataError, match="sequence 0000: 5 of 5 scans hold nothing static to register"):
        opened(empty, "odometry")
    with caplog.at_level(logging.WARNING):
        assert opened(empty, "auto").poses is None
    assert "hold nothing static" in caplog.text


def test_a_guess_is_flagged_has_a_large_covariance_and_changes_no_other_step(training, tmp_path, drive):
    holed = write_tracking(tmp_path, n_frames=N)
    for path in (training / "velodyne" / "0000").iterdir():
        write(holed / "velodyne" / "0000" / path.name, b"" if path.stem == "000003" else path.read_bytes())
    write(holed / "poses" / "0000.txt", "".join(f"{row_of(pose[:3])}\n" for pose in drive.poses(N)))
    sequence, whole = opened(holed, "refined"), opened(training, "refined:none")
    assert sequence.flagged == (3,)
    assert whole.flagged == ()
    np.testing.assert_array_equal(sequence.step_covariance(3), UNKNOWN_STEP)
    assert sequence.step_covariance(0) is None
    assert np.sqrt(sequence.step_covariance(2)[0, 0]) < 0.02
    assert score_steps(sequence.poses[:3], drive.poses(3)).max_shift < 0.01
    store = cut_sequence(sequence, tmp_path / "store")
    assert store.manifest["flagged_poses"] == [3]
    for kept, frame in zip(store.frames(), sequence.frames(), strict=True):
        if frame.index == 0:
            assert kept.ego_step_covariance is None
        else:
            np.testing.assert_array_equal(kept.ego_step_covariance, frame.ego_step_covariance)


def test_frames_without_the_poses_to_start_from_are_named(training):
    class Nothing:
        def update(self, frame):
            return None

    with pytest.raises(MissingDataError, match="frame 0 has no pose to start from"):
        estimate_poses(open_sequence(training.parent, "0000"), Nothing(), "nothing")


# --- kept on disk


def test_estimates_are_kept_and_made_anew_when_anything_else_was_asked_for(training, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(modes, "_estimate", lambda *given: asked.append(given) or original(*given))
    config = EgoConfig("odometry")
    sequence = open_sequence(training.parent, "0000")
    first = with_ego(sequence, config, tmp_path)
    second = with_ego(sequence, config, tmp_path)
    assert len(asked) == 1
    np.testing.assert_array_equal(first.poses, second.poses)
    with_ego(sequence, replace(config, correct_beam_angles=True), tmp_path)
    assert len(asked) == 2
    path = next(tmp_path.glob("*.npz"))
    path.write_bytes(path.read_bytes()[:100])
    with_ego(sequence, config, tmp_path)
    assert len(asked) == 3
    assert load_poses(path, "something else") is None


original = modes._estimate


def test_poses_are_part_of_what_segments_were_made_of(training, tmp_path):
    prints = {opened(training, mode).fingerprint() for mode in ("none", "odometry", "refined:none")}
    prints.add(opened(training, "none", deskew=True).fingerprint())
    assert len(prints) == 4


# --- between records


def test_poses_between_records_lie_between_them_and_gaps_are_known():
    drive = Drive(speed=5.0)
    times = np.array([0.0, 0.1, 0.2, 0.6, 0.7])
    at = np.array([0.05, 0.1, 0.17, 0.4, 0.65, 0.8, 1.2, -0.05])
    found, is_sound = interpolate_poses(np.array([drive.pose(t) for t in times]), times, at)
    np.testing.assert_array_equal(is_sound, [True, True, True, False, True, True, False, True])
    np.testing.assert_allclose(found[is_sound], [drive.pose(t) for t in at[is_sound]], atol=0.01)
    np.testing.assert_allclose(found[1], drive.pose(0.1), atol=1e-15)
    np.testing.assert_allclose(
        found[:, :3, :3] @ np.swapaxes(found[:, :3, :3], 1, 2), np.tile(np.eye(3), (8, 1, 1)), atol=1e-12
    )


# --- what the pose adds to a velocity


def estimate(position, frame_name="world", status=EstimateStatus.CONVERGED):
    return VelocityEstimate(
        1, 5, 0.5, frame_name, np.array(position), np.zeros(2), 0.01 * np.eye(2), 0.0, 9.0, 10, status
    )


def frame_with(covariance):
    return SegmentedFrame(5, 0.5, {}, {}, se3.from_yaw(0.3, np.array([100.0, 50.0, 0.0])), covariance)


def test_an_unsure_step_is_added_to_every_velocity_and_an_unsure_turn_with_the_distance():
    frame = frame_with(np.diag([0.01, 0.02, 0.001]) ** 2)
    far = with_pose_covariance({1: estimate([100.0, 90.0])}, frame, 0.1)[1]
    np.testing.assert_allclose(far.covariance, 0.01 * np.eye(2) + np.diag([0.1**2 + 0.4**2, 0.2**2]))
    near = with_pose_covariance({1: estimate([101.0, 50.0])}, frame, 0.1)[1]
    np.testing.assert_allclose(near.covariance, 0.01 * np.eye(2) + np.diag([0.1**2, 0.2**2 + 0.01**2]))
    np.testing.assert_array_equal(far.velocity, np.zeros(2))


@pytest.mark.parametrize(
    ("given", "covariance", "dt"),
    [
        (estimate([1.0, 2.0], frame_name="sensor"), UNKNOWN_STEP, 0.1),
        (estimate([1.0, 2.0], status=EstimateStatus.NEW_TRACK), UNKNOWN_STEP, 0.1),
        (estimate([np.nan, np.nan], status=EstimateStatus.NO_POINTS), UNKNOWN_STEP, 0.1),
        (estimate([1.0, 2.0]), None, 0.1),
        (estimate([1.0, 2.0]), UNKNOWN_STEP, None),
    ],
)
def test_where_nothing_is_claimed_or_nothing_is_in_the_world_nothing_is_added(given, covariance, dt):
    assert with_pose_covariance({1: given}, frame_with(covariance), dt)[1] is given
