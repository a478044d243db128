"""How sure a planar registration can be: covariances of the motion (x, y, yaw) about the source centroid.

The textbook covariance of point-to-point ICP, sigma^2 (J'J)^-1, counts every point as independent evidence and is
off by a factor of hundreds on sparse scans: what goes wrong is that a cloud slides along itself or snaps to the
wrong ring, all points together.  What tells the error is how much of the clouds overlaps, how large the cloud
is, and how few points there are.  The shape of the model below follows that; its constants were fitted to the
errors on two simulated streets (`regmot simulate`, seeds 1 and 2; cars, vans, persons, 3 to 80 m), such that the
normalised error squared is near its expectation in each bin of range and of size.  `regmot compare` prints it.
Only the floors of surface pairs and of features are not fitted: simulated sweeps, which motion does not distort and
whose poses are exact, would allow half of the 0.01 m that point pairs have; real ones (0000) would not.
"""

import numpy as np
from jaxtyping import Float64

from registration.types import PlanarCovariance, Points

# What is known before the clouds are looked at: between two sweeps an object moves by metres at most (60 m/s
# relative to the sensor, 0.1 s), and may have turned by anything.
UNKNOWN_SHIFT = 3.0  # standard deviation of each of x, y [m]
UNKNOWN_TURN = 1.0  # standard deviation of yaw [rad]

# Point pairs: share of the cloud's own extent by which it slides, if all of it overlaps, ...
SLIDE = 0.05
SLIDE_UNSETTLED = 0.13  # ... if the iterations ended before it came to rest, ...
SLIDE_APART = 0.7  # ... and what is added in quadrature if nothing overlaps, with the overlap squared
PAIRS_FLOOR = 0.01  # standard deviation of any shift [m]
PAIRS_SAMPLING = 0.3  # of a shift between two single points [m]
TURN_SHARE = 0.3  # a turn is this much better known than a shift, as an angle over the cloud's extent

# Surface pairs: what small_gicp's relative covariances are worth, as a factor of the information, ...
SURFACE_WEIGHT = 2.0
SURFACE_PAIRS = 2600  # ... that falls off where pairs are so many that they share their errors, ...
SURFACE_FLOOR = 0.01  # ... standard deviation that is added to any shift [m], ...
SURFACE_APART = 2.3  # ... and the share of the extent that is added if nothing overlaps, with the overlap squared

# Features: one agreeing correspondence is worth this [m], ...
FEATURES_SAMPLING = 0.14
FEATURES_FLOOR = 0.01  # ... many of them are never better than this [m], ...
FEATURES_SLIDE = 0.007  # ... nor than this share of the extent; ...
FEATURES_TURN = 0.9  # ... a turn is known as well as a shift, as an angle over the cloud's extent

# Centroids: they wander over the visible side by a share of its extent, and each point is a sample of it.
WANDER = 0.14  # share of each cloud's extent
CENTROID_SAMPLING = 0.57  # of one point about the middle of its object [m]
CENTROID_FLOOR = 0.02  # [m]
ORDINARY_TURN = 0.05  # of an object that is taken not to turn [rad]: 0.5 rad/s over 0.1 s


def unknown() -> PlanarCovariance:
    """Give the covariance of a motion nothing is known of."""
    return np.diag([UNKNOWN_SHIFT**2, UNKNOWN_SHIFT**2, UNKNOWN_TURN**2])


def of_centroids(source: Points, target: Points) -> PlanarCovariance:
    """Bound the error of the shift between two non-empty clouds' means, as the motion of an object."""
    shift = CENTROID_FLOOR**2 * np.eye(2)
    for points in (source, target):
        shift += WANDER**2 * _extent(points) + CENTROID_SAMPLING**2 / len(points) * np.eye(2)
    return _assemble(shift, ORDINARY_TURN**2)


def of_point_pairs(
    scatter: tuple[float, float, float], n_source: int, n_target: int, n_pairs: int, is_settled: bool
) -> PlanarCovariance:
    """Bound the error of a motion found by pairing nearest points; cheap, since it is asked for every pair.

    Args:
        scatter: horizontal covariance of the source's points: xx, xy, yy [m^2].
        n_source: number of points of the source.
        n_target: number of points of the target.
        n_pairs: how many source points found a partner.
        is_settled: whether the iterations came to rest.
    """
    xx, xy, yy = scatter
    apart = 1.0 - n_pairs / max(n_source, n_target)
    slide = (SLIDE if is_settled else SLIDE_UNSETTLED) ** 2 + SLIDE_APART**2 * apart**4
    sampling = PAIRS_FLOOR**2 + PAIRS_SAMPLING**2 / min(n_source, n_target)
    turn = min(TURN_SHARE**2 * (slide + sampling / max(xx + yy, 1e-6)), UNKNOWN_TURN**2)
    across = slide * xy
    return np.array([[slide * xx + sampling, across, 0.0], [across, slide * yy + sampling, 0.0], [0.0, 0.0, turn]])


def of_surface_pairs(
    information: PlanarCovariance, belief: PlanarCovariance, source: Points, target: Points, n_pairs: int
) -> PlanarCovariance:
    """Bound the error of a motion found by pairing surfaces, with a belief that decides what they leave open.

    Unlike the cost of point pairs, that of surface pairs is flat along a side: its second derivatives tell which
    way a cloud may have slid.

    Args:
        information: half the second derivatives of the cost over (x, y, yaw), without the belief's share.
        belief: covariance of what was believed beforehand.
        source: all points of the source [m].
        target: all points of the target [m].
        n_pairs: how many source points found a partner.
    """
    apart = 1.0 - n_pairs / max(len(source), len(target))
    counted = SURFACE_WEIGHT / (1.0 + n_pairs / SURFACE_PAIRS)
    covariance = np.linalg.inv(counted * information + np.linalg.inv(belief))
    covariance[:2, :2] += SURFACE_FLOOR**2 * np.eye(2) + SURFACE_APART**2 * apart**4 * _extent(source)
    return covariance


def of_features(source: Points, n_agreeing: int) -> PlanarCovariance:
    """Bound the error of a motion found by correspondences of features; what counts is how many of them agree.

    Args:
        source: all points of the source [m].
        n_agreeing: how many correspondences agree with the motion; at least one.
    """
    extent = _extent(source)
    single = FEATURES_FLOOR**2 + FEATURES_SAMPLING**2 / n_agreeing
    turn = FEATURES_TURN**2 * single / max(float(np.trace(extent)), 1e-6)
    return _assemble(single * np.eye(2) + FEATURES_SLIDE**2 * extent, min(turn, UNKNOWN_TURN**2))


def _extent(points: Points) -> Float64[np.ndarray, "2 2"]:
    """Give the horizontal scatter of a non-empty cloud about its mean [m^2]."""
    offsets = points[:, :2] - points[:, :2].mean(axis=0)
    return offsets.T @ offsets / len(points)


def _assemble(shift: Float64[np.ndarray, "2 2"], turn: float) -> PlanarCovariance:
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = shift
    covariance[2, 2] = turn
    return covariance
