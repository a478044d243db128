"""The tracking benchmark's folder: which sequences there are, and what each of their frames holds."""

import numpy as np
import pytest

from tests.kitti_folder import (
    calib_text,
    oxts_row,
    pose_rows,
    row_of,
    scan,
    seconds,
    stamp,
    things,
    true_pose,
    turn,
    write,
    write_tracking,
)
from tracker.errors import DataError, InputError, MissingDataError
from tracker.kitti import open_sequence, sequence_names
from tracker.store import cut_sequence
from tracker.tracklets import cut, tracklets


@pytest.fixture
def training(tmp_path):
    return write_tracking(tmp_path)


def opened(training, **settings):
    return open_sequence(training.parent, "0000", **settings)


# --- root


def test_sequences_are_found_from_the_benchmarks_root_and_from_its_training_folder(training):
    write_tracking(training.parent, name="0013", n_frames=2)
    assert sequence_names(training.parent) == sequence_names(training) == ["0000", "0013"]
    assert len(open_sequence(training, "0013")) == 2


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(MissingDataError, match=r"nowhere: no such folder"):
        sequence_names(tmp_path / "nowhere")


@pytest.mark.parametrize(("file", "got"), [(None, "an empty folder"), ("image_02/0000.png", "image_02")])
def test_a_folder_of_something_else_is_refused_with_what_was_expected_and_found(tmp_path, file, got):
    if file is not None:
        write(tmp_path / file, "")
    with pytest.raises(MissingDataError, match=rf"expected a KITTI tracking folder .* or a raw drive .*, got {got}$"):
        sequence_names(tmp_path)


def test_a_sequence_that_is_not_there_is_refused_with_a_suggestion(training):
    with pytest.raises(InputError, match=r"no sequence '000'\. Did you mean '0000'\?"):
        open_sequence(training.parent, "000")


# --- frames


def test_each_frame_holds_its_own_boxes_points_and_time(training):
    sequence = opened(training)
    assert (len(sequence), sequence.missing_scans()) == (5, [])
    for k, frame in enumerate(sequence.frames()):
        assert frame.index == k
        np.testing.assert_array_equal(frame.points_lidar, scan(k)[:, :3])
        assert [box.track_id for box in frame.boxes] == [thing.track_id for thing in things(k)]
        for box, thing in zip(frame.boxes, things(k), strict=True):
            assert (box.class_name, box.occlusion) == (thing.class_name, thing.track_id % 3)
            np.testing.assert_allclose(box.center_lidar, thing.center, atol=1e-8)
            np.testing.assert_allclose(box.size, thing.size)
            assert box.yaw_lidar == pytest.approx(thing.yaw, abs=1e-8)


def test_tracks_are_ranked_in_order_of_first_appearance(training):
    assert opened(training).reindexed == {0: 0, 3: 1, 1: 2}


def test_a_part_of_the_frames_can_be_read(training):
    sequence = opened(training)
    assert [frame.index for frame in sequence.frames(1, 3)] == [1, 2]
    assert [frame.index for frame in sequence.frames(3, 99)] == [3, 4]


def test_frames_are_read_one_at_a_time(training):
    frames = opened(training).frames()
    next(frames)
    write(training / "velodyne" / "0000" / "000001.bin", b"cut off")
    with pytest.raises(DataError, match=r"000001\.bin: expected a multiple of 16 bytes"):
        next(frames)


def test_a_frame_can_be_read_without_its_points(training):
    write(training / "velodyne" / "0000" / "000001.bin", b"cut off")
    frame = opened(training).frame(1, with_points=False)
    assert frame.points_lidar is None
    assert len(frame.boxes) == 2


@pytest.mark.parametrize("index", [-1, 5])
def test_a_frame_that_is_not_there_is_refused(training, index):
    with pytest.raises(IndexError, match=rf"sequence 0000 has frames 0 to 4, got {index}"):
        opened(training).frame(index)


def test_frames_count_to_the_last_scan_or_label_whichever_is_later(training):
    write(training / "velodyne" / "0000" / "000006.bin", scan(0).tobytes())
    sequence = opened(training)
    assert (len(sequence), sequence.missing_scans()) == (7, [5])
    assert sequence.frame(6).boxes == ()
    (training / "velodyne" / "0000" / "000006.bin").unlink()
    (training / "velodyne" / "0000" / "000004.bin").unlink()
    assert (len(opened(training)), opened(training).missing_scans()) == (5, [4])


def test_a_sequence_without_labels_of_objects_has_frames_without_boxes(training):
    write(training / "label_02" / "0000.txt", "")
    assert [frame.boxes for frame in opened(training).frames()] == [()] * 5


# --- missing scans


def test_a_missing_scan_is_reported_and_its_frame_has_boxes_and_no_points(tmp_path):
    training = write_tracking(tmp_path, n_frames=6, missing=(2, 3))
    sequence = opened(training)
    assert (len(sequence), sequence.missing_scans()) == (6, [2, 3])
    frame = sequence.frame(2)
    assert frame.points_lidar is None
    assert [box.track_id for box in frame.boxes] == [1, 0, 3]
    np.testing.assert_array_equal(sequence.frame(4).points_lidar, scan(4)[:, :3])


