"""True velocities to score against: from labels, from smoothed labels, or exact from a simulator."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from registration.types import Transform
from tracker.ego_motion.sweep import LEAST_SHARE
from tracker.errors import MissingDataError
from tracker.kitti.truth import ExactPose
from tracker.types import WORLD, SegmentedFrame, Vector2

TRUTHS = ("labels", "smoothed", "exact")

WINDOW, ORDER = 9, 2  # of the Savitzky-Golay filter [frames]

# A parked object's label centres stay together and go nowhere.  Labels jitter by 0.03-0.05 m and poses drift
# by 0.1 m/s at most over a track's life, so a steady 0.3 m/s that stands out of the jitter is motion.
PARKED_SPREAD = 1.0  # diagonal of the rectangle around the centres [m]
PARKED_SPEED = 0.3  # of a straight line through the centres [m/s]
LABEL_NOISE = 0.05  # floor of the centres' scatter [m]
SIGNIFICANCE = 2.0  # slopes below this many standard errors are no trend

Centers = Float64[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True)
class TrueVelocity:
    """The truth of one object's step from frame k - 1 to k.

    Attributes:
        velocity: [m/s], in the frame asked for.
        range_m: horizontal distance of the box centre at k from the sensor [m].
        is_parked: the object counts as parked for its whole life.
        class_name: of the label at k, the data set's own word.
    """

    velocity: Vector2
    range_m: float
    is_parked: bool
    class_name: str


def true_velocities(
    frames: Sequence[SegmentedFrame],
    frame_name: str,
    truth: str,
    exact: Mapping[tuple[int, int], ExactPose] | None = None,
) -> dict[tuple[int, int], TrueVelocity]:
    """Give the true velocity of every step between consecutive frames, by (track id, frame k).

    Velocity at k is the displacement of the box centre from k - 1 to k over the real time between them.  Where next to
    none lies between two looks, there is no velocity: what crosses the direction in which sweeps end, against their
    turn, is seen at the end of one and again at the start of the next.
    `labels` takes the boxes as they are.  `smoothed` passes their world centres through a Savitzky-Golay filter
    (9 frames, order 2) and holds parked objects exactly still in the world; without poses it smooths the centres
    relative to the sensor, and nothing counts as parked.  `exact` takes the simulator's centres.

    Args:
        frames: all frames of a sequence; their points are not looked at.
        frame_name: WORLD, or SENSOR (relative to the ego, each centre in its own scan's axes).
        truth: one of TRUTHS.
        exact: for `exact`, the simulator's poses by (track id, frame).

    Raises:
        MissingDataError: world velocities without poses, or no exact poses, or none in the world.
    """
    if frame_name == WORLD and any(frame.T_world_lidar is None for frame in frames):
        raise MissingDataError(
            "velocities in the world need the ego's poses (oxts or poses), and there are none: ask for the sensor frame"
        )
    if truth == "exact" and exact is None:
        raise MissingDataError("exact truth is there for simulated sequences only")
    found: dict[tuple[int, int], TrueVelocity] = {}
    for track in _tracks(frames):
        if truth == "exact" and exact is not None:
            centers, parked = _exact_centers(exact, track, frame_name)
        else:
            centers, parked = _label_centers(track, frame_name, smooth=truth == "smoothed")
        found.update(_steps(track, centers, parked))
    return found


@dataclass(frozen=True, slots=True)
class _TrackBoxes:
    """The label of one object wherever it has one; gaps included."""

    track_id: int
    class_names: tuple[str, ...]
    frames: Int64[np.ndarray, " n"]
    times: Float64[np.ndarray, " n"]
    frame_times: Float64[np.ndarray, " n"]
    centers_lidar: Centers
    poses: tuple[Transform | None, ...]


def _tracks(frames: Sequence[SegmentedFrame]) -> list[_TrackBoxes]:
    seen: dict[int, list[SegmentedFrame]] = defaultdict(list)
    for frame in frames:
        for track_id in frame.boxes:
            seen[track_id].append(frame)
    return [
        _TrackBoxes(
            track_id=track_id,
            class_names=tuple(f.boxes[track_id].class_name for f in life),
            frames=np.array([f.index for f in life]),
            times=np.array([f.time_of(track_id) for f in life]),
            frame_times=np.array([f.timestamp for f in life]),
            centers_lidar=np.array([f.boxes[track_id].center_lidar for f in life]),
            poses=tuple(f.T_world_lidar for f in life),
        )
        for track_id, life in seen.items()
    ]


def _steps(track: _TrackBoxes, centers: Centers, parked: bool) -> dict[tuple[int, int], TrueVelocity]:
    """Difference the centres wherever two frames follow each other, and so do the looks."""
    found = {}
    has_time = np.diff(track.times) > LEAST_SHARE * np.diff(track.frame_times)
    for i in np.flatnonzero((np.diff(track.frames) == 1) & has_time) + 1:
        velocity = (centers[i] - centers[i - 1])[:2] / (track.times[i] - track.times[i - 1])
        range_m = float(np.hypot(*track.centers_lidar[i, :2]))
        found[track.track_id, int(track.frames[i])] = TrueVelocity(velocity, range_m, parked, track.class_names[i])
    return found


def is_parked(centers_world: Centers, times: Float64[np.ndarray, " n"]) -> bool:
    """Tell whether label centres over an object's whole life are those of something that stands still."""
    xy = centers_world[:, :2]
    spread = np.hypot(*np.ptp(xy, axis=0))
    if spread >= PARKED_SPREAD or len(xy) < 2:
        return False
    t = times - times.mean()
    slope = t @ (xy - xy.mean(axis=0)) / (t @ t)
    scatter = np.sqrt(np.mean((xy - xy.mean(axis=0) - np.outer(t, slope)) ** 2))
    standard_error = max(scatter, LABEL_NOISE) / np.sqrt(t @ t)
    speed = float(np.hypot(*slope))
    return speed < max(PARKED_SPEED, SIGNIFICANCE * float(standard_error))


def _exact_centers(
    exact: Mapping[tuple[int, int], ExactPose], track: _TrackBoxes, frame_name: str
) -> tuple[Centers, bool]:
    keys = [(track.track_id, int(frame)) for frame in track.frames]
    for key in keys:
        if key not in exact:
            raise MissingDataError(f"exact truth lacks track {key[0]} in frame {key[1]}")
    poses = [exact[key] for key in keys]
    world = np.array([pose.center_world for pose in poses if pose.center_world is not None]).reshape(-1, 3)
    is_known = len(world) == len(keys)
    if frame_name == WORLD and not is_known:
        raise MissingDataError("the exact truth knows no world, only the sensor's axes: ask for the sensor frame")
    centers = world if frame_name == WORLD else np.array([pose.center_lidar for pose in poses])
    return centers, is_known and bool(np.ptp(world, axis=0).max() < 1e-6)


def _label_centers(track: _TrackBoxes, frame_name: str, smooth: bool) -> tuple[Centers, bool]:
    """Give label centres in the frame asked for, smoothed where wanted, and whether they count as parked."""
    poses = [T for T in track.poses if T is not None]
    if len(poses) < len(track.frames):
        centers = track.centers_lidar
        return (_smooth_runs(centers, track.frames) if smooth else centers), False
    world = _move_each(poses, track.centers_lidar)
    parked = is_parked(world, track.times)
    if smooth:
        world = np.tile(world.mean(axis=0), (len(world), 1)) if parked else _smooth_runs(world, track.frames)
    if frame_name == WORLD:
        return world, parked
    return _move_each([se3.invert(T) for T in poses], world), parked


def _move_each(transforms: Sequence[Transform], points: Centers) -> Centers:
    """Move each point by its own transform."""
    return np.array([se3.transform(T, p[None])[0] for T, p in zip(transforms, points, strict=True)])


def _smooth_runs(centers: Centers, frames: Int64[np.ndarray, " n"]) -> Centers:
    """Smooth each run of consecutive frames for itself; short runs take the longest odd window that fits."""
    from scipy.signal import savgol_filter  # takes a second to load, and exact truth does without

    smoothed = centers.copy()
    gaps = np.flatnonzero(np.diff(frames) != 1) + 1
    for run in np.split(np.arange(len(frames)), gaps):
        window = min(WINDOW, len(run) - 1 + len(run) % 2)
        if window > ORDER:
            smoothed[run] = savgol_filter(centers[run], window, ORDER, axis=0)
    return smoothed
