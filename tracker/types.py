"""Time and identity: frames, boxes, segments, tracklets and velocity estimates, all frozen."""

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.types import Point, Points, Transform

Vector2 = Float64[np.ndarray, "2"]
Covariance2 = Float64[np.ndarray, "2 2"]
StepCovariance = Float64[np.ndarray, "3 3"]  # of the ego's step from k - 1 to k: (x, y, yaw) about the sensor at k
Twist = Float64[np.ndarray, "6"]  # (vx, vy, vz) of the sensor [m/s], (wx, wy, wz) [rad/s], both in its own axes

# Of the ego's step from or to a pose that is a guess: a car's own motion, as if nothing had been measured.
UNKNOWN_STEP = np.diag([1.0, 1.0, 0.05]) ** 2  # [m^2, m^2, rad^2]

WORLD, SENSOR = "world", "sensor"  # frames a velocity can be in: fixed to the ground, or moving with the ego


@dataclass(frozen=True, slots=True)
class Box:
    """An oriented box around one object in one scan.

    Attributes:
        track_id: identity of the object within its sequence.
        class_name: the data set's own word: `Car`, `Van`, `Pedestrian`, ...
        T_lidar_obj: pose of the box: origin at its centre, x along the heading, z up.
        size: length (x), width (y), height (z) [m].
        truncation: how far the object leaves the image, as the data set codes it; -1 where unknown.
        occlusion: how far it is hidden, as the data set codes it; -1 where unknown.
    """

    track_id: int
    class_name: str
    T_lidar_obj: Transform
    size: Point
    truncation: int = -1
    occlusion: int = -1

    @property
    def center_lidar(self) -> Point:
        """Centre of the box [m]."""
        return self.T_lidar_obj[:3, 3].copy()

    @property
    def yaw_lidar(self) -> float:
        """Heading, counter-clockwise about +z [rad]."""
        return se3.yaw(self.T_lidar_obj)

    @property
    def corners_lidar(self) -> Points:
        """The eight corners (8, 3) [m]; rows 0-3 are the bottom, front left first, counter-clockwise."""
        signs = np.array([[x, y, z] for z in (-1, 1) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))])
        return se3.transform(self.T_lidar_obj, 0.5 * signs * self.size)

    @property
    def ground_z_lidar(self) -> float:
        """Height of the lowest corner [m]: where the object stands."""
        return float(self.corners_lidar[:, 2].min())

    def ground_z_world(self, T_world_lidar: Transform) -> float:
        """Height of the middle of the bottom in the world [m]: where the object stands, seen by a leaning sensor."""
        bottom_lidar = self.center_lidar - 0.5 * self.size[2] * self.T_lidar_obj[:3, 2]
        return float(se3.transform(T_world_lidar, bottom_lidar[None])[0, 2])


@dataclass(frozen=True, slots=True)
class Sweep:
    """How the sensor turns and moves during one sweep: what it takes to know the time and the place of each point.

    Attributes:
        twist_lidar: its motion while it turns.
        period: time of a full turn [s].
        is_clockwise: which way it turns, seen from above.
        cut_azimuth: direction in which a sweep ends and the next one begins [rad].
        to_frame_time: move everything to the instant at which the beams point forward, which is the frame's; otherwise
            to the instant at which they meet each object, for velocities relative to the sensor.
    """

    twist_lidar: Twist
    period: float = 0.1
    is_clockwise: bool = True
    cut_azimuth: float = float(np.pi)
    to_frame_time: bool = True


@dataclass(frozen=True, slots=True)
class Frame:
    """One sweep of the sensor and what is known with it.

    Attributes:
        index: number of the frame in its sequence.
        timestamp: [s], from any epoch.
        boxes: the objects of the frame.
        points_lidar: the scan (n, 3) [m], or None where the data set lists the frame but has no scan of it.
        T_world_lidar: pose of the sensor, or None where nothing is known of the ego's motion.
        ego_step_covariance: of the pose's step from the frame before, (x, y, yaw) about the sensor, in world axes
            [m^2, m rad, rad^2]; None where nobody claims any.
        sweep: motion during the sweep, where an object's points are to be moved to one instant, and time is that of
            the look at it; None to take both as they are.
        is_swept: points are where they were when the beams passed them, one after the other, as in the raw sweeps of a
            sensor that turns; otherwise all of them are of one instant.
        lasers: name of the beam model of the sensor, which says to which sides lasers look that fire together; None
            where nobody knows.
        is_simulated: the scan is our simulator's, whose errors are known; those of real ones are larger.
    """

    index: int
    timestamp: float
    boxes: tuple[Box, ...]
    points_lidar: Points | None
    T_world_lidar: Transform | None
    ego_step_covariance: StepCovariance | None = None
    sweep: Sweep | None = None
    is_swept: bool = False
    lasers: str | None = None
    is_simulated: bool = False

    def without_pose(self) -> "Frame":
        """Forget the ego's pose: what is estimated of this frame is relative to the sensor."""
        sweep = None if self.sweep is None else replace(self.sweep, to_frame_time=False)
        return replace(self, T_world_lidar=None, ego_step_covariance=None, sweep=sweep)


