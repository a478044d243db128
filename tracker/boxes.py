"""Which points lie in which box: all boxes of a frame at once."""

import typing
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64
from numba import njit

from registration import se3
from tracker.types import Box

ROUNDING = 1e-9  # relative to coordinates
CELL = 0.5  # side of the raster's cells [m]: small beside a car, and 120 m of them still fit a cache
MAX_SIDE = 2000  # cells, 1 km: boxes farther apart are no scan's, and are searched for without a raster


def points_in_boxes(points_lidar: Float64[np.ndarray, "n 3"], boxes: Sequence[Box]) -> list[Int64[np.ndarray, " _"]]:
    """Find the points of each box, borders included.

    A raster of the ground marks the cells that any box may touch, so that the scan is looked at once and only
    the few points on marked cells are tested against the boxes near them.  A point in two boxes belongs to both.

    Args:
        points_lidar: the scan [m].
        boxes: the boxes of the frame.

    Returns:
        for each box the rows of its points, ascending.
    """
    if not boxes or len(points_lidar) == 0:
        return [np.empty(0, dtype=np.int64) for _ in boxes]
    T_lidar_obj = np.array([box.T_lidar_obj for box in boxes])
    half = 0.5 * np.array([box.size for box in boxes])
    low, high = _around(T_lidar_obj, half)
    points = np.ascontiguousarray(points_lidar)
    candidates = _near_any_box(points, low, high)
    return [
        _in_box(points, candidates, low[i], high[i], T_obj_lidar, half[i])
        for i, T_obj_lidar in enumerate(se3.invert(T_lidar_obj))
    ]


def _around(
    T_lidar_obj: Float64[np.ndarray, "b 4 4"], half: Float64[np.ndarray, "b 3"]
) -> tuple[Float64[np.ndarray, "b 3"], Float64[np.ndarray, "b 3"]]:
    """Give the corners of each box's upright bounding box, a little outside, so that rounding hides no point."""
    center = T_lidar_obj[:, :3, 3]
    reach = (np.abs(T_lidar_obj[:, :3, :3]) @ half[:, :, None])[:, :, 0]
    margin = ROUNDING * (np.abs(center) + reach)
    return center - reach - margin, center + reach + margin


def _near_any_box(
    points: Float64[np.ndarray, "n 3"], low: Float64[np.ndarray, "b 3"], high: Float64[np.ndarray, "b 3"]
) -> Int64[np.ndarray, " m"]:
    """Look each point's cell up in a raster of the cells that the boxes' bounding rectangles touch."""
    origin = low[:, :2].min(axis=0)
    extent = np.floor((high[:, :2].max(axis=0) - origin) / CELL) + 1.0
    if extent.max() > MAX_SIDE:
        return np.arange(len(points))
    marked = np.zeros(extent.astype(np.int64), dtype=bool)
    first = np.floor((low[:, :2] - origin) / CELL).astype(np.int64)
    last = np.floor((high[:, :2] - origin) / CELL).astype(np.int64)
    for (x0, y0), (x1, y1) in zip(first, last, strict=True):
        marked[x0 : x1 + 1, y0 : y1 + 1] = True
    return _on_marked_cells(points, origin, marked)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _on_marked_cells(points, origin, marked):
    """Give the rows of the points whose cell is marked, ascending."""
    n_x, n_y = marked.shape
    x_0, y_0 = origin
    rows, n = np.empty(len(points), np.int64), 0
    for i in range(len(points)):  # free of branches: where a point lies is hard to foretell
        x, y = (points[i, 0] - x_0) / CELL, (points[i, 1] - y_0) / CELL
        is_on_raster = (x >= 0.0) & (x < n_x) & (y >= 0.0) & (y < n_y)
        is_marked = marked[int(x if is_on_raster else 0.0), int(y if is_on_raster else 0.0)]
        rows[n] = i
        n += is_on_raster & is_marked
    return rows[:n].copy()


@njit(cache=True, nogil=True)
@typing.no_type_check
def _in_box(points, candidates, low, high, T_obj_lidar, half):
    """Keep the candidates in a box: those in its upright bounding box are tested exactly, in the box's own axes."""
    rows, n = np.empty(len(candidates), np.int64), 0
    x_low, y_low, x_high, y_high, T = low[0], low[1], high[0], high[1], T_obj_lidar
    for i in candidates:
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if (x >= x_low) & (x <= x_high) & (y >= y_low) & (y <= y_high):
            is_in = True
            for axis in range(3):
                is_in &= abs(T[axis, 0] * x + T[axis, 1] * y + T[axis, 2] * z + T[axis, 3]) <= half[axis]
            rows[n] = i
            n += is_in
    return rows[:n].copy()
