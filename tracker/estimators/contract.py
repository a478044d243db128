"""What a velocity estimator is, and the shell that all of ours share."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from registration import se3
from registration.types import Point, Points, Transform
from tracker.ego_motion.sweep import LEAST_SHARE, moved_to_one_instant
from tracker.errors import InputError
from tracker.estimators import contract_kernels
from tracker.smoothing import ACCELERATION_VARIANCE, Smoothing
from tracker.types import (
    SENSOR,
    WORLD,
    Covariance2,
    EstimateStatus,
    Hindsight,
    Segment,
    Tracklet,
    Vector2,
    VelocityEstimate,
)

# What is known of a velocity before the first measurement.  Relative speeds on a highway reach 60 m/s.
UNKNOWN_VARIANCE = 30.0**2  # [m^2/s^2]


@runtime_checkable
class Estimator(Protocol):
    """Segments in, velocities out: online one frame at a time, or offline one tracklet at a time.

    Estimators never see a label's box: truth is made from it.
    """

    @property
    def name(self) -> str:
        """The name that tables print."""

    def step(
        self, segments: Mapping[int, Segment], timestamp: float, T_world_lidar: Transform | None
    ) -> dict[int, VelocityEstimate]:
        """Take all objects of a frame; give a velocity for each, from this and earlier frames only.

        Args:
            segments: by track id.  A track that is not among them is forgotten.
            timestamp: time of the frame [s].
            T_world_lidar: pose of the sensor.  With it velocities are in the world frame; with None they are
                relative to the sensor, in the sensor's axes.
        """

    def smooth(self, tracklet: Tracklet) -> list[VelocityEstimate]:
        """Give a velocity for each segment of a tracklet, from its past and its future."""

    def smoothed(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth what `step` gave for one tracklet, without looking at the points again."""


class Sighting(NamedTuple):
    """A segment as an estimator looks at it: points in the frame of its velocities, z above the ground.

    Attributes:
        class_name: the data set's own word.
        points: (n, 3) [m]; horizontal axes of the world or of the sensor; of one instant where the segment has a sweep,
            but for estimators that undo it themselves.
        centroid: mean of the points [m].
        midpoint: middle of the points' bounding box [m]: the reference point of displacements, since the
            centroid wanders with the density of the points.
        timestamp: [s]; of the look where `is_timed_by_look`, else of the frame.
        frame_timestamp: of the frame [s].
        frame: number of the frame in its sequence.
        range_m: horizontal distance of the midpoint from the sensor [m].
        sensor: where the sensor is, horizontally (x, y), in the axes of the points [m].
        sensor_yaw: which way it looks, in the same axes [rad].
        in_world: whether the axes are the world's; else they are the sensor's, and turn with it.
        points_lidar: in the sensor's own axes (n, 3) [m].
        is_swept: points are where they were, relative to the sensor, when the beams passed them, and the estimator is
            one that undoes that.
        is_timed_by_look: velocities are to be displacements over the time between looks, not over that between frames.
        lasers: name of the sensor's beam model; None where nobody knows it.
        is_simulated: as in the frame.
    """

    class_name: str
    points: Points
    centroid: Point
    midpoint: Point
    timestamp: float
    frame_timestamp: float
    frame: int
    range_m: float
    sensor: Vector2
    sensor_yaw: float
    in_world: bool
    points_lidar: Points
    is_swept: bool = False
    is_timed_by_look: bool = False
    lasers: str | None = None
    is_simulated: bool = False


