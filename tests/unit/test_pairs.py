"""Pairs from KITTI tracklets: consecutive ones, hard ones, their axes and their truth."""

from collections import Counter

import numpy as np
import pytest

from registration import se3
from registration.synthetic.lidar import HDL_64E, BeamModel
from tracker.errors import InputError
from tracker.kitti import open_sequence
from tracker.kitti.splits import in_split, reindex
from tracker.pairs import hard_frames, kitti_pairs, pair_set_names, track_pairs
from tracker.simulation import Recording, create_scene, simulate

# Every other beam, every other azimuth: who is paired with whom is the same.
COARSE = BeamModel("coarse", HDL_64E.elevations[::2], float(np.deg2rad(0.35)))


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    root = tmp_path_factory.mktemp("street")
    simulate(create_scene("street", 1, 3), root / "root", seed=1)
    return open_sequence(root / "root", "0000")


def test_hard_pairs_are_far_apart_and_turned():
    yaws = {0: 0.0, 9: 1.0, 10: 1.0, 11: 0.7, 25: -3.1, 30: 3.1}
    found = list(hard_frames(yaws))
    assert (0, 10) in found  # 57 degrees in 10 frames
    assert (0, 9) not in found  # too near
    assert (0, 11) not in found  # 40 degrees
    assert (25, 30) not in found  # 5 frames, and 0.08 rad across the cut


def test_a_pairs_truth_carries_the_cloud_onto_the_next_one(street, tmp_path):
    pairs = [p for _, p in track_pairs(street, ("Car", "Van"), tmp_path, np.eye(4))]
    near = [p for p in pairs if len(p.source) > 300 and len(p.target) > 300]
    assert len(near) >= 5
    for p in near:
        moved = se3.transform(p.T_target_source, p.source)
        gap = np.abs(moved.mean(axis=0) - p.target.mean(axis=0))
        assert gap.max() < 0.5
        before, after = p.source.mean(axis=0), p.target.mean(axis=0)
        assert np.hypot(*(moved.mean(axis=0) - after)[:2]) < np.hypot(*(before - after)[:2]) + 0.3


def test_named_sets_start_at_the_camera_and_stand_on_one_ground(street, tmp_path):
    in_lidar = [p for _, p in track_pairs(street, ("Car", "Van"), tmp_path, np.eye(4))]
    named = list(kitti_pairs("kitti-tracklets-cars", [street], tmp_path))
    assert len(named) == len(in_lidar)
    for (part, camera), lidar in zip(named, in_lidar, strict=True):
        assert part == "train"
        center = se3.transform(street.T_cam_lidar, lidar.start_position[None])[0]
        assert np.linalg.norm(camera.start_position) == pytest.approx(np.linalg.norm(center))
        assert camera.start_position[2] == pytest.approx(camera.end_position[2], abs=1e-9)
        assert camera.start_position[0] == pytest.approx(center[2])  # forward
        assert camera.extra["frames"][1] == camera.extra["frames"][0] + 1


def test_looks_are_paired_as_a_tracker_compares_them(tmp_path):
    simulate(create_scene("street", 1, 9), tmp_path / "root", seed=1, recording=Recording(COARSE))
    street = open_sequence(tmp_path / "root", "0000")
    found = list(kitti_pairs("kitti-looks-cars", [street], tmp_path))
    assert {p.extra["trackids"][0] % 10 == 5 for part, p in found if part == "val"} == {True}
    pairs = [pair for _, pair in found]
    apart = Counter(p.extra["frames"][1] - p.extra["frames"][0] for p in pairs)
    assert set(apart) == {1, 3, 8}
    assert min(apart.values()) >= 5
    newer = [(p.extra["trackids"][1], p.extra["frames"][1]) for p in pairs]
    assert len(set(newer)) == len(newer)
    for p in pairs:  # in the sensor's axes: what is seen is around the box, as it stands there
        assert np.hypot(*(p.source.mean(axis=0) - p.start_position)[:2]) < 3.0
        assert p.source[:, 2].mean() < 0.5


def test_persons_come_in_only_where_asked_for(street, tmp_path):
    classes = {p.extra["class"] for _, p in kitti_pairs("kitti-tracklets-cars-persons", [street], tmp_path)}
    assert "Pedestrian" in classes
    assert "Pedestrian" not in {p.extra["class"] for _, p in kitti_pairs("kitti-tracklets-cars", [street], tmp_path)}


def test_unknown_names_are_refused(street, tmp_path):
    with pytest.raises(InputError, match="unknown set of pairs 'cars'"):
        next(kitti_pairs("cars", [street], tmp_path))
    with pytest.raises(InputError, match="unknown split rule 'day'"):
        next(kitti_pairs(pair_set_names()[0], [street], tmp_path, rule="day"))


@pytest.mark.real
@pytest.mark.parametrize(("classes", "expected"), [(("Car", "Van"), 2324), (("Car", "Van", "Pedestrian"), 3428)])
def test_hard_pairs_of_the_real_labels_are_as_many_as_the_label_counts_say(real_labels, classes, expected):
    n = 0
    for sequence, labels in real_labels.items():
        ranks = reindex(label.track_id for label in labels)
        headings = {}
        for label in labels:
            if label.class_name in classes and in_split("id-test", sequence, ranks[label.track_id]):
                headings.setdefault(label.track_id, {})[label.frame] = -label.rotation_y
        n += sum(1 for yaws in headings.values() for _ in hard_frames(yaws))
    assert n == expected
