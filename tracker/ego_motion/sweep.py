"""The time of each point in a sweep, and what the sensor's own motion during the sweep does to it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.lidar import pose_after, twist_between
from registration.synthetic.lidar.motion import carried
from registration.types import Points, Transform
from tracker.types import Box, Segment, SegmentedFrame, Sweep, Twist

__all__ = ["at_one_instant", "moved_to_frame_time", "point_times", "twist_of_step"]


def point_times(points_lidar: Points, sweep: Sweep) -> Float64[np.ndarray, " n"]:
    """Tell when each point was measured, after the moment at which the beams point forward [s].

    KITTI stores no time with a point; its direction tells it.  The lasers of an HDL-64E look up to some degrees past
    their head, which is left out: a degree is 0.28 ms.
    """
    sense = -1.0 if sweep.is_clockwise else 1.0
    azimuth = np.arctan2(points_lidar[:, 1], points_lidar[:, 0])
    since_cut = np.mod(sense * (azimuth - sweep.cut_azimuth) / (2.0 * np.pi), 1.0)
    forward = np.mod(-sense * sweep.cut_azimuth / (2.0 * np.pi), 1.0)
    return sweep.period * (since_cut - forward)


def twist_of_step(T_before_after: Transform, dt: float) -> Twist:
    """Find the steady motion of a sensor, in its own axes, that makes a step in time dt [s]."""
    return twist_between(np.eye(4), T_before_after, dt)


def moved_to_frame_time(points_lidar: Points, sweep: Sweep) -> Points:
    """Give points that rest in the world the coordinates that they have when the beams point forward [m].

    Args:
        points_lidar: each in the sensor's frame at its own time, as raw sweeps have them [m].
        sweep: how the sensor turns and moves.
    """
    return carried(sweep.twist_lidar, point_times(points_lidar, sweep), points_lidar.T).T


def at_one_instant(frame: SegmentedFrame, sweep: Sweep) -> SegmentedFrame:
    """Move each object's points to one instant, by the sensor's motion, and note when the object was looked at.

    A look at an object is the mean time of its points (of its box's centre where it has none).  Points, box and ground
    are brought to the frame's instant, or with `to_frame_time` off to that of the look.  The object's own motion
    during the look, milliseconds long, stays.
    """
    looks = {track_id: _look_time(box, frame.segments.get(track_id), sweep) for track_id, box in frame.boxes.items()}
    segments, boxes = {}, {}
    for track_id, box in frame.boxes.items():
        T_then_look = pose_after(sweep.twist_lidar, looks[track_id]) if sweep.to_frame_time else np.eye(4)
        boxes[track_id] = replace(box, T_lidar_obj=T_then_look @ box.T_lidar_obj)
        segment = frame.segments.get(track_id)
        if segment is not None:
            points = moved_to_frame_time(segment.points_lidar, sweep)
            if not sweep.to_frame_time:
                points = se3.transform(pose_after(sweep.twist_lidar, -looks[track_id]), points)
            segments[track_id] = _looked_at(segment, points, boxes[track_id], frame, looks[track_id])
    seen_at = {track_id: frame.timestamp + look for track_id, look in looks.items()}
    return replace(frame, segments=segments, boxes=boxes, seen_at=seen_at)


def _look_time(box: Box, segment: Segment | None, sweep: Sweep) -> float:
    has_points = segment is not None and len(segment.points_lidar) > 0
    seen = segment.points_lidar if segment is not None and has_points else box.center_lidar[None]
    return float(point_times(seen, sweep).mean())


def _looked_at(segment: Segment, points: Points, box: Box, frame: SegmentedFrame, look: float) -> Segment:
    T_world_lidar = frame.T_world_lidar
    return replace(
        segment,
        timestamp=frame.timestamp + look,
        points_lidar=points,
        ground_z_lidar=box.ground_z_lidar,
        ground_z_world=None if T_world_lidar is None else box.ground_z_world(T_world_lidar),
    )
