"""Which beams of a sensor can meet an object: the others need not be fired when nothing else is of interest."""

import dataclasses

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.lidar import BeamModel
from registration.types import Transform

MARGIN = 1e-3  # on angles, for rounding [rad]


def distance_to_box(T_lidar_box: Transform, size: Float64[np.ndarray, "3"]) -> float:
    """Measure how far an upright box is from the sensor, horizontally [m]; 0 when the sensor is over or in it."""
    x, y = se3.invert(T_lidar_box)[:2, 3]
    return float(np.hypot(max(abs(x) - 0.5 * size[0], 0.0), max(abs(y) - 0.5 * size[1], 0.0)))


def beams_towards(
    beam_model: BeamModel, T_lidar_box: Transform, size: Float64[np.ndarray, "3"], slack: float = 0.0
) -> BeamModel:
    """Leave only those beams of a sensor whose elevation lets them meet a box.

    Args:
        beam_model: the sensor.
        T_lidar_box: upright pose of the box: origin at its centre.
        size: of the box [m].
        slack: how far the box may move during a sweep [m].

    Returns:
        A sensor with the same beams, in the same order, without those that pass above or below; one stays always.
    """
    nearest = distance_to_box(T_lidar_box, size) - slack
    if nearest <= 0.0:
        return beam_model
    farthest = float(np.hypot(*T_lidar_box[:2, 3])) + 0.5 * float(np.hypot(*size[:2])) + slack
    start = beam_model.per_beam("beam_heights")
    low = T_lidar_box[2, 3] - 0.5 * size[2] - slack - start
    high = T_lidar_box[2, 3] + 0.5 * size[2] + slack - start
    lowest = np.arctan2(low, np.where(low < 0.0, nearest, farthest)) - MARGIN
    highest = np.arctan2(high, np.where(high > 0.0, nearest, farthest)) + MARGIN
    meets = (lowest <= beam_model.elevations) & (beam_model.elevations <= highest)
    if not meets.any():
        meets[np.abs(beam_model.elevations - 0.5 * (lowest + highest)).argmin()] = True
    kept = {
        name: values[meets]
        for name in ("elevations", "azimuth_offsets", "beam_heights", "range_offsets")
        if (values := getattr(beam_model, name)) is not None
    }
    return dataclasses.replace(beam_model, **kept)
