"""Labelled tracks as motions: boxes without their jitter, at any time between two frames."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.interpolate import CubicSpline

from registration import se3
from registration.synthetic.lidar import twist_between
from registration.types import Point, Transform
from tracker.ego_motion.sweep import LEAST_SHARE
from tracker.types import Box

WINDOW, ORDER = 9, 2  # of the local polynomials [frames]
STEP = 1e-3  # of the difference that stands for a derivative [s]

# The way that legs and pedals know of is that over the ground, but labels tell of the way relative to the sensor, which
# the ego's own motion is part of: relative speeds count up to what such a road user does by its own strength [m/s].
OWN_SPEEDS = {"Pedestrian": 1.6, "Cyclist": 5.5}

Times = Float64[np.ndarray, " _"]


@dataclass(frozen=True)
class Stretch:
    """A track over consecutive frames, smooth in time.

    Attributes:
        first: number of its first frame.
        times: at which it was seen in each of its frames [s].
        centers_lidar: of its boxes, smoothed [m].
        yaws_lidar: their headings, smoothed and without jumps [rad].
    """

    first: int
    times: Times
    centers_lidar: Float64[np.ndarray, "n 3"]
    yaws_lidar: Float64[np.ndarray, " n"]

    def pose(self, t: float) -> Transform:
        """Pose T_lidar_obj of the box at time t; straight on beyond the ends."""
        if len(self.times) == 1:
            return se3.from_yaw(float(self.yaws_lidar[0]), self.centers_lidar[0])
        inside = float(np.clip(t, self.times[0], self.times[-1]))
        values = self._spline(inside) + (t - inside) * self._spline(inside, 1)
        return se3.from_yaw(float(values[3]), values[:3])

    def twist(self, t: float) -> Float64[np.ndarray, "6"]:
        """Motion relative to the sensor at time t: pose(t + dt) = exp(dt twist) pose(t) [m/s, rad/s]."""
        return twist_between(self.pose(t - STEP), self.pose(t + STEP), 2.0 * STEP)

    def ways(self, class_name: str) -> Times:
        """Way gone by own strength until each frame, roughly [m]."""
        steps = np.linalg.norm(np.diff(self.centers_lidar[:, :2], axis=0), axis=1)
        own = np.minimum(steps, OWN_SPEEDS.get(class_name, 0.0) * np.diff(self.times))
        return np.concatenate([[0.0], np.cumsum(own)])

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.times, np.column_stack([self.centers_lidar, self.yaws_lidar]))


@dataclass(frozen=True)
class Track:
    """A labelled object over its life.

    Attributes:
        track_id: its identity.
        class_name: the labels' word, of its first frame.
        size: length, width, height of its box: the median of its labels' [m].
        stretches: its consecutive frames, in order.
        occlusion: as labelled, by frame.
    """

    track_id: int
    class_name: str
    size: Point
    stretches: tuple[Stretch, ...]
    occlusion: dict[int, int]

    def stretch(self, frame: int) -> Stretch | None:
        """Give what covers a frame; None where the track has no label."""
        return next((part for part in self.stretches if 0 <= frame - part.first < len(part.times)), None)


def smoothed_tracks(
    frames: Iterable[Sequence[Box]], times: Times, seen_after: Callable[[Point], float] | None = None
) -> list[Track]:
    """Turn the boxes of a sequence into smooth tracks, in order of their first frames.

    Labels of raw sweeps lie where the beams met the objects, and what passes by is smooth only over the times at which
    they did: at 30 m/s and 4 m, two looks are a tenth less (or, on the right, more) than a frame apart.

    Args:
        frames: the labels of each frame.
        times: of the frames [s].
        seen_after: how long after the time of a frame something was seen whose centre is at a place (x, y, z) [s]; None
            if all of a frame is seen at once.
    """
    lives: dict[int, list[tuple[int, Box]]] = defaultdict(list)
    for index, boxes in enumerate(frames):
        for box in boxes:
            lives[box.track_id].append((index, box))
    return [_track(track_id, life, times, seen_after) for track_id, life in lives.items()]


def _track(
    track_id: int, life: list[tuple[int, Box]], times: Times, seen_after: Callable[[Point], float] | None
) -> Track:
    frames, boxes = np.array([frame for frame, _ in life]), [box for _, box in life]
    runs = np.split(np.arange(len(life)), np.flatnonzero(np.diff(frames) != 1) + 1)
    return Track(
        track_id=track_id,
        class_name=boxes[0].class_name,
        size=np.median([box.size for box in boxes], axis=0),
        stretches=tuple(_stretch(frames[run], [boxes[i] for i in run], times[frames[run]], seen_after) for run in runs),
        occlusion={frame: box.occlusion for frame, box in life},
    )


def _stretch(
    frames: Int64[np.ndarray, " n"], boxes: list[Box], times: Times, seen_after: Callable[[Point], float] | None
) -> Stretch:
    centers = np.array([box.center_lidar for box in boxes])
    yaws = without_flips(np.array([box.yaw_lidar for box in boxes]))
    if seen_after is not None:
        looks = times + [seen_after(center) for center in centers]
        # what crosses the direction in which sweeps end is seen twice at once, or late: its frames have to do
        if (np.diff(looks) > LEAST_SHARE * np.diff(times)).all():
            times = looks
    return Stretch(int(frames[0]), times, smoothed(centers, times), smoothed(yaws[:, None], times)[:, 0])


def smoothed(values: Float64[np.ndarray, "n k"], times: Times) -> Float64[np.ndarray, "n k"]:
    """Smooth consecutive values: each becomes that of the parabola through the nine around it.

    Over equal times that is the filter of Savitzky & Golay (Analytical Chemistry 36(8), 1964), which goes on to the
    ends with the first and last parabola.  Fewer values take the longest odd window that fits, 3 or 4 of them a
    straight line, and 2 stay as they are.
    """
    n = len(values)
    window = min(WINDOW, n - 1 + n % 2)
    if window < 3:
        return values.copy()
    found = np.empty_like(values)
    for k in range(n):
        first = min(max(k - window // 2, 0), n - window)
        around = slice(first, first + window)
        powers = np.vander(times[around] - times[k], min(ORDER, window - 2) + 1)
        found[k] = np.linalg.lstsq(powers, values[around], rcond=None)[0][-1]
    return found


def without_flips(yaws: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Make headings continuous, and undo labels that point backwards.

    A turn by more than 90 degrees from one frame to the next is taken for a flip by 180; the direction that most
    labels agree with wins.
    """
    continuous = 0.5 * np.unwrap(2.0 * yaws)
    is_backwards = np.cos(continuous - yaws).sum() < 0.0
    return continuous + np.pi if is_backwards else continuous
