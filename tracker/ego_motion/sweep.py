"""The time of each point in a sweep, and what the sensor's own motion during the sweep does to it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.lidar import pose_after, twist_between
from registration.synthetic.lidar.motion import carried
from registration.types import Points, Transform
from tracker.types import Box, Segment, SegmentedFrame, Sweep, Twist

__all__ = [
    "LEAST_SHARE",
    "azimuth_times",
    "looked_at",
    "moved_to_frame_time",
    "moved_to_one_instant",
    "point_times",
    "twist_of_step",
]

# Of the time between two frames that lies between two looks at an object, for these to tell of a velocity.  What
# crosses the direction in which sweeps end, against their turn, is seen at the end of one and the start of the next.
LEAST_SHARE = 0.5


def point_times(points_lidar: Points, sweep: Sweep) -> Float64[np.ndarray, " n"]:
    """Tell when each point was measured, after the moment at which the beams point forward [s].

    KITTI stores no time with a point; its direction tells it.  The lasers of an HDL-64E look up to some degrees past
    their head, which is left out: a degree is 0.28 ms.
    """
    return azimuth_times(np.arctan2(points_lidar[:, 1], points_lidar[:, 0]), sweep)


def azimuth_times(azimuth: Float64[np.ndarray, " n"], sweep: Sweep) -> Float64[np.ndarray, " n"]:
    """Tell when the sensor's head points to sides [rad], after the moment at which it points forward [s]."""
    sense = -1.0 if sweep.is_clockwise else 1.0
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


def moved_to_one_instant(points_lidar: Points, sweep: Sweep, seen_after: float) -> Points:
    """Move an object's points by the sensor's motion: to the frame's time, or with `to_frame_time` off to the look's.

    The object's own motion during the look, milliseconds long, stays.

    Args:
        points_lidar: each in the sensor's frame at its own time [m].
        sweep: how the sensor turns and moves.
        seen_after: when the object was looked at, after the frame's time [s].
    """
    points = moved_to_frame_time(points_lidar, sweep)
    return points if sweep.to_frame_time else se3.transform(pose_after(sweep.twist_lidar, -seen_after), points)


def looked_at(frame: SegmentedFrame, sweep: Sweep) -> SegmentedFrame:
    """Note when each object was looked at, and bring boxes and ground to one instant, as `moved_to_one_instant` does.

    A look at an object is the mean time of its points; one at its box is when the beams met its centre, where people
    label what they see.
    """
    segments, boxes, seen_at = {}, {}, {}
    for track_id, box in frame.boxes.items():
        met = _mean_time(box.center_lidar[None], sweep)
        T_then_met = pose_after(sweep.twist_lidar, met) if sweep.to_frame_time else np.eye(4)
        boxes[track_id] = replace(box, T_lidar_obj=T_then_met @ box.T_lidar_obj)
        seen_at[track_id] = frame.timestamp + met
        segment = frame.segments.get(track_id)
        if segment is not None:
            is_seen = len(segment.points_lidar) > 0
            look = _mean_time(segment.points_lidar, sweep) if is_seen else met
            segments[track_id] = _timed(segment, look, sweep, boxes[track_id], frame)
    return replace(frame, segments=segments, boxes=boxes, seen_at=seen_at)


def _mean_time(points_lidar: Points, sweep: Sweep) -> float:
    return float(point_times(points_lidar, sweep).mean())


def _timed(segment: Segment, look: float, sweep: Sweep, box: Box, frame: SegmentedFrame) -> Segment:
    T_world_lidar = frame.T_world_lidar
    return replace(
        segment,
        timestamp=frame.timestamp + look,
        seen_after=look,
        sweep=sweep,
        ground_z_lidar=box.ground_z_lidar,
        ground_z_world=None if T_world_lidar is None else box.ground_z_world(T_world_lidar),
    )
