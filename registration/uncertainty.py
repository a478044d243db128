"""How sure a planar registration can be: covariances of the motion (x, y, yaw) about the source centroid."""

import numpy as np
from jaxtyping import Int64

from registration.types import PlanarCovariance, Point, Points

# What is known before the clouds are looked at: an object seen in two sweeps has moved by metres at most
# (60 m/s relative to the sensor, 0.1 s), and can have turned by anything.  Also the answer for empty clouds.
UNKNOWN_SHIFT = 3.0  # standard deviation of each of x, y [m]
UNKNOWN_TURN = 1.0  # standard deviation of yaw [rad]


def unknown() -> PlanarCovariance:
    """Give the covariance of a motion nothing is known of."""
    return np.diag([UNKNOWN_SHIFT**2, UNKNOWN_SHIFT**2, UNKNOWN_TURN**2])


def of_centroids(source: Points, target: Points) -> PlanarCovariance:
    """Bound the error of the centroid difference as the motion of an object that does not turn.

    The sampled points wander over the object's visible side: between two sweeps the centroid shifts by a share
    of the object's extent, however many points there are.  The share (12 % of the cloud's standard deviation,
    and never less than 2 cm) is what simulated sequences show; a few points shift by their own sampling error.
    """
    shift = np.zeros((2, 2))
    for points in (source, target):
        if len(points) == 0:
            return unknown()
        spread = np.cov(points[:, :2].T, bias=True) if len(points) > 1 else np.eye(2)
        shift += spread * (0.12**2 + 1.0 / len(points))
    shift += 0.02**2 * np.eye(2)
    covariance = unknown()
    covariance[:2, :2] = shift
    covariance[2, 2] = 0.1**2
    return covariance


def of_pairs(
    source: Points, centroid: Point, paired: Int64[np.ndarray, " n"], rmse: float
) -> PlanarCovariance:
    """Placeholder."""
    offsets = source[paired, :2] - centroid[:2]
    information = np.zeros((3, 3))
    information[0, 0] = information[1, 1] = len(paired)
    information[0, 2] = information[2, 0] = -offsets[:, 1].sum()
    information[1, 2] = information[2, 1] = offsets[:, 0].sum()
    information[2, 2] = (offsets**2).sum()
    prior = np.linalg.inv(unknown())
    return np.linalg.inv(information / max(rmse, 0.01) ** 2 + prior)
