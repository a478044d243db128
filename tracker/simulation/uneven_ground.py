"""The ground under labelled objects: nobody measured it, so it is what they stand on."""

import numpy as np
from jaxtyping import Float64, Int64

from registration import se3
from registration.synthetic.meshes import Material, Mesh
from registration.types import Points
from tracker.types import Box

CELL = 0.5  # side of a square of the ground's mesh [m]
MARGIN = 1.5  # how far the ground reaches around a box [m]

# How far what is known of the ground may be off, for the plane: below the sensor, its slopes, below a box.
SENSOR_DEVIATION, SLOPE_DEVIATION, BOX_DEVIATION = 0.05, 0.02, 0.15  # [m, -, m]
_ROBUST_ROUNDS, _ROBUST_LIMIT = 5, 1.5  # of Huber's weights [deviations]

# Near a box the ground is at the box's bottom, far from all of them it is the plane.
NEAR, FAR = 0.5, 6.0  # [m]

Plane = Float64[np.ndarray, "3"]  # z = plane @ (x, y, 1)


def ground_mesh(boxes: tuple[Box, ...], sensor_height: float) -> Mesh:
    """Lay ground under and around boxes, in the sensor's axes; elsewhere there is none.

    Args:
        boxes: what stands on the ground.
        sensor_height: of the sensor above the ground below it [m].
    """
    cells = _cells_near(boxes)
    squares = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners, index = np.unique((cells[:, None] + squares).reshape(-1, 2), axis=0, return_inverse=True)
    index = index.reshape(-1, 4)
    xy = CELL * corners.astype(np.float64)
    vertices = np.column_stack([xy, ground_height(xy, boxes, sensor_height)])
    triangles = index[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int64)
    return Mesh(vertices, triangles, np.full(len(triangles), int(Material.ASPHALT)))


def ground_height(
    xy: Float64[np.ndarray, "n 2"], boxes: tuple[Box, ...], sensor_height: float
) -> Float64[np.ndarray, " n"]:
    """Give the ground's height at places: under a box it is at its bottom, far from all boxes on a plane [m].

    The plane goes through the point below the sensor and the bottoms of the boxes, as well as it can; what each
    bottom is off the plane is blended between the boxes, the nearer the heavier (Shepard's interpolation).
    """
    bottoms = np.array([box.center_lidar - [0.0, 0.0, 0.5 * box.size[2]] for box in boxes]).reshape(-1, 3)
    plane = fit_plane(bottoms, sensor_height)
    off = bottoms[:, 2] - _at(plane, bottoms[:, :2])
    distances = np.stack([distance_to(box, xy) for box in boxes], axis=1) if boxes else np.zeros((len(xy), 0))
    weights = 1.0 / (distances**2 + NEAR**2) ** 2
    return _at(plane, xy) + weights @ off / (weights.sum(axis=1) + 1.0 / FAR**4)


def fit_plane(bottoms: Points, sensor_height: float) -> Plane:
    """Fit a plane to the bottoms of boxes and to what is known without any, with Huber's weights on the former."""
    x, y, z = bottoms.T
    rows = np.column_stack([x, y, np.ones(len(x))]) / BOX_DEVIATION
    prior = np.diag([1.0 / SLOPE_DEVIATION, 1.0 / SLOPE_DEVIATION, 1.0 / SENSOR_DEVIATION])
    wanted = np.array([0.0, 0.0, -sensor_height / SENSOR_DEVIATION])
    weights = np.ones(len(x))
    for _ in range(_ROBUST_ROUNDS):
        weighted = weights[:, None] * rows
        plane = np.linalg.solve(
            prior.T @ prior + weighted.T @ rows, prior.T @ wanted + weighted.T @ (z / BOX_DEVIATION)
        )
        off = np.abs(rows @ plane - z / BOX_DEVIATION)
        weights = _ROBUST_LIMIT / np.maximum(off, _ROBUST_LIMIT)
    return plane


def distance_to(box: Box, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Give the horizontal distance from places to a box; 0 inside [m]."""
    points = np.column_stack([xy, np.zeros(len(xy))])
    inside = se3.transform(se3.invert(box.T_lidar_obj), points)[:, :2]
    outside = np.maximum(np.abs(inside) - 0.5 * box.size[:2], 0.0)
    return np.hypot(outside[:, 0], outside[:, 1])


def _at(plane: Plane, xy: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    return xy @ plane[:2] + plane[2]


def _cells_near(boxes: tuple[Box, ...]) -> Int64[np.ndarray, "n 2"]:
    """List the squares of a grid around the sensor's origin whose middles are near a box."""
    cells = [np.zeros((0, 2), dtype=np.int64)]
    for box in boxes:
        corners = box.corners_lidar[:, :2]
        low = np.floor((corners.min(axis=0) - MARGIN) / CELL).astype(np.int64)
        high = np.ceil((corners.max(axis=0) + MARGIN) / CELL).astype(np.int64)
        grid = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1)
        around = grid.reshape(-1, 2)
        cells.append(around[distance_to(box, CELL * (around + 0.5)) < MARGIN])
    return np.unique(np.concatenate(cells), axis=0)