def look(segment: Segment, T_world_lidar: Transform | None, undoes_sweep: bool = False) -> Sighting:
    """Bring a non-empty segment into the frame of its velocities.

    Args:
        segment: of an object.
        T_world_lidar: pose of the sensor; None for velocities relative to it.
        undoes_sweep: the estimator undoes by itself what moved during the sweep: its points stay as they were seen.
    """
    T = np.eye(4) if T_world_lidar is None else T_world_lidar
    is_swept = segment.is_swept and undoes_sweep
    points_lidar = segment.points_lidar
    if segment.sweep is not None and not is_swept:
        points_lidar = moved_to_one_instant(points_lidar, segment.sweep, segment.seen_after)
    points, centroid, midpoint = contract_kernels.place(
        np.ascontiguousarray(points_lidar), np.ascontiguousarray(T), _ground_z(segment, T_world_lidar)
    )
    sensor = T[:2, 3].copy()
    return Sighting(
        class_name=segment.class_name,
        points=points,
        centroid=centroid,
        midpoint=midpoint,
        timestamp=segment.timestamp,
        frame_timestamp=segment.timestamp - segment.seen_after,
        frame=segment.frame,
        range_m=math.dist(midpoint[:2], sensor),
        sensor=sensor,
        sensor_yaw=se3.yaw(T),
        in_world=T_world_lidar is not None,
        points_lidar=points_lidar,
        is_swept=is_swept,
        is_timed_by_look=segment.sweep is not None,
        lasers=segment.lasers,
        is_simulated=segment.is_simulated,
    )


def _ground_z(segment: Segment, T_world_lidar: Transform | None) -> float:
    """Give the height of the ground in the frame of the velocities; where only the sensor's is known, that below
    the middle of the points.
    """
    if T_world_lidar is None:
        return segment.ground_z_lidar
    if segment.ground_z_world is not None:
        return segment.ground_z_world
    x, y, _ = 0.5 * (segment.points_lidar.min(axis=0) + segment.points_lidar.max(axis=0))
    return float(se3.transform(T_world_lidar, np.array([[x, y, segment.ground_z_lidar]]))[0, 2])


@dataclass(frozen=True, slots=True)
class Measurement:
    """What an estimator found out about one object in one frame."""

    position: Vector2
    velocity: Vector2
    covariance: Covariance2
    yaw_rate: float
    status: EstimateStatus
    hindsight: tuple[Hindsight, ...] = ()


