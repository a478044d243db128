"""Rectangles on the ground: the footprints of bodies, and how far apart they are."""

import numpy as np
from jaxtyping import Float64

from registration.types import Point

Track = Float64[np.ndarray, "n 3"]  # x, y, yaw of a body's centre over time [m, m, rad]
Corners = Float64[np.ndarray, "n 4 2"]


def corners(track: Track, sizes: Float64[np.ndarray, "n 2"]) -> Corners:
    """Give the corners of rectangles (length, width) around places on the ground [m]."""
    signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return _placed(track, 0.5 * signs * sizes[:, None])


def separations(a: Corners, b: Corners) -> Float64[np.ndarray, " n"]:
    """Widest gap between two rectangles, row by row, along the normals of their sides; negative when they overlap."""
    gaps = []
    for one in (a, b):
        for i in (0, 1):
            side = one[:, i + 1] - one[:, i]
            normal = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.linalg.norm(side, axis=1)[:, None]
            in_a, in_b = (np.einsum("nkd,nd->nk", rectangle, normal) for rectangle in (a, b))
            gaps.append(np.maximum(in_a.min(axis=1) - in_b.max(axis=1), in_b.min(axis=1) - in_a.max(axis=1)))
    return np.max(gaps, axis=0)


def outline(track: Track, size: Point) -> Float64[np.ndarray, "n k 2"]:
    """Give points around a body's rectangle, no farther apart than a metre or so, over time."""
    along = np.linspace(-0.5, 0.5, max(int(np.ceil(size[0])), 1) + 1)
    across = np.linspace(-0.5, 0.5, max(int(np.ceil(size[1])), 1) + 1)
    rim = [(x, y) for x in along for y in across if abs(x) == 0.5 or abs(y) == 0.5]
    return _placed(track, np.broadcast_to(np.array(rim) * size[:2], (len(track), len(rim), 2)))


def _placed(track: Track, points: Float64[np.ndarray, "n k 2"]) -> Float64[np.ndarray, "n k 2"]:
    c, s = np.cos(track[:, 2:]), np.sin(track[:, 2:])
    x, y = points[..., 0], points[..., 1]
    return np.stack([track[:, :1] + c * x - s * y, track[:, 1:2] + s * x + c * y], axis=-1)