@dataclass(frozen=True, slots=True)
class Segment:
    """The points of one object in one scan: all that an estimator may know of it.

    Attributes:
        track_id: identity of the object within its sequence.
        class_name: the data set's own word.
        frame: number of the frame in its sequence.
        timestamp: [s]; of the very look at the object where there is a `sweep`, else of the frame.
        points_lidar: the object's points (n, 3) [m]; n = 0 where the box is empty.
        ground_z_lidar: height of the ground under the object [m].
        ground_z_world: the same in the world, for the pose that came with the scan; None where none did.  A sensor
            that leans by 1 degree is 0.35 m off at 20 m, so that the one does not follow from the other without
            knowing the very spot that is meant.
        is_swept, lasers, is_simulated, sweep: as in the frame.
        seen_after: how long after the time of the frame the look was [s]; 0 where `timestamp` is that of the frame.
    """

    track_id: int
    class_name: str
    frame: int
    timestamp: float
    points_lidar: Points
    ground_z_lidar: float
    ground_z_world: float | None = None
    is_swept: bool = False
    lasers: str | None = None
    is_simulated: bool = False
    sweep: Sweep | None = None
    seen_after: float = 0.0


@dataclass(frozen=True, slots=True)
class SegmentedFrame:
    """All segments of one scan, and apart from them the boxes that they were cut by.

    The boxes are for evaluation: truth is made from them, so no estimator gets to see them.

    Attributes:
        index, timestamp, T_world_lidar, ego_step_covariance: as in the frame.
        segments, boxes: by track id.
        seen_at: when the beams met the objects' centres, where time is not the frame's [s].
    """

    index: int
    timestamp: float
    segments: dict[int, Segment]
    boxes: dict[int, Box]
    T_world_lidar: Transform | None
    ego_step_covariance: StepCovariance | None = None
    seen_at: dict[int, float] = field(default_factory=dict)

    def time_of(self, track_id: int) -> float:
        """Give the time at which an object was seen [s]: the frame's, unless it is that of each look."""
        return self.seen_at.get(track_id, self.timestamp)


@dataclass(frozen=True, slots=True)
class Tracklet:
    """One object over consecutive frames, without a gap.

    Attributes:
        track_id: identity of the object within its sequence; a track with gaps makes several tracklets.
        class_name: the data set's own word.
        segments: one a frame, in order; consecutive frames.
        T_world_lidar: pose of the sensor at each of them, or None throughout.
    """

    track_id: int
    class_name: str
    segments: tuple[Segment, ...]
    T_world_lidar: tuple[Transform | None, ...]


class EstimateStatus(str, Enum):
    """How a velocity came about; the first is a measurement, all others are counted as abstentions.

    The words are those of `registration.Status`, and two that only a track has.
    """

    CONVERGED = "converged"
    TOO_FEW_POINTS = "too-few-points"
    NO_OVERLAP = "no-overlap"
    NOT_CONVERGED = "not-converged"
    NEW_TRACK = "new-track"  # seen for the first time: nothing can be known of its velocity
    NO_POINTS = "no-points"  # the box is empty, or seen next to no time after the last look: the last velocity

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True)
class Hindsight:
    """What later frames say of an earlier step of the same object; frame name and axes are those of that step.

    Attributes:
        frame: number of the frame in which the step ends.
        velocity: [m/s].
        covariance: [m^2/s^2].
    """

    frame: int
    velocity: Vector2
    covariance: Covariance2


@dataclass(frozen=True, slots=True)
class VelocityEstimate:
    """How fast one object moves at one moment, and how sure that is.

    Attributes:
        track_id: identity of the object within its sequence.
        frame: number of the frame; the velocity is that of the step that ends there.
        timestamp: [s].
        frame_name: `world` (fixed to the ground) or `sensor` (relative to the ego, in the sensor's axes).
        position: the point that the velocity refers to, horizontal [m], in that frame.
        velocity: (vx, vy) [m/s].
        covariance: of the velocity [m^2/s^2].
        yaw_rate: [rad/s]; NaN for estimators that know nothing of it.
        range_m: horizontal distance from the sensor [m].
        n_points: size of the segment.
        status: CONVERGED, or why the estimator abstained (its fallback stands in `velocity`).
        hindsight: what is now known of earlier steps, the latest first; empty for estimators that do not look back.
    """

    track_id: int
    frame: int
    timestamp: float
    frame_name: str
    position: Vector2
    velocity: Vector2
    covariance: Covariance2
    yaw_rate: float
    range_m: float
    n_points: int
    status: EstimateStatus
    hindsight: tuple[Hindsight, ...] = ()

    @property
    def speed(self) -> float:
        """Magnitude of the velocity [m/s]."""
        return float(np.hypot(*self.velocity))

    @property
    def abstained(self) -> bool:
        """Whether the velocity is a fallback and no measurement."""
        return self.status is not EstimateStatus.CONVERGED
