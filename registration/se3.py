"""Rigid transforms as 4x4 matrices: `T_dst_src` maps src coordinates to dst, clouds are (N, 3) rows."""

import numpy as np
from jaxtyping import Float64


def pose(R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Put a rotation and an origin together: R_dst_src and t_dst_src make T_dst_src."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def from_yaw(yaw: float, t: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Turn counter-clockwise about +z by `yaw` [rad], then shift by `t` [m]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return pose(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), t)


def invert(T: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 4 4"]:
    """Give T_src_dst for T_dst_src; the rotation part must be orthonormal."""
    R_inverse = np.swapaxes(T[..., :3, :3], -1, -2)
    inverse = np.zeros_like(T)
    inverse[..., :3, :3] = R_inverse
    inverse[..., :3, 3] = -(R_inverse @ T[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def transform(T_dst_src: Float64[np.ndarray, "4 4"], points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Move points given in src to dst."""
    return points @ T_dst_src[:3, :3].T + T_dst_src[:3, 3]


def yaw(T: Float64[np.ndarray, "4 4"]) -> float:
    """Heading of the transform's x-axis, counter-clockwise about +z, in (-pi, pi]."""
    return float(np.arctan2(T[1, 0], T[0, 0]))


def nearest_rotation(M: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    """Find the rotation closest to a matrix that rounding has bent a little (det +1 always)."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
