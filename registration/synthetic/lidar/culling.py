"""Which rays can hit an object at all: those within the angles that the box around it covers during a sweep."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from registration.synthetic.lidar.beams import Rays
from registration.synthetic.lidar.motion import Twist, carried, motion_slack
from registration.types import Point, Points, Transform

_N_BINS = 2048  # of azimuth, for looking rays up: about as many as a turn has columns
_MARGIN = 1e-4  # on all bounds, against rounding [rad and m]
_STEPS = 4  # of the sweep's time, between which a moving box is taken to go straight


class Bounds(NamedTuple):
    """What a box covers, seen from the axis of the sensor.

    Attributes:
        azimuth: where it begins, in [-pi, pi) [rad].
        width: and how far it reaches from there, counter-clockwise; 2 pi for all around [rad].
        lowest: tangent of the lowest elevation from the highest start of a ray.
        highest: tangent of the highest elevation from the lowest start of a ray.
        nearest: horizontal distance from the axis [m].
    """

    azimuth: float
    width: float
    lowest: float
    highest: float
    nearest: float


class RaysByAzimuth:
    """Rays that can be looked up by angles."""

    def __init__(self, rays: Rays) -> None:
        x, y, z = rays.directions.T
        # Small integers sort in linear time.
        bins = _bin(np.arctan2(y, x)).astype(np.int16)
        self._order = np.argsort(bins, kind="stable")
        self._starts = [0, *np.cumsum(np.bincount(bins, minlength=_N_BINS)).tolist()]
        slope = z / np.maximum(np.hypot(x, y), 1e-9)
        self._slope = slope[self._order]
        self._slopes = float(slope.min(initial=np.inf)), float(slope.max(initial=-np.inf))
        self.heights = (float(rays.height.min()), float(rays.height.max())) if len(rays.height) else (0.0, 0.0)

    def within(self, bounds: Bounds) -> Int64[np.ndarray, " n"]:
        """List the rays within some bounds, and a few beside them."""
        found = []
        for start, stop in self._slices(bounds.azimuth, bounds.width):
            order, slope = self._order[start:stop], self._slope[start:stop]
            if bounds.lowest > self._slopes[0] or bounds.highest < self._slopes[1]:
                order = order[(bounds.lowest <= slope) & (slope <= bounds.highest)]
            found.append(order)
        return np.concatenate(found)

    def _slices(self, azimuth: float, width: float) -> list[tuple[int, int]]:
        """Find the runs of sorted rays: one, or two when the interval passes the back of the circle."""
        if width >= 2.0 * np.pi * (1.0 - 2.0 / _N_BINS):
            return [(0, len(self._order))]
        first, last = _bin(np.array([azimuth, np.mod(azimuth + width + np.pi, 2.0 * np.pi) - np.pi]))
        if first <= last:
            return [(self._starts[first], self._starts[last + 1])]
        return [(self._starts[first], self._starts[_N_BINS]), (0, self._starts[last + 1])]


def bounds_of(
    box_obj: tuple[Point, Point],
    T_lidar_obj: Transform,
    twist_lidar: Twist | None,
    times: tuple[float, float],
    heights: tuple[float, float],
) -> Bounds:
    """Find the angles that a box covers at any time of a sweep.

    Args:
        box_obj: its lowest and highest corner [m].
        T_lidar_obj: its pose at time 0.
        twist_lidar: its motion relative to the sensor; None for none.
        times: first and last time of firing [s].
        heights: lowest and highest start of a ray on the sensor's axis [m].
    """
    corners, slack = se3.transform(T_lidar_obj, _corners(*box_obj)), _MARGIN
    if twist_lidar is not None:
        steps = np.repeat(np.linspace(*times, _STEPS + 1), len(corners))
        slack += motion_slack(twist_lidar, corners, (times[1] - times[0]) / _STEPS)
        corners = carried(twist_lidar, steps, np.tile(corners.T, _STEPS + 1)).T
    nearest = max(_distance_to_hull(corners[:, :2]) - slack, 0.0)
    farthest = float(np.hypot(corners[:, 0], corners[:, 1]).max()) + slack
    low, high = corners[:, 2].min() - slack - heights[1], corners[:, 2].max() + slack - heights[0]
    azimuth, width = _sector(corners[:, :2], slack, nearest)
    with np.errstate(divide="ignore"):
        lowest = np.float64(low) / (nearest if low < 0.0 else farthest)
        highest = np.float64(high) / (nearest if high > 0.0 else farthest)
    return Bounds(azimuth, width, float(lowest) - _MARGIN, float(highest) + _MARGIN, nearest)


def _bin(azimuth: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Give the bin of azimuths in [-pi, pi]."""
    return np.clip(((azimuth + np.pi) * (_N_BINS / (2.0 * np.pi))).astype(np.int64), 0, _N_BINS - 1)


def _sector(corners: Float64[np.ndarray, "n 2"], slack: float, nearest: float) -> tuple[float, float]:
    """Find the azimuth where corners begin, and the angle that they cover: all around when the axis is among them."""
    azimuth = np.sort(np.arctan2(corners[:, 1], corners[:, 0]))
    gaps = np.diff(np.concatenate([azimuth, azimuth[:1] + 2.0 * np.pi]))
    widest = int(gaps.argmax())
    if nearest == 0.0 or gaps[widest] <= np.pi:
        return -np.pi, 2.0 * np.pi
    margin = float(np.arcsin(min(slack / (nearest + slack), 1.0))) + _MARGIN
    width = 2.0 * np.pi - float(gaps[widest]) + 2.0 * margin
    begin = float(azimuth[(widest + 1) % len(azimuth)]) - margin
    return float(np.mod(begin + np.pi, 2.0 * np.pi) - np.pi), min(width, 2.0 * np.pi)


def _distance_to_hull(corners: Float64[np.ndarray, "n 2"]) -> float:
    """Measure how far the origin is from the convex hull of corners; 0 inside it."""
    azimuth = np.sort(np.arctan2(corners[:, 1], corners[:, 0]))
    gaps = np.diff(np.concatenate([azimuth, azimuth[:1] + 2.0 * np.pi]))
    if gaps.max() <= np.pi:
        return 0.0
    # Outside, the hull's nearest point lies on a side, and the sides are among the lines between any two corners.
    first, second = np.triu_indices(len(corners), 1)
    start, along = corners[first], corners[second] - corners[first]
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(-(start * along).sum(axis=1) / length, 0.0, 1.0)
    return float(np.hypot(*(start + share[:, None] * along).T).min())


def _corners(lower: Point, upper: Point) -> Points:
    """List the eight corners of a box."""
    sides = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0]), axis=-1).reshape(8, 3)
    return lower + sides * (upper - lower)
