"""Motion in the plane, (x, y, yaw) about a centre: compose, invert, change of centre, covariance, alignment.

A motion (x, y, yaw) about centre c moves a point p to Rz(yaw) (p - c) + c + (x, y).  It means nothing without
its centre: the same rigid motion has another (x, y) about every other centre.
"""

import math

import numpy as np
from jaxtyping import Float64

from registration import se3

Motion = Float64[np.ndarray, "3"]
Covariance = Float64[np.ndarray, "3 3"]
Vector2 = Float64[np.ndarray, "2"]

RESOLUTION = 1e-9  # clouds smaller than this share of their distance from the origin are points


def wrap(angle: float) -> float:
    """Bring an angle [rad] to (-pi, pi]."""
    return float(np.pi - (np.pi - angle) % (2.0 * np.pi))


def wrap_all(angles: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
    """Bring angles [rad] to (-pi, pi]."""
    found: Float64[np.ndarray, "*n"] = np.pi - (np.pi - angles) % (2.0 * np.pi)
    return found


def rotation(yaw: float) -> Float64[np.ndarray, "2 2"]:
    """Rotate counter-clockwise by `yaw` [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def rotate_all(vectors: Float64[np.ndarray, "n 2"], yaws: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Rotate each vector counter-clockwise by its own angle [rad]."""
    c, s, (x, y) = np.cos(yaws), np.sin(yaws), vectors.T
    return np.column_stack([c * x - s * y, s * x + c * y])


def compose(second: Motion, first: Motion) -> Motion:
    """Do `first`, then `second`; both about the origin, and so is the result."""
    x, y = rotation(second[2]) @ first[:2] + second[:2]
    return np.array([x, y, wrap(second[2] + first[2])])


def invert(motion: Motion) -> Motion:
    """Undo a motion about the origin."""
    x, y = -rotation(-motion[2]) @ motion[:2]
    return np.array([x, y, wrap(-motion[2])])


def change_center(motion: Motion, old: Vector2, new: Vector2) -> Motion:
    """Describe the same rigid motion about another centre of rotation.

    t' = t + (R - I)(c' - c): AlignNet-3D's re-centring, used there before a translation is scored.
    """
    x, y = motion[:2] + (rotation(motion[2]) - np.eye(2)) @ (new - old)
    return np.array([x, y, motion[2]])


def transport_covariance(covariance: Covariance, yaw: float, old: Vector2, new: Vector2) -> Covariance:
    """Carry the covariance of a motion about `old` to the same motion about `new`, to first order.

    The Jacobian of `change_center`: an unsure turn makes far centres unsure of their displacement.
    """
    c, s, (x, y) = math.cos(yaw), math.sin(yaw), (new - old).tolist()
    J = np.array([[1.0, 0.0, -s * x - c * y], [0.0, 1.0, c * x - s * y], [0.0, 0.0, 1.0]])
    return J @ covariance @ J.T


def transport_covariances(
    covariances: Float64[np.ndarray, "n 3 3"], yaws: Float64[np.ndarray, " n"], arms: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n 3 3"]:
    """Do `transport_covariance` for many motions at once, to centres so far from the old ones."""
    J = np.tile(np.eye(3), (len(yaws), 1, 1))
    across = rotate_all(arms, yaws)
    J[:, 0, 2], J[:, 1, 2] = -across[:, 1], across[:, 0]
    found: Float64[np.ndarray, "n 3 3"] = J @ covariances @ J.transpose(0, 2, 1)
    return found


def motion_about(T_target_source: Float64[np.ndarray, "4 4"], center: Float64[np.ndarray, "3"]) -> Motion:
    """Read a planar 4x4 transform as (x, y, yaw) about a centre given in the source frame."""
    x, y = (T_target_source[:3, :3] @ center + T_target_source[:3, 3] - center)[:2]
    return np.array([x, y, se3.yaw(T_target_source)])


def to_transform(motion: Motion, center: Float64[np.ndarray, "3"], z: float = 0.0) -> Float64[np.ndarray, "4 4"]:
    """Write (x, y, yaw) about a centre, and a shift in z, as the 4x4 transform T_target_source."""
    shift = np.array([motion[0], motion[1], z])
    turn = se3.from_yaw(float(motion[2]), np.zeros(3))
    return se3.pose(turn[:3, :3], center + shift - turn[:3, :3] @ center)


def align_pairs(source: Float64[np.ndarray, "n d"], target: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "4 4"]:
    """Find the planar motion that brings each source point closest to its partner.

    Minimises the sum of squared horizontal distances over (x, y, yaw); z is neither used nor moved.
    Coincident points leave the turn undetermined: it is 0 then, and no product of rounding.

    Args:
        source: points in the source frame, (n, 2) or (n, 3) [m].
        target: their partners, row by row, in the target frame [m].

    Returns:
        T_target_source, a turn about z and a horizontal shift.

    Raises:
        ValueError: no pairs at all.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    PAMI 13(4), 1991, eq. 40-43, in two dimensions, where the turn has a closed form.
    """
    if len(source) == 0:
        raise ValueError("align_pairs needs at least 1 pair of points, got 0")
    source_mean, target_mean = source[:, :2].mean(axis=0), target[:, :2].mean(axis=0)
    a, b = source[:, :2] - source_mean, target[:, :2] - target_mean
    dot = float((a * b).sum())
    cross = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    extent = np.sqrt(min(float((a * a).sum()), float((b * b).sum())) / len(source))
    resolution = RESOLUTION * max(1.0, float(np.abs(source_mean).max()), float(np.abs(target_mean).max()))
    yaw = float(np.arctan2(cross, dot)) if extent > resolution else 0.0
    x, y = target_mean - rotation(yaw) @ source_mean
    return se3.from_yaw(yaw, np.array([x, y, 0.0]))
