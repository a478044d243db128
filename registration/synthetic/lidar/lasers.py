"""Which laser of a spinning sensor saw a point, and how much later it did so than the sensor's head pointed there."""

import math
import typing
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numba import njit

from registration.synthetic.lidar.beams import BeamModel, Turn
from registration.types import Points

ON_RING = float(np.deg2rad(0.03))  # of a laser's elevation: points of KITTI's scans leave it by 0.001 degrees
LEAST_SHARE = 0.9  # of points that lie on rings, for them to be taken for those of a sensor

Lasers = Float64[np.ndarray, " lasers"]


class Rings(NamedTuple):
    """A sensor's lasers, from the lowest to the highest.

    Attributes:
        order: their rows in the beam table.
        elevations: [rad].
        heights: where on the axis they start [m].
        lags: how much later they see something than the sensor's head pointed to its azimuth [s].
        between: slopes half-way from each to the next.
    """

    order: Int64[np.ndarray, " lasers"]
    elevations: Lasers
    heights: Lasers
    lags: Lasers
    between: Float64[np.ndarray, " gaps"]


def rings(beam_model: BeamModel) -> Rings:
    """Put the lasers of a sensor in order."""
    order = np.argsort(beam_model.elevations)
    elevations = beam_model.elevations[order]
    sense = 1.0 if beam_model.turn is Turn.CLOCKWISE else -1.0
    return Rings(
        order=order,
        elevations=elevations,
        heights=beam_model.per_beam("beam_heights")[order],
        lags=sense * beam_model.period / (2.0 * np.pi) * beam_model.per_beam("azimuth_offsets")[order],
        between=np.tan(0.5 * (elevations[1:] + elevations[:-1])),
    )


def ring_of(points_lidar: Points, beam_model: BeamModel) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Tell the laser that saw each point, as a row of the beam table, and how far off its elevation the point is [rad].

    Args:
        points_lidar: as they were seen, in the sensor's axes (n, 3) [m].
        beam_model: the sensor.
    """
    own = rings(beam_model)
    numbers, off = _told(np.ascontiguousarray(points_lidar), *own[1:3], own.between)
    return own.order[numbers], off


def firing_lags(
    points_lidar: Points, begin: Int64[np.ndarray, " _"], own: Rings
) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " k"]]:
    """Give how much later each point was seen than the sensor's head pointed to its azimuth [s].

    Lasers that fire together look to different sides: those of an HDL-64E are up to 18 degrees apart, 5 ms.

    Args:
        points_lidar: of K clouds, one after the other, as they were seen, in the sensor's axes (n, 3) [m].
        begin: cloud k is rows begin[k] to begin[k + 1].
        own: the sensor's lasers.

    Returns:
        the lags, and for which clouds they are known: others do not lie on the sensor's rings and are another one's;
        their lags are 0.
    """
    numbers, off = _told(np.ascontiguousarray(points_lidar), *own[1:3], own.between)
    return _lags(numbers, off, begin, own.lags)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _told(points, elevations, heights, between):
    """Tell the laser that saw each point, by its place in the order, and how far off its elevation the point is [rad].

    Args:
        points: (n, 3) [m].
        elevations, heights, between: see `Rings`.
    """
    numbers, off = np.empty(len(points), np.int64), np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        r, k = math.sqrt(x * x + y * y), len(heights) // 2
        for step in range(3):  # lasers differ in height, by a tenth of a metre and in two blocks
            slope = (z - heights[k]) / r
            if step == 0:
                k = np.searchsorted(between, slope)
            while k < len(between) and between[k] < slope:
                k += 1
            while k > 0 and between[k - 1] >= slope:
                k -= 1
        numbers[i], off[i] = k, math.atan2(z - heights[k], r) - elevations[k]
    return numbers, off


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _lags(numbers, off, begin, own):
    """Give the lag of each point, and which clouds lie on rings; see `firing_lags`."""
    lags, is_known = np.zeros(len(numbers)), np.empty(len(begin) - 1, np.bool_)
    for k in range(len(is_known)):
        n = 0
        for i in range(begin[k], begin[k + 1]):
            n += 1 if abs(off[i]) < ON_RING else 0
        is_known[k] = n >= LEAST_SHARE * (begin[k + 1] - begin[k])
        for i in range(begin[k], begin[k + 1] if is_known[k] else begin[k]):
            lags[i] = own[numbers[i]]
    return lags, is_known
