"""Steady motion in space: twists, the poses they lead to, and the twist that leads from one pose to another."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from registration import se3
from registration.errors import SimulationError
from registration.types import Point, Points, Transform

Columns = Float64[np.ndarray, "3 n"]  # rows of x, y and z
Twist = Float64[np.ndarray, "6"]  # (vx, vy, vz) of the point at the origin [m/s], (wx, wy, wz) [rad/s]


def pose_after(twist: Twist, duration: float) -> Transform:
    """Follow a twist for some time [s]: exp(duration * twist)."""
    corner = carried(twist, np.full(4, duration), np.array([[0.0, 1.0, 0.0, 0.0], [0, 0, 1, 0], [0, 0, 0, 1]]))
    return se3.pose(corner[:, 1:] - corner[:, :1], corner[:, 0])


def carried(twist: Twist, durations: Float64[np.ndarray, " n"], points: Columns) -> Columns:
    """Carry points along a twist, each for its own time [s]: exp(duration * twist) point.

    Points are columns here: a sweep has many, and whole rows of x, y and z are what numpy is fast at.

    Source: Murray, Li & Sastry, "A mathematical introduction to robotic manipulation", 1994, eq. 2.14 and 2.36.
    """
    velocity, rate = twist[:3], float(np.linalg.norm(twist[3:]))
    if rate == 0.0:
        return points + durations * velocity[:, None]
    axis = twist[3:] / rate
    angle = rate * durations
    # 1 - cos = 2 sin^2 of the half, and angle - sin from its series where it would cancel.
    sine, versine = np.sin(angle), 2.0 * np.square(np.sin(0.5 * angle))
    lag = np.where(np.abs(angle) < 1e-3, angle**3 / 6.0, angle - sine)
    across = _crossed(axis, velocity[:, None])
    slip = durations * velocity[:, None] + (versine * across + lag * _crossed(axis, across)) / rate
    once = _crossed(axis, points)
    return points + sine * once + versine * _crossed(axis, once) + slip


def twist_between(T_before: Transform, T_after: Transform, dt: float) -> Twist:
    """Find the steady motion that leads from one pose to another: exp(dt * twist) T_before = T_after.

    The logarithm of T_after T_before^-1 over dt, in the axes of the frame that both poses are given in.  A turn of
    half a revolution or more within dt is taken for the shorter one.

    Args:
        T_before: pose at some time.
        T_after: pose `dt` later, in the same frame.
        dt: time between them [s].

    Raises:
        SimulationError: no time lies between them.

    Source: Murray, Li & Sastry, 1994, proposition 2.9.
    """
    if not dt > 0.0:
        raise SimulationError(f"a twist needs a time dt > 0 between two poses, got {dt}")
    T = T_after @ se3.invert(T_before)
    turn = Rotation.from_matrix(se3.nearest_rotation(T[:3, :3])).as_rotvec()
    angle = float(np.linalg.norm(turn))
    K = _cross(turn)
    # V^-1 = 1 - K/2 + c K^2; its c has the limit 1/12.
    c = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    shift = T[:3, 3] - 0.5 * K @ T[:3, 3] + c * (K @ K @ T[:3, 3])
    return np.concatenate([shift, turn]) / dt


def motion_slack(twist: Twist, points: Points, step: float) -> float:
    """Bound how far points leave the straight lines between their places every `step` [s] [m].

    Args:
        twist: their motion.
        points: where they are at some time [m].
        step: time between two places [s].
    """
    speed, rate = float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))
    reach = float(np.linalg.norm(points, axis=1).max())
    return rate * (rate * reach + speed) * step**2 / 8.0


def _crossed(axis: Point, vectors: Columns) -> Columns:
    """Multiply an axis with each vector: the cross product."""
    (a, b, c), (x, y, z) = axis, vectors
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])


def _cross(axis: Point) -> Float64[np.ndarray, "3 3"]:
    """Write the cross product with a vector as a matrix."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
