"""Truth: velocities from labels, smoothed labels and exact poses; parked objects stand still."""

import numpy as np
import pytest

from evaluation.truth import is_parked, true_velocities
from registration import se3
from tracker.errors import MissingDataError
from tracker.kitti.truth import ExactPose
from tracker.types import Box, SegmentedFrame

DT = 0.1


def ego_pose(k):
    """Drive 1 m a frame along x while turning slowly."""
    return se3.from_yaw(0.02 * k, np.array([1.0 * k, 0.0, 1.7]))


def frames_of(centers_world, with_poses=True, skip=(), track_id=3):
    """Put boxes at world centres and look at them from the driving ego."""
    frames = []
    for k, center in enumerate(centers_world):
        T = ego_pose(k)
        center_lidar = se3.transform(se3.invert(T), np.asarray(center, dtype=np.float64)[None])[0]
        box = Box(track_id, "Car", se3.from_yaw(0.0, center_lidar), np.array([4.0, 1.8, 1.5]))
        boxes = {} if k in skip else {track_id: box}
        frames.append(SegmentedFrame(k, k * DT, {}, boxes, T if with_poses else None))
    return frames


def straight(n, speed=5.0, jitter=0.0, seed=0):
    """Drive along x past the ego; labels jitter on every axis."""
    rng = np.random.default_rng(seed)
    line = np.column_stack([20.0 + speed * DT * np.arange(n), np.full(n, 3.0), np.full(n, 0.8)])
    return line + jitter * rng.normal(size=line.shape)


def test_label_truth_is_the_difference_of_world_centres_over_real_time():
    truth = true_velocities(frames_of(straight(5)), "world", "labels")
    assert sorted(truth) == [(3, 1), (3, 2), (3, 3), (3, 4)]
    for step in truth.values():
        np.testing.assert_allclose(step.velocity, [5.0, 0.0], atol=1e-9)


def test_sensor_truth_is_the_difference_of_the_centres_each_in_its_own_axes():
    frames = frames_of(straight(3))
    truth = true_velocities(frames, "sensor", "labels")
    expected = (frames[1].boxes[3].center_lidar - frames[0].boxes[3].center_lidar)[:2] / DT
    np.testing.assert_allclose(truth[3, 1].velocity, expected)


def test_a_straight_track_passes_the_smoothing_unchanged():
    truth = true_velocities(frames_of(straight(20)), "world", "smoothed")
    for step in truth.values():
        np.testing.assert_allclose(step.velocity, [5.0, 0.0], atol=1e-9)
        assert not step.is_parked


def test_smoothing_removes_most_of_the_labels_jitter():
    frames = frames_of(straight(60, jitter=0.03))

    def rms(truth):
        return np.sqrt(np.mean([np.sum((t.velocity - [5.0, 0.0]) ** 2) for t in truth.values()]))

    raw, smoothed = (rms(true_velocities(frames, "world", kind)) for kind in ("labels", "smoothed"))
    assert raw == pytest.approx(0.6, rel=0.3)  # sqrt(2) axes * sqrt(2) * 0.03 / 0.1
    assert smoothed < 0.3 * raw


def test_a_parked_object_has_exactly_no_velocity_in_the_world_and_the_egos_seen_from_it():
    frames = frames_of(straight(40, speed=0.0, jitter=0.04))
    world = true_velocities(frames, "world", "smoothed")
    assert all(step.is_parked and not step.velocity.any() for step in world.values())
    center = np.mean([se3.transform(f.T_world_lidar, f.boxes[3].center_lidar[None])[0] for f in frames], axis=0)
    seen = [se3.transform(se3.invert(ego_pose(k)), center[None])[0] for k in (9, 10)]
    sensor = true_velocities(frames, "sensor", "smoothed")
    np.testing.assert_allclose(sensor[3, 10].velocity, (seen[1] - seen[0])[:2] / DT, atol=1e-9)


def test_raw_labels_of_a_parked_object_keep_their_jitter():
    truth = true_velocities(frames_of(straight(40, speed=0.0, jitter=0.04)), "world", "labels")
    assert all(step.is_parked for step in truth.values())
    assert np.mean([np.hypot(*step.velocity) for step in truth.values()]) > 0.3


@pytest.mark.parametrize(
    ("speed", "n", "jitter", "parked"),
    [
        (0.0, 100, 0.05, True),  # a parked car
        (0.05, 60, 0.04, True),  # poses drift a little
        (1.4, 6, 0.02, False),  # a pedestrian seen for half a second: 0.7 m, but steadily
        (0.6, 12, 0.03, False),  # a car that creeps out of a gate
        (5.0, 3, 0.02, False),  # a passing car seen for three frames
        (0.0, 3, 0.05, True),  # a parked one seen as briefly
        (15.0, 2, 0.02, False),  # two frames are enough to tell driving from standing
        (5.0, 2, 0.02, False),
        (0.0, 2, 0.05, True),
    ],
)
def test_parked_is_told_from_slow(speed, n, jitter, parked):
    centers = straight(n, speed=speed, jitter=jitter)
    assert is_parked(centers, DT * np.arange(n)) is parked


def test_a_gap_in_a_track_has_no_velocity_across_it_and_is_not_smoothed_over():
    frames = frames_of(straight(12), skip=(5,))
    truth = true_velocities(frames, "world", "smoothed")
    assert (3, 5) not in truth
    assert (3, 6) not in truth
    np.testing.assert_allclose(truth[3, 7].velocity, [5.0, 0.0], atol=1e-9)


def test_bins_go_by_the_horizontal_range_of_the_box_at_the_steps_end():
    frames = frames_of(straight(3))
    truth = true_velocities(frames, "world", "labels")
    assert truth[3, 2].range_m == pytest.approx(np.hypot(*frames[2].boxes[3].center_lidar[:2]))


def test_two_looks_at_nearly_the_same_time_have_no_velocity():
    """Right behind the sensor, with every object's points at the instant of its look."""
    frames = frames_of(straight(5))
    for k, frame in enumerate(frames):
        frame.seen_at[3] = k * DT + (0.049 if k < 3 else -0.049)
    truth = true_velocities(frames, "world", "labels")
    assert sorted(truth) == [(3, 1), (3, 2), (3, 4)]


def test_exact_truth_takes_the_simulators_centres_not_the_labels():
    centers = straight(4)
    frames = frames_of(centers + [0.3, 0.0, 0.0])  # labels that are off
    exact = {
        (3, k): ExactPose(c, se3.transform(se3.invert(ego_pose(k)), c[None])[0]) for k, c in enumerate(straight(4, 6.0))
    }
    truth = true_velocities(frames, "world", "exact", exact)
    np.testing.assert_allclose(truth[3, 2].velocity, [6.0, 0.0], atol=1e-9)
    del exact[3, 1]
    with pytest.raises(MissingDataError, match="lacks track 3 in frame 1"):
        true_velocities(frames, "world", "exact", exact)


def test_without_poses_there_is_relative_truth_only_and_nothing_counts_as_parked():
    frames = frames_of(straight(12, speed=0.0), with_poses=False)
    with pytest.raises(MissingDataError, match="need the ego's poses"):
        true_velocities(frames, "world", "smoothed")
    assert not any(step.is_parked for step in true_velocities(frames, "sensor", "smoothed").values())


def test_exact_truth_of_a_real_sequence_is_an_error():
    with pytest.raises(MissingDataError, match="simulated sequences only"):
        true_velocities(frames_of(straight(3)), "world", "exact")
