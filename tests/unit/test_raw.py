"""Raw drives: tracklets, and scans, stamps and GPS/IMU records that belong together by number."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.kitti_folder import (
    DAY,
    DRIVE,
    oxts_row,
    scan,
    seconds,
    stamp,
    things,
    tracklet_xml,
    true_pose,
    write,
    write_raw,
)
from tracker.errors import DataError, InputError, MissingDataError
from tracker.kitti import open_sequence, sequence_names
from tracker.kitti.raw import read_tracklets

ID_IN_FILE = {"Car": 0, "Pedestrian": 1, "Van": 2}  # a tracklet's place in the file
MINUTE = 60.0  # between the scans' stamps and the GPS/IMU's of the tiny drive


def open_drive(root, **settings):
    return open_sequence(root / DAY, DRIVE, **settings)


def edited(tmp_path, old, new):
    """Write tracklets with one edit."""
    text = tracklet_xml(4)
    assert old in text
    return write(tmp_path / "tracklet_labels.xml", text.replace(old, new, 1))


# --- tracklets


def test_tracklets_give_each_frame_the_boxes_that_stand_in_it(tmp_path):
    frames = read_tracklets(write(tmp_path / "tracklet_labels.xml", tracklet_xml(5)))
    assert sorted(frames) == [0, 1, 2, 3, 4]
    for k, boxes in frames.items():
        expected = sorted(things(k), key=lambda thing: ID_IN_FILE[thing.class_name])
        assert [(box.track_id, box.class_name) for box in boxes] == [
            (ID_IN_FILE[thing.class_name], thing.class_name) for thing in expected
        ]
        for box, thing in zip(boxes, expected, strict=True):
            np.testing.assert_allclose(box.center_lidar, thing.center, atol=1e-12)  # the file has the bottom
            np.testing.assert_array_equal(box.size, thing.size)
            assert box.yaw_lidar == pytest.approx(thing.yaw)
            assert (box.truncation, box.occlusion) == (0, thing.track_id % 3)


def test_a_file_may_have_tracklets_as_its_root(tmp_path):
    text = re.sub(r"</?boost_serialization[^>]*>|<!DOCTYPE[^>]*>", "", tracklet_xml(4))
    assert len(read_tracklets(write(tmp_path / "tracklet_labels.xml", text))[2]) == 3


def test_a_pose_without_occlusion_is_of_unknown_occlusion(tmp_path):
    box = read_tracklets(edited(tmp_path, "<occlusion>0</occlusion>", ""))[0][0]
    assert (box.occlusion, box.truncation) == (-1, 0)


def test_xml_that_ends_too_early_is_refused_with_file_and_line(tmp_path):
    lines = tracklet_xml(4).splitlines()
    path = write(tmp_path / "tracklet_labels.xml", "\n".join(lines[:20]))
    with pytest.raises(DataError, match=r"tracklet_labels\.xml:20: expected XML, got no element found"):
        read_tracklets(path)


def test_xml_with_crossed_tags_is_refused_with_file_and_line(tmp_path):
    with pytest.raises(DataError, match=r"tracklet_labels\.xml:9: expected XML, got mismatched tag"):
        read_tracklets(edited(tmp_path, "</h>", "</w>"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<tx>10.0</tx>", "", r"tracklet 0: expected a number in <tx>, got None"),
        ("<tx>10.0</tx>", "<tx>ten</tx>", r"tracklet 0: expected a number in <tx>, got 'ten'"),
        ("<rz>0.0</rz>", "<rz>nan</rz>", r"tracklet 0: expected a finite number in <rz>, got 'nan'"),
        ("<h>1.75</h>", "<h></h>", r"tracklet 1: expected a number in <h>, got ''"),
        ("<l>5.0</l>", "<l>-5.0</l>", r"tracklet 2: expected objectType, positive h w l"),
        ("<objectType>Van</objectType>", "", r"tracklet 2: expected objectType, positive h w l"),
        ("<first_frame>0<", "<first_frame>-1<", r"tracklet 0: expected objectType, .* first_frame >= 0"),
        ("<first_frame>0<", "<first_frame>1.5<", r"tracklet 0: expected an integer in <first_frame>, got '1\.5'"),
        ("<truncation>0<", "<truncation>none<", r"tracklet 0: expected an integer in <truncation>, got 'none'"),
        ("<occlusion>1<", "<occlusion><", r"tracklet 2: expected an integer in <occlusion>, got ''"),
    ],
)
def test_a_tracklet_without_a_proper_field_is_refused_by_name(tmp_path, old, new, message):
    with pytest.raises(DataError, match=rf"tracklet_labels\.xml: {message}"):
        read_tracklets(edited(tmp_path, old, new))


def test_a_drive_without_tracklets_says_what_is_missing(tmp_path):
    drive = write_raw(tmp_path)
    (drive / "tracklet_labels.xml").unlink()
    with pytest.raises(MissingDataError, match=r"tracklet_labels\.xml: no such file; a raw drive's objects are in"):
        open_sequence(drive, DRIVE)


# --- drives


def test_a_drive_is_found_from_its_day_from_itself_and_from_inside(tmp_path, monkeypatch):
    drive = write_raw(tmp_path)
    monkeypatch.chdir(drive)
    for root in (tmp_path / DAY, drive, Path()):
        assert sequence_names(root) == [DRIVE]
        sequence = open_sequence(root, DRIVE)
        assert (sequence.name, len(sequence), sequence.ego) == (DRIVE, 5, "oxts")


def test_a_day_lists_its_drives_with_tracklets_and_no_other(tmp_path):
    write_raw(tmp_path)
    for name in ("2011_09_26_drive_0001_sync", "2011_09_26_drive_0002_sync"):
        write(tmp_path / DAY / name / "velodyne_points" / "data" / "0000000000.bin", b"")
    write(tmp_path / DAY / "2011_09_26_drive_0001_sync" / "tracklet_labels.xml", tracklet_xml(2))
    assert sequence_names(tmp_path / DAY) == ["2011_09_26_drive_0001_sync", DRIVE]


def test_a_drive_that_is_not_there_is_refused_with_a_suggestion(tmp_path):
    write_raw(tmp_path)
    with pytest.raises(InputError, match=rf"no sequence '2011_09_26_drive_0008_sync'\. Did you mean '{DRIVE}'"):
        open_sequence(tmp_path / DAY, "2011_09_26_drive_0008_sync")


def test_a_whole_drive_has_scans_boxes_stamps_and_poses(tmp_path):
    write_raw(tmp_path)
    sequence = open_drive(tmp_path)
    assert (len(sequence), sequence.missing_scans(), sequence.clock) == (5, [], "velodyne_points/timestamps.txt")
    assert sequence.reindexed == {0: 0, 1: 1, 2: 2}
    assert sequence.truth_path is None
    for k, frame in enumerate(sequence.frames()):
        np.testing.assert_array_equal(frame.points_lidar, scan(k)[:, :3])
        np.testing.assert_allclose(frame.T_world_lidar, true_pose(k), atol=1e-6)
        assert frame.timestamp == pytest.approx(seconds(k), abs=1e-9)
        assert len(frame.boxes) == len(things(k))


def test_a_drive_that_lacks_scans_in_the_middle_keeps_all_else_at_its_number(tmp_path):
    write_raw(tmp_path, n_frames=8, missing=(3, 4))  # as 0009 of 2011-09-26 lacks 177 to 180
    sequence = open_drive(tmp_path)
    assert (len(sequence), sequence.missing_scans()) == (8, [3, 4])
    # The scans' stamps have blank lines there: the GPS/IMU has one a frame.
    assert sequence.clock == "oxts/timestamps.txt"
    for k, frame in enumerate(sequence.frames()):
        if k in (3, 4):
            assert frame.points_lidar is None
        else:
            np.testing.assert_array_equal(frame.points_lidar, scan(k)[:, :3])
        assert frame.index == k
        assert frame.timestamp == pytest.approx(seconds(k) + MINUTE, abs=1e-9)
        np.testing.assert_allclose(frame.T_world_lidar, true_pose(k), atol=1e-6)
        assert {box.class_name for box in frame.boxes} == {thing.class_name for thing in things(k)}


def test_stamps_that_leave_missing_scans_out_without_a_blank_line_are_not_taken_either(tmp_path):
    drive = write_raw(tmp_path, n_frames=6, missing=(3,))
    stamps = drive / "velodyne_points" / "timestamps.txt"
    write(stamps, stamps.read_text().replace("\n\n", "\n"))
    assert open_drive(tmp_path).clock == "oxts/timestamps.txt"


def test_blank_stamps_with_no_others_to_take_are_refused_with_file_and_line(tmp_path):
    drive = write_raw(tmp_path, n_frames=6, missing=(3,))
    (drive / "oxts" / "timestamps.txt").unlink()
    with pytest.raises(DataError, match=r"velodyne_points.timestamps\.txt:4: expected a timestamp"):
        open_drive(tmp_path)


def test_a_drive_without_stamps_runs_at_the_nominal_rate_and_says_so(tmp_path):
    drive = write_raw(tmp_path)
    for name in ("velodyne_points", "oxts"):
        (drive / name / "timestamps.txt").unlink()
    sequence = open_drive(tmp_path)
    assert sequence.clock == "nominal 10 Hz"
    np.testing.assert_allclose(sequence.timestamps, [0.0, 0.1, 0.2, 0.3, 0.4])


def test_the_nominal_clock_needs_no_stamps_to_be_sound(tmp_path):
    drive = write_raw(tmp_path)
    write(drive / "velodyne_points" / "timestamps.txt", f"{stamp(1)}\n{stamp(0)}\n")
    assert open_drive(tmp_path, clock="nominal").clock == "nominal 10 Hz"


def test_scans_beyond_the_last_tracklet_are_frames_too(tmp_path):
    drive = write_raw(tmp_path, n_frames=5)
    write(drive / "tracklet_labels.xml", tracklet_xml(2))
    sequence = open_drive(tmp_path)
    assert len(sequence) == 5
    assert sequence.frame(4).boxes == ()
    assert len(sequence.frame(4).points_lidar) == len(scan(4))


# --- GPS/IMU


def test_a_drive_without_gps_and_imu_has_no_poses(tmp_path):
    drive = write_raw(tmp_path)
    for path in (drive / "oxts" / "data").iterdir():
        path.unlink()
    sequence = open_drive(tmp_path)
    assert (sequence.ego, sequence.poses) == ("none", None)
    assert sequence.frame(1).T_world_lidar is None


def test_records_without_the_imus_place_are_refused(tmp_path):
    write_raw(tmp_path)
    (tmp_path / DAY / "calib_imu_to_velo.txt").unlink()
    with pytest.raises(MissingDataError, match=r"oxts needs the IMU's place: no .*calib_imu_to_velo\.txt"):
        open_drive(tmp_path)


@pytest.mark.parametrize("lost", [0, 2, 4])
def test_a_lost_record_is_named_and_does_not_move_the_others_up(tmp_path, lost):
    drive = write_raw(tmp_path)
    (drive / "oxts" / "data" / f"{lost:010d}.txt").unlink()
    write(drive / "oxts" / "data" / f"{5:010d}.txt", oxts_row(5))  # as many records as frames all the same
    with pytest.raises(DataError, match=rf"{lost:010d}\.txt: expected a record for each of 5 frames, got no such file"):
        open_drive(tmp_path)


def test_a_malformed_record_is_refused_with_file_and_line(tmp_path):
    drive = write_raw(tmp_path)
    write(drive / "oxts" / "data" / f"{3:010d}.txt", "49.0 8.4\n")
    with pytest.raises(DataError, match=r"0000000003\.txt:1: expected 30 columns, got 2"):
        open_drive(tmp_path)


def stamped_drive(tmp_path, **settings):
    """Write a drive whose GPS/IMU records are stamped 4 ms after its scans, as KITTI's are by a few."""
    drive = write_raw(tmp_path, **settings)
    in_minute = [seconds(k) - seconds(0) + 25.004 for k in range(settings["n_frames"])]
    write(drive / "oxts" / "timestamps.txt", "".join(f"2011-09-26 13:02:{t:012.9f}\n" for t in in_minute))
    return drive


