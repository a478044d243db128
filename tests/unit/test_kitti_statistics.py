"""How the statistics of kitti-like sets are derived from labels: on tracks whose answers are known."""

import json

import numpy as np
import pytest
from regmot import kitti_scenery, kitti_statistics

from registration import se3
from registration.synthetic import traffic
from tracker.kitti.splits import HELD_OUT_SEQUENCES
from tracker.types import Box


def box(x, y, yaw=0.0, track_id=0, class_name="Car", occlusion=0):
    return Box(track_id, class_name, se3.from_yaw(yaw, np.array([x, y, -1.0])), np.array([4.0, 2.0, 1.5]), 0, occlusion)


def test_tracks_are_cut_where_frames_are_missing_and_other_classes_are_left_out():
    frames = {frame: [box(10.0 + frame, 0.0), box(5.0, 5.0, 0.0, 1, "Truck")] for frame in (0, 1, 2, 5, 6)}
    runs = kitti_statistics.find_runs(frames, ("Car", "Van"))
    assert [(run.class_name, len(run.yaw)) for run in runs] == [("Car", 3), ("Car", 2)]
    np.testing.assert_allclose(runs[1].center[:, 0], [15.0, 16.0])


def test_smoothing_finds_speed_turn_rate_and_the_size_of_the_jitter():
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(2000)
    yaw = 0.5 + 0.01 * t
    # 3 m/s along its own heading, with 2 cm of white noise along x and y, and 0.01 rad
    way = np.cumsum(0.3 * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1), axis=0)
    noise = np.array([0.02, 0.02, 0.0]) * rng.standard_normal((2000, 3))
    run = kitti_statistics.Run(
        "Car", np.array([4.0, 2.0, 1.5]), way + noise, yaw + 0.01 * rng.standard_normal(2000), np.zeros(2000, np.int64)
    )
    steps = kitti_statistics.smooth(run)
    np.testing.assert_allclose(np.median(steps.velocity, axis=0), [3.0, 0.0], atol=0.02)
    assert np.median(steps.turn_rate) == pytest.approx(0.01, abs=0.01)
    np.testing.assert_allclose(steps.jitter[4:-4].std(axis=0), [0.02, 0.02, 0.0, 0.01], rtol=0.06, atol=1e-9)


def test_a_turning_sensor_is_told_from_a_turning_object():
    """Parked cars seen from a car that turns at -0.3 rad/s swing sideways; cars that turn by themselves do not."""
    n = 200
    still = np.stack([np.full(n, 3.0), np.zeros(n)], axis=1)
    columns = {
        "place": np.stack([np.full(n, 20.0), np.zeros(n)], axis=1),
        "lateral": np.zeros(n),
        "yaw": np.zeros(n),
        "turn_rate": np.full(n, 0.3),
        "lever": np.full(n, 20.0),
        "jitter": np.zeros((n, 4)),
    }
    by_itself = kitti_statistics.Steps(**columns, velocity=still)
    by_ego = kitti_statistics.Steps(**columns, velocity=still + [0.0, 0.3 * 20.0])
    assert kitti_statistics.summarise_motion(by_itself)["ego_turns"][0] == 0.0
    found = kitti_statistics.summarise_motion(by_ego)
    assert found["ego_turns"][0] == 1.0
    np.testing.assert_allclose(found["sideways"][1][0], 0.0, atol=1e-12)
    np.testing.assert_allclose(found["speed"][1][0][2], 3.0)


def test_a_cell_of_few_samples_shows_those_of_the_cell_around_it():
    values = np.concatenate([np.zeros(100), np.ones(5)])
    key = values.astype(np.int64)
    full, scarce = kitti_statistics.quantiles_by(values, [(key, 2)])
    assert np.ptp(full) == 0.0
    np.testing.assert_array_equal(scarce, np.quantile(values, traffic.LEVELS))


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (box(14.5, 0.0), (0.5, -2.0, 0)),  # half a metre before it
        (box(5.5, 0.0), (0.5, -2.0, 1)),
        (box(10.0, 2.25), (-4.0, 0.25, 2)),  # to its left
        (box(10.0, -2.25, np.pi), (-4.0, 0.25, 3)),
    ],
)
def test_free_space_is_measured_along_the_axes_of_the_box(other, expected):
    np.testing.assert_allclose(kitti_scenery.free_space(box(10.0, 0.0), other), expected, atol=1e-9)


def test_a_nearer_box_covers_its_share_of_the_view():
    target = box(20.0, 0.0, 0.5 * np.pi)  # across: 4 m wide
    assert kitti_scenery.cover(target, box(12.0, 0.0)) > 0.5
    assert kitti_scenery.cover(target, box(12.0, 8.0)) == 0.0
    assert kitti_scenery.cover(target, box(28.0, 0.0)) == 0.0  # behind it


def test_only_sequences_that_nothing_else_uses_are_read(tmp_path):
    names = [f"{i:04d}" for i in range(21)]
    for name in names:
        (tmp_path / "label_02").mkdir(exist_ok=True)
        (tmp_path / "label_02" / f"{name}.txt").write_text("")
    found = kitti_statistics.source_names(tmp_path)
    assert len(found) == 11
    assert not {*found} & {*HELD_OUT_SEQUENCES, "0000"}
    assert traffic.source_sequences() == found


def test_the_stored_statistics_hold_summaries_of_the_expected_shapes():
    stored = json.loads(traffic.STATISTICS_PATH.read_text())
    n_far = len(traffic.FAR_EDGES) - 1
    for group, classes in traffic.GROUPS.items():
        found = stored[group]
        assert set(found["classes"]) == set(classes)
        assert np.array(found["place"]).shape == (len(traffic.RANGE_EDGES) - 1, len(traffic.BEARING_EDGES) - 1)
        assert np.array(found["speed"]).shape == (2, traffic.N_KINDS, len(traffic.LANE_EDGES) - 1, len(traffic.LEVELS))
        assert np.array(found["jitter"]).shape == (n_far, 4, len(traffic.LEVELS))
        assert np.array(found["occlusion_later"]).shape == (traffic.MAX_GAP, traffic.N_LEVELS, traffic.N_LEVELS)
        np.testing.assert_allclose(np.sum(found["occlusion"], axis=1), 1.0, atol=1e-3)


@pytest.mark.real
def test_the_stored_statistics_are_of_all_real_labels_of_their_sequences(kitti_root):
    folder = kitti_root / "training"
    assert kitti_statistics.source_names(folder) == traffic.source_sequences()
    words = [
        line.split()[2]
        for name in traffic.source_sequences()
        for line in (folder / "label_02" / f"{name}.txt").read_text().splitlines()
    ]
    for group, classes in traffic.GROUPS.items():
        assert traffic.kitti_traffic(group).n_boxes == sum(words.count(class_name) for class_name in classes)