def test_a_missing_scan_gives_no_segments_and_splits_the_tracklets_there(tmp_path):
    training = write_tracking(tmp_path, n_frames=6, missing=(2, 3))
    segmented = [cut(frame) for frame in opened(training).frames()]
    assert [len(frame.segments) for frame in segmented] == [2, 2, 0, 0, 3, 3]
    assert [len(frame.boxes) for frame in segmented] == [2, 2, 3, 3, 3, 3]
    found = [[s.frame for s in tracklet.segments] for tracklet in tracklets(segmented, ["Car"])]
    assert found == [[0, 1], [4, 5]]


def test_a_missing_scan_stays_reported_in_the_segment_store(tmp_path):
    training = write_tracking(tmp_path, n_frames=6, missing=(2, 3))
    store = cut_sequence(opened(training), tmp_path / "store")
    assert store.manifest["missing_scans"] == [2, 3]
    assert [len(frame.segments) for frame in store.frames()] == [2, 2, 0, 0, 3, 3]


# --- time


def test_stamps_beside_the_scans_are_taken_and_named(training):
    write(training / "times" / "0000.txt", "".join(f"{stamp(k)}\n" for k in range(7)))
    sequence = opened(training)
    assert sequence.clock == "times/0000.txt"
    np.testing.assert_allclose(sequence.timestamps, [seconds(k) for k in range(5)], rtol=0, atol=1e-9)
    assert sequence.frame(3).timestamp == sequence.timestamps[3]


def test_without_stamps_the_nominal_rate_is_taken_and_named(training):
    sequence = opened(training)
    assert sequence.clock == "nominal 10 Hz"
    np.testing.assert_allclose(sequence.timestamps, [0.0, 0.1, 0.2, 0.3, 0.4])


def test_the_nominal_rate_can_be_had_in_spite_of_stamps(training):
    write(training / "times" / "0000.txt", "noon\n")
    assert opened(training, clock="nominal").clock == "nominal 10 Hz"


def test_too_few_stamps_are_refused(training):
    path = write(training / "times" / "0000.txt", "".join(f"{stamp(k)}\n" for k in range(4)))
    with pytest.raises(DataError, match=rf"{path}: expected a timestamp for each of 5 frames, got 4"):
        opened(training)


def test_an_unknown_clock_is_refused(training):
    with pytest.raises(InputError, match="unknown clock 'atomic'; expected one of auto, nominal"):
        opened(training, clock="atomic")


# --- poses


def test_without_poses_and_gps_nothing_is_known_of_the_egos_motion(training):
    sequence = opened(training)
    assert (sequence.ego, sequence.poses, sequence.frame(0).T_world_lidar) == ("none", None, None)


def test_gps_and_imu_records_give_the_lidars_poses(training):
    write(training / "oxts" / "0000.txt", "".join(oxts_row(k) for k in range(5)))
    sequence = opened(training)
    assert sequence.ego == "oxts"
    np.testing.assert_allclose(sequence.poses, [true_pose(k) for k in range(5)], atol=1e-6)
    np.testing.assert_array_equal(sequence.frame(4).T_world_lidar, sequence.poses[4])


def test_a_pose_file_is_preferred_to_gps_and_imu_records(training):
    write(training / "oxts" / "0000.txt", "".join(oxts_row(k) for k in range(5)))
    write(training / "poses" / "0000.txt", pose_rows(6))
    sequence = opened(training)
    assert (sequence.ego, len(sequence.poses)) == ("poses", 5)
    np.testing.assert_allclose(sequence.poses[4][:3, :3], turn(2, 0.4), atol=1e-12)
    assert [path.parent.name for path in sequence.sources] == ["label_02", "calib", "poses"]


@pytest.mark.parametrize(("kind", "text"), [("poses", pose_rows(4)), ("oxts", "".join(oxts_row(k) for k in range(4)))])
def test_fewer_poses_than_frames_are_refused(training, kind, text):
    path = write(training / kind / "0000.txt", text)
    with pytest.raises(DataError, match=rf"{path}: expected a pose for each of 5 frames, got 4"):
        opened(training)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (row_of(2 * np.eye(4)[:3]), "expected a rotation in the first three columns"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0", "expected finite numbers"),
    ],
)
def test_a_pose_that_is_none_is_refused_with_file_and_line(training, row, message):
    path = write(training / "poses" / "0000.txt", f"{pose_rows(2)}{row}\n{pose_rows(2)}")
    with pytest.raises(DataError, match=rf"{path}:3: {message}"):
        opened(training)


def test_gps_and_imu_records_without_the_imus_place_are_refused(training):
    write(training / "oxts" / "0000.txt", "".join(oxts_row(k) for k in range(5)))
    write(training / "calib" / "0000.txt", calib_text(with_imu=False))
    with pytest.raises(MissingDataError, match=r"oxts/0000\.txt needs the IMU's place: no Tr_imu_to_velo in calib"):
        opened(training)


def test_a_missing_calibration_is_named(training):
    (training / "calib" / "0000.txt").unlink()
    with pytest.raises(MissingDataError, match=r"calib/0000\.txt: no such calibration file"):
        opened(training)
