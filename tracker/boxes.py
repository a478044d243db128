"""Which points lie in which box: all boxes of a frame at once."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from tracker.types import Box

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
    corners = np.array([box.corners_lidar for box in boxes])  # (b, 8, 3)
    low, high = corners.min(axis=1), corners.max(axis=1)  # (b, 3)
    candidates = _near_any_box(points_lidar, low, high)
    near = points_lidar[candidates]
    return [candidates[_inside(near, box, low[i], high[i])] for i, box in enumerate(boxes)]


def _near_any_box(
    points: Float64[np.ndarray, "n 3"], low: Float64[np.ndarray, "b 3"], high: Float64[np.ndarray, "b 3"]
) -> Int64[np.ndarray, " m"]:
    """Look each point's cell up in a raster of the cells that the boxes' bounding rectangles touch."""
    origin = low[:, :2].min(axis=0)
    extent = np.floor((high[:, :2].max(axis=0) - origin) / CELL) + 1.0
    if extent.max() > MAX_SIDE:
        return np.arange(len(points))
    shape = extent.astype(np.int64)
    marked = np.zeros((shape[0] + 1, shape[1] + 1), dtype=bool)  # the last row and column stand for outside
    first = np.floor((low[:, :2] - origin) / CELL).astype(np.int64)
    last = np.floor((high[:, :2] - origin) / CELL).astype(np.int64)
    for (x0, y0), (x1, y1) in zip(first, last, strict=True):
        marked[x0 : x1 + 1, y0 : y1 + 1] = True
    column = (points[:, 0] - origin[0]) / CELL
    row = (points[:, 1] - origin[1]) / CELL
    inside = (column >= 0) & (column < shape[0]) & (row >= 0) & (row < shape[1])
    found = np.flatnonzero(inside)
    hit = marked[column[found].astype(np.int64), row[found].astype(np.int64)]
    return found[hit]


def _inside(
    points: Float64[np.ndarray, "n 3"],
    box: Box,
    low: Float64[np.ndarray, "3"],
    high: Float64[np.ndarray, "3"],
) -> Int64[np.ndarray, " m"]:
    """Test against the box's upright bounding box first, then exactly, in the box's own axes."""
    x, y = points[:, 0], points[:, 1]
    rough = np.flatnonzero((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))
    points_obj = se3.transform(se3.invert(box.T_lidar_obj), points[rough])
    return rough[(np.abs(points_obj) <= 0.5 * box.size).all(axis=1)]
