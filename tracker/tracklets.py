"""From frames to segments, one a box, and from segments to tracklets without gaps."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

from registration.types import Points, Transform
from tracker.boxes import points_in_boxes
from tracker.ego_motion.sweep import looked_at
from tracker.types import Box, Frame, Segment, SegmentedFrame, Tracklet


def cut(frame: Frame) -> SegmentedFrame:
    """Cut the segments of all boxes of a frame; a frame without a scan has boxes and no segments.

    Where the frame says how the sensor moved during the sweep, it is noted when each object was looked at.
    """
    segments = {}
    if frame.points_lidar is not None:
        rows = points_in_boxes(frame.points_lidar, frame.boxes)
        for box, found in zip(frame.boxes, rows, strict=True):
            points_lidar = frame.points_lidar[found]
            segment = segment_of(box, points_lidar, frame.index, frame.timestamp, frame.T_world_lidar)
            segments[box.track_id] = replace(
                segment, is_swept=frame.is_swept, lasers=frame.lasers, is_simulated=frame.is_simulated
            )
    segmented = SegmentedFrame(
        index=frame.index,
        timestamp=frame.timestamp,
        segments=segments,
        boxes={box.track_id: box for box in frame.boxes},
        T_world_lidar=frame.T_world_lidar,
        ego_step_covariance=frame.ego_step_covariance,
    )
    return segmented if frame.sweep is None else looked_at(segmented, frame.sweep)


def segment_of(
    box: Box, points_lidar: Points, frame: int, timestamp: float, T_world_lidar: Transform | None
) -> Segment:
    """Tell of a box what estimators may know: the points in it, and the height of the ground under it."""
    return Segment(
        track_id=box.track_id,
        class_name=box.class_name,
        frame=frame,
        timestamp=timestamp,
        points_lidar=points_lidar,
        ground_z_lidar=box.ground_z_lidar,
        ground_z_world=None if T_world_lidar is None else box.ground_z_world(T_world_lidar),
    )


def of_classes(segments: dict[int, Segment], classes: Collection[str]) -> dict[int, Segment]:
    """Keep the segments of some classes."""
    return {key: segment for key, segment in segments.items() if segment.class_name in classes}


def tracklets(frames: Iterable[SegmentedFrame], classes: Collection[str]) -> Iterator[Tracklet]:
    """Collect each object's segments over consecutive frames; a gap ends a tracklet and starts another.

    A frame in which the object's box is there but holds no point is no gap; a missing scan is one.
    Only the tracklets under way are in memory; each is given out as soon as it ends.
    """
    under_way: dict[int, list[tuple[Segment, Transform | None]]] = {}
    last_frame = None
    for frame in frames:
        segments = of_classes(frame.segments, classes)
        follows = last_frame is not None and frame.index == last_frame + 1
        for track_id in [key for key in under_way if key not in segments or not follows]:
            yield _finish(under_way.pop(track_id))
        for track_id, segment in segments.items():
            under_way.setdefault(track_id, []).append((segment, frame.T_world_lidar))
        last_frame = frame.index
    for steps in under_way.values():
        yield _finish(steps)


def _finish(steps: list[tuple[Segment, Transform | None]]) -> Tracklet:
    first = steps[0][0]
    return Tracklet(
        track_id=first.track_id,
        class_name=first.class_name,
        segments=tuple(segment for segment, _ in steps),
        T_world_lidar=tuple(T for _, T in steps),
    )
