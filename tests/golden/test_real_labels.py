"""Real KITTI labels, calibrations and scans, against counts found independently (marker `real`)."""

import csv

import pytest

from tracker.kitti import open_sequence, sequence_names
from tracker.kitti.calib import read_tracking_calib
from tracker.kitti.labels import class_names
from tracker.kitti.splits import count_pairs
from tracker.tracklets import cut

pytestmark = pytest.mark.real

CLASSES = {"Car", "Cyclist", "Misc", "Pedestrian", "Person", "Person_sitting", "Tram", "Truck", "Van"}


@pytest.fixture(scope="module")
def labels_of(kitti_root, real_labels):
    return {name: real_labels[name] for name in sequence_names(kitti_root)}


def test_all_twenty_one_label_files_are_read_but_for_dont_care(labels_of, kitti_root):
    assert list(labels_of) == [f"{k:04d}" for k in range(21)]
    for name, labels in labels_of.items():
        rows = (kitti_root / "training" / "label_02" / f"{name}.txt").read_text().splitlines()
        assert len(labels) == sum(" DontCare " not in row for row in rows)
        assert set(class_names(labels)) <= CLASSES


def test_all_twenty_one_calibrations_are_read_with_the_imus_place(kitti_root):
    for path in sorted((kitti_root / "training" / "calib").glob("*.txt")):
        calibration = read_tracking_calib(path)
        # The Velodyne sits some 30 cm behind and 8 cm above camera 0, the GPS/IMU 81 cm behind the Velodyne.
        assert calibration.T_cam_lidar[:3, 3] == pytest.approx([0.0, -0.08, -0.3], abs=0.04)
        assert calibration.T_lidar_imu[:3, 3] == pytest.approx([-0.81, 0.32, -0.80], abs=0.01)


# Totals, and those within 20 m: the denominators of AlignNet-3D's tables (docs/protocol.md, B5).
@pytest.mark.parametrize(
    ("classes", "totals", "test_within_80m", "test_within_20m"),
    [
        (("Car", "Van"), (20930, 7671, 1362), 1358, 338),
        (("Car", "Van", "Pedestrian"), (28946, 10247, 2073), 2069, 894),
    ],
)
def test_the_split_by_track_id_has_the_published_counts(labels_of, classes, totals, test_within_80m, test_within_20m):
    counts = {count.split: count for count in count_pairs(labels_of, classes)}
    assert tuple(counts[split].total for split in ("id-train", "id-val", "id-test")) == totals
    assert counts["id-test"].within_80m == test_within_80m
    assert counts["id-test"].within_20m == test_within_20m
    assert counts["all"].total == sum(totals)


def test_the_split_by_sequence_parts_the_same_nine_sequences(labels_of):
    counts = {count.split: count for count in count_pairs(labels_of, ("Car", "Van"))}
    assert counts["sequence-test"].total == 6176
    assert counts["sequence-val"].total == 2857
    assert counts["sequence-train"].total == counts["id-train"].total == 20930
    assert 6176 + 2857 == 7671 + 1362
    assert counts["sequence-test"].within_80m == 6166
    assert counts["sequence-test"].within_20m == 1543


def test_the_segments_of_0000_have_the_points_that_the_published_program_found(kitti_root, reference):
    sequence = open_sequence(kitti_root, "0000")
    if len(sequence.missing_scans()) == len(sequence):
        pytest.skip("no scans of sequence 0000")
    with (reference / "cpp_kf_sensor_0000.csv").open() as file:
        expected = {(int(row["track_id"]), int(row["frame"])): int(row["n_points"]) for row in csv.DictReader(file)}
    segmented = (cut(frame) for frame in sequence.frames())
    found = {(i, frame.index): len(s.points_lidar) for frame in segmented for i, s in frame.segments.items()}
    assert len(expected) == 522
    assert {key: found[key] for key in expected} == expected


def test_sequence_0000_is_whole(kitti_root):
    sequence = open_sequence(kitti_root, "0000")
    if len(sequence.missing_scans()) == len(sequence):
        pytest.skip("no scans of sequence 0000")
    assert (len(sequence), sequence.missing_scans()) == (154, [])
