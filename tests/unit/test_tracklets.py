"""From frames to segments, and from segments to tracklets without gaps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from registration import se3
from tests.kitti_folder import scan, things
from tracker.estimators.contract import look
from tracker.tracklets import cut, of_classes, segment_of, tracklets
from tracker.types import Box, Frame, Segment, SegmentedFrame


def frame(index, with_scan=True):
    """Give a frame of the tiny folder without reading any file."""
    boxes = tuple(
        Box(t.track_id, t.class_name, se3.from_yaw(t.yaw, np.array(t.center)), np.array(t.size)) for t in things(index)
    )
    points = scan(index)[:, :3].astype(float) if with_scan else None
    return Frame(index, 0.1 * index, boxes, points, se3.from_yaw(0.0, np.array([float(index), 0.0, 0.0])))


def segmented(index, *tracks):
    """Give a frame in which these tracks (id, class) have a segment."""
    segments = {i: Segment(i, name, index, 0.1 * index, np.zeros((0, 3)), -1.7) for i, name in tracks}
    return SegmentedFrame(index, 0.1 * index, segments, {}, None)


def spans(frames, classes=("Car",)):
    return [(t.track_id, [s.frame for s in t.segments]) for t in tracklets(frames, classes)]


CAR, VAN = (1, "Car"), (2, "Van")


# --- cut


def test_each_box_gets_the_points_in_it_and_the_height_of_its_bottom():
    cut_frame = cut(frame(2))
    assert (cut_frame.index, cut_frame.timestamp) == (2, 0.2)
    np.testing.assert_array_equal(cut_frame.T_world_lidar[:3, 3], [2.0, 0.0, 0.0])
    assert list(cut_frame.segments) == [thing.track_id for thing in things(2)]
    for thing in things(2):
        segment = cut_frame.segments[thing.track_id]
        assert (segment.track_id, segment.class_name) == (thing.track_id, thing.class_name)
        assert (segment.frame, segment.timestamp) == (2, 0.2)
        np.testing.assert_allclose(segment.points_lidar, thing.points(), atol=1e-6)  # float32 in the scan
        assert segment.ground_z_lidar == pytest.approx(thing.center[2] - thing.size[2] / 2)


def test_a_box_without_points_gets_an_empty_segment():
    segment = cut(frame(3)).segments[1]
    assert segment.points_lidar.shape == (0, 3)


def test_a_frame_without_a_scan_has_boxes_and_no_segments():
    cut_frame = cut(frame(2, with_scan=False))
    assert cut_frame.segments == {}
    assert list(cut_frame.boxes) == [1, 0, 3]


def test_segments_of_some_classes_are_kept():
    assert list(of_classes(cut(frame(2)).segments, ["Car", "Van"])) == [1, 0]


# --- tracklets


def test_consecutive_frames_make_one_tracklet_with_the_poses_beside_it():
    (tracklet,) = tracklets([cut(frame(k)) for k in range(4)], ["Car"])
    assert (tracklet.track_id, tracklet.class_name) == (0, "Car")
    assert [segment.frame for segment in tracklet.segments] == [0, 1, 2, 3]
    assert [len(segment.points_lidar) for segment in tracklet.segments] == [9, 10, 11, 12]
    assert [T[0, 3] for T in tracklet.T_world_lidar] == [0.0, 1.0, 2.0, 3.0]


def test_a_frame_in_which_the_box_is_empty_is_no_gap():
    assert spans([cut(frame(k)) for k in range(5)], ["Van"]) == [(1, [2, 3, 4])]


def test_a_frame_without_the_object_ends_its_tracklet():
    frames = [segmented(0, CAR), segmented(1, CAR), segmented(2), segmented(3, CAR)]
    assert spans(frames) == [(1, [0, 1]), (1, [3])]


def test_a_frame_that_is_left_out_ends_all_tracklets():
    frames = [segmented(0, CAR, VAN), segmented(1, CAR, VAN), segmented(3, CAR, VAN)]
    assert spans(frames, ["Car", "Van"]) == [(1, [0, 1]), (2, [0, 1]), (1, [3]), (2, [3])]


def test_a_missing_scan_ends_all_tracklets():
    frames = [cut(frame(k, with_scan=k != 3)) for k in range(5)]
    assert spans(frames, ["Car", "Van"]) == [(0, [0, 1, 2]), (1, [2]), (1, [4]), (0, [4])]


def test_other_classes_make_no_tracklets():
    frames = [segmented(k, CAR, VAN, (3, "Pedestrian")) for k in range(3)]
    assert spans(frames, ["Van"]) == [(2, [0, 1, 2])]
    assert spans(frames, []) == []


def test_no_frames_make_no_tracklets():
    assert spans([]) == []


def test_a_tracklet_is_given_out_as_soon_as_it_ends():
    read = []

    def frames():
        for k in range(6):
            read.append(k)
            yield segmented(k, *([CAR] if k < 2 else []), VAN)

    first = next(tracklets(frames(), ["Car", "Van"]))
    assert (first.track_id, len(first.segments)) == (1, 2)
    assert read == [0, 1, 2]


def test_the_ground_in_the_world_is_that_under_the_middle_of_the_box():
    """A sensor that leans forward by 2 degrees sees a level road rise: 1 m higher 28.6 m ahead."""
    lean = se3.pose(Rotation.from_euler("y", 2.0, degrees=True).as_matrix(), np.array([100.0, 50.0, 1.73]))
    center = np.array([20.0, 0.0, -1.0])
    box = Box(1, "Car", se3.from_yaw(0.3, center), np.array([4.0, 1.8, 1.5]))
    segment = segment_of(box, np.array([[18.0, 0.0, -1.0]]), 0, 0.0, lean)
    assert segment.ground_z_lidar == pytest.approx(-1.75)
    expected = 1.73 - 20.0 * np.sin(np.deg2rad(2.0)) - 1.75 * np.cos(np.deg2rad(2.0))
    assert segment.ground_z_world == pytest.approx(expected)
    assert look(segment, lean).points[0, 2] == pytest.approx(
        1.73 - 18.0 * np.sin(np.deg2rad(2.0)) - np.cos(np.deg2rad(2.0)) - expected
    )
    assert segment_of(box, segment.points_lidar, 0, 0.0, None).ground_z_world is None
    below = replace(segment, ground_z_world=None)  # then it is what is known: the height below the points
    assert look(below, lean).points[0, 2] == pytest.approx(0.75 * np.cos(np.deg2rad(2.0)))