def test_records_stamped_like_the_scans_give_poses_at_the_scans_own_times(tmp_path):
    stamped_drive(tmp_path, n_frames=7)
    sequence = open_drive(tmp_path)
    assert (sequence.ego, sequence.flagged) == ("oxts at the scans' times", ())
    for k in range(1, 7):  # record k is 4 ms late: 4 ms of the way back to record k - 1
        step = seconds(k) - seconds(k - 1)
        expected = true_pose(k)[:3, 3] + 0.004 / step * (true_pose(k - 1) - true_pose(k))[:3, 3]
        np.testing.assert_allclose(sequence.poses[k][:3, 3], expected, atol=1e-5)
    assert any(path.parent.name == "oxts" and path.name == "timestamps.txt" for path in sequence.sources)


def test_a_gap_in_stamped_records_is_bridged_and_flagged_and_changes_nothing_else(tmp_path):
    drive = stamped_drive(tmp_path / "whole", n_frames=12)
    whole = open_drive(tmp_path / "whole")
    stamped_drive(tmp_path / "holed", n_frames=12)
    for lost in (5, 6, 7):
        (tmp_path / "holed" / drive.relative_to(tmp_path / "whole") / "oxts" / "data" / f"{lost:010d}.txt").unlink()
    holed = open_drive(tmp_path / "holed")
    assert holed.flagged == (5, 6, 7, 8)  # record 8 is 4 ms after scan 8
    others = [k for k in range(12) if k not in holed.flagged]
    np.testing.assert_array_equal(holed.poses[others], whole.poses[others])
    assert np.isfinite(holed.poses).all()
    assert holed.step_covariance(4) is None
    assert np.sqrt(holed.step_covariance(6)[0, 0]) > 0.5  # [m]
    assert holed.frame(9).ego_step_covariance is not None  # from a guess
    assert holed.frame(10).ego_step_covariance is None


def test_poses_that_a_drive_does_not_have_are_refused_by_name(tmp_path):
    drive = write_raw(tmp_path)
    with pytest.raises(MissingDataError, match="a raw drive has no poses file, only oxts"):
        open_drive(tmp_path, recorded="poses")
    assert open_drive(tmp_path, recorded="none").poses is None
    for path in (drive / "oxts" / "data").iterdir():
        path.unlink()
    with pytest.raises(MissingDataError, match=r"no records; drive .* has no oxts"):
        open_drive(tmp_path, recorded="oxts")


def test_an_unknown_kind_of_records_is_refused(tmp_path):
    write_raw(tmp_path)
    with pytest.raises(InputError, match="unknown recorded poses 'gps'; expected one of auto, poses, oxts, none"):
        open_drive(tmp_path, recorded="gps")