class FrameEstimator(ABC):
    """The shell of an estimator: keeps track of who is there, and deals with new and with empty segments.

    Subclasses fill in `measure` for the objects that have points; `forget` for those that are gone.

    Attributes:
        name: that tables print.
        undoes_sweep: it undoes by itself what moved during a sweep, and is shown points as they were seen.
    """

    name: str
    undoes_sweep: bool = False

    def __init__(self, smoothing: Smoothing) -> None:
        """Start with no tracks; `smoothing` is what `smooth` and `smoothed` do."""
        self.smoothing = smoothing
        self._last: dict[int, VelocityEstimate] = {}
        self._looked: dict[int, tuple[float, float]] = {}  # time of the latest look at each, and of its frame [s]

    @abstractmethod
    def measure(self, sightings: Mapping[int, Sighting]) -> dict[int, Measurement]:
        """Give the velocity of each object that was seen before; the others start a track."""

    @abstractmethod
    def forget(self, track_id: int) -> None:
        """Drop what is kept of a track."""

    @abstractmethod
    def fresh(self) -> "FrameEstimator":
        """Make an estimator with the same settings and no tracks."""

    @abstractmethod
    def smoothed(self, estimates: Sequence[VelocityEstimate]) -> list[VelocityEstimate]:
        """Smooth what `step` gave for one tracklet."""

    def step(
        self, segments: Mapping[int, Segment], timestamp: float, T_world_lidar: Transform | None
    ) -> dict[int, VelocityEstimate]:
        """Take all objects of a frame; see `Estimator.step`.

        Raises:
            InputError: a point is NaN or infinite, or time does not advance.
        """
        self._check(segments, timestamp)
        frame_name = SENSOR if T_world_lidar is None else WORLD
        for track_id, last in list(self._last.items()):
            if track_id not in segments or last.frame_name != frame_name:
                self.forget(track_id)
                del self._last[track_id]
                self._looked.pop(track_id, None)
        sightings = {
            track_id: look(segment, T_world_lidar, self.undoes_sweep)
            for track_id, segment in segments.items()
            if len(segment.points_lidar)
        }
        if not self.undoes_sweep:
            sightings = {track_id: s for track_id, s in sightings.items() if self._takes_time(track_id, s)}
        measured = self.measure(sightings)
        estimates = {}
        for track_id, segment in segments.items():
            if track_id in measured:
                found = measured[track_id]
            elif track_id in self._last and track_id not in sightings:
                found = _hold(self._last[track_id], timestamp)
            else:
                found = _new_track(sightings.get(track_id))
            estimates[track_id] = _estimate(segment, sightings.get(track_id), found, frame_name, timestamp)
        self._last = estimates
        return estimates

    def _takes_time(self, track_id: int, sighting: Sighting) -> bool:
        """Say whether a look comes long enough after the one before to tell of a velocity, and note it if it does."""
        now, before = (sighting.timestamp, sighting.frame_timestamp), self._looked.get(track_id)
        if before is not None and now[0] - before[0] <= LEAST_SHARE * (now[1] - before[1]):
            return False
        self._looked[track_id] = now
        return True

    def _check(self, segments: Mapping[int, Segment], timestamp: float) -> None:
        for track_id, segment in segments.items():
            if not np.isfinite(segment.points_lidar).all():
                raise InputError(
                    f"track {track_id}, frame {segment.frame}: expected finite points, got NaN or infinity"
                )
            last = self._last.get(track_id)
            if last is not None and not timestamp > last.timestamp:
                what = f"expected a time after {last.timestamp:g} s, got {timestamp:g} s"
                raise InputError(f"track {track_id}, frame {segment.frame}: {what}")

    def smooth(self, tracklet: Tracklet) -> list[VelocityEstimate]:
        """Run over the tracklet as if it were live, then smooth; the estimator's own tracks stay as they are."""
        fresh = self.fresh()
        causal = []
        for segment, T_world_lidar in zip(tracklet.segments, tracklet.T_world_lidar, strict=True):
            step = fresh.step({tracklet.track_id: segment}, segment.timestamp - segment.seen_after, T_world_lidar)
            causal.append(step[tracklet.track_id])
        return self.smoothed(causal)


def _hold(last: VelocityEstimate, timestamp: float) -> Measurement:
    """Keep the last velocity where there are no points, less sure by what it may have changed."""
    dt = timestamp - last.timestamp
    is_new = last.status is EstimateStatus.NEW_TRACK
    return Measurement(
        position=last.position + last.velocity * dt,
        velocity=last.velocity,
        covariance=last.covariance + ACCELERATION_VARIANCE * dt**2 * np.eye(2),
        yaw_rate=last.yaw_rate,
        status=EstimateStatus.NEW_TRACK if is_new else EstimateStatus.NO_POINTS,
    )


def _new_track(sighting: Sighting | None) -> Measurement:
    return Measurement(
        position=np.full(2, np.nan) if sighting is None else sighting.midpoint[:2],
        velocity=np.zeros(2),
        covariance=UNKNOWN_VARIANCE * np.eye(2),
        yaw_rate=float("nan"),
        status=EstimateStatus.NEW_TRACK,
    )


def _estimate(
    segment: Segment, sighting: Sighting | None, found: Measurement, frame_name: str, timestamp: float
) -> VelocityEstimate:
    return VelocityEstimate(
        track_id=segment.track_id,
        frame=segment.frame,
        timestamp=timestamp,
        frame_name=frame_name,
        position=found.position,
        velocity=found.velocity,
        covariance=found.covariance,
        yaw_rate=found.yaw_rate,
        range_m=float("nan") if sighting is None else sighting.range_m,
        n_points=len(segment.points_lidar),
        status=found.status,
        hindsight=found.hindsight,
    )
