"""Which laser of a spinning sensor saw a point, and how much later it did so than the sensor's head pointed there."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from registration.synthetic.lidar.beams import BeamModel, Turn
from registration.types import Points

ON_RING = float(np.deg2rad(0.03))  # of a laser's elevation: points of KITTI's scans leave it by 0.001 degrees
LEAST_SHARE = 0.9  # of points that lie on rings, for them to be taken for those of a sensor


def ring_of(points_lidar: Points, beam_model: BeamModel) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Tell the laser that saw each point, as a row of the beam table, and how far off its elevation the point is [rad].

    Args:
        points_lidar: as they were seen, in the sensor's axes (n, 3) [m].
        beam_model: the sensor.
    """
    heights, order = beam_model.per_beam("beam_heights"), np.argsort(beam_model.elevations)
    elevations = beam_model.elevations[order]
    between = np.tan(0.5 * (elevations[1:] + elevations[:-1]))
    x, y, z = points_lidar.T
    r = np.sqrt(x * x + y * y)
    ring = np.full(len(points_lidar), order[len(order) // 2])
    for _ in range(3):  # lasers differ in height, by a tenth of a metre and in two blocks
        ring = order[np.searchsorted(between, (z - heights[ring]) / r)]
    return ring, np.arctan2(z - heights[ring], r) - beam_model.elevations[ring]


def firing_lags(clouds: Sequence[Points], beam_model: BeamModel) -> list[Float64[np.ndarray, " _"] | None]:
    """Give how much later each point was seen than the sensor's head pointed to its azimuth [s].

    Lasers that fire together look to different sides: those of an HDL-64E are up to 18 degrees apart, 5 ms.

    Args:
        clouds: one at least, as they were seen, in the sensor's axes, (n, 3) each [m].
        beam_model: the sensor.

    Returns:
        (n) for each cloud; None where its points do not lie on the sensor's rings: they are another one's.
    """
    ring, off = ring_of(np.concatenate(clouds), beam_model)
    sense = 1.0 if beam_model.turn is Turn.CLOCKWISE else -1.0
    lags = (sense * beam_model.period / (2.0 * np.pi) * beam_model.per_beam("azimuth_offsets"))[ring]
    is_on, ends, found = np.abs(off) < ON_RING, np.cumsum([len(cloud) for cloud in clouds]), []
    for cloud, end in zip(clouds, ends.tolist(), strict=True):
        own = slice(end - len(cloud), end)
        found.append(lags[own] if np.count_nonzero(is_on[own]) >= LEAST_SHARE * len(cloud) else None)
    return found
