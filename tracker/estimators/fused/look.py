"""What is kept of one look at an object."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from registration.alignnet.method import AlignNetCars, AlignNetPersons, Cloud
from registration.synthetic.lidar import beam_model, firing_lags
from registration.types import Points
from tracker.estimators.contract import Sighting
from tracker.estimators.fused.sensor import SWEEP_PERIOD, Sensor
from tracker.estimators.fused.window import Vector

Networks = AlignNetCars | AlignNetPersons

KEPT_POINTS = 2000  # of a look, at most


@dataclass(frozen=True, slots=True)
class Encoding:
    """What a network makes of one look.

    Attributes:
        network: the one that made it.
        cloud: its own encoding.
    """

    network: Networks
    cloud: Cloud

    def center(self) -> Vector | None:
        """Say where the network believes the object's centre (x, y) [m]; None where it cannot tell."""
        center = self.network.center(self.cloud)
        return None if center is None else center[:2]


@dataclass(frozen=True, slots=True)
class Look:
    """What is kept of one look at an object.

    Attributes:
        points: thinned [m].
        n_points: how many there were.
        n_from_1m: how many there would be, seen from 1 m.
        sensor: that saw them.
        shift: what was added to their places, since the sensor moved on until its beams passed them (2) [m]; in a world
            only, and where scans are raw sweeps.
        lags: how much later each point was seen than the sensor's head pointed to it [s]; None where all points are of
            one instant.
        is_timed: whether it is known when each point was seen: all are of one instant, or their lasers are known.
        learned: what the network makes of it.
        frame: number of the frame in its sequence.
        is_torn: a part was seen at the end of the sweep, and the rest at its start.
    """

    points: Points
    n_points: int
    n_from_1m: float
    sensor: Sensor
    shift: Vector
    lags: Float64[np.ndarray, " n"] | None
    is_timed: bool
    learned: Encoding
    frame: int
    is_torn: bool = False

    def seen_by(self, sensor: Sensor, center: Vector) -> "Look":
        """Put its points to where the beams met them, by a sensor that moves as is now known; nothing to do where all
        points are of one instant.

        Args:
            sensor: that saw them.
            center: of the object [m].
        """
        if self.lags is None:
            return self
        shift, delays = sensor.missed(center), sensor.delays(self.points[:, :2] - self.shift, self.lags)
        points = self.points.copy()
        points[:, :2] += shift - self.shift
        return replace(
            self, points=points, sensor=sensor, shift=shift, is_torn=bool(np.ptp(delays) > 0.5 * SWEEP_PERIOD)
        )

    def straightened(self, velocity: Vector, center: Vector) -> "Look":
        """Undo what the object moved while the beams passed it, up to a decimetre at its ends when it is close.

        Args:
            velocity: of the object relative to the sensor [m/s].
            center: of the object: its points go to where they were when the beams passed it [m].
        """
        if self.lags is None:
            return self
        points = self.points.copy()
        passed = self.sensor.delays(points[:, :2] - self.shift, self.lags)
        points[:, :2] += (self.sensor.delays((center - self.shift)[None]) - passed)[:, None] * velocity
        return replace(self, points=points, lags=None)


def lags_of(sighting: Sighting, knows_lasers: bool) -> tuple[Float64[np.ndarray, " n"] | None, bool]:
    """Give `Look.lags` and `Look.is_timed`, before a look is straightened; unknown lasers have no lags."""
    if not sighting.is_swept:
        return None, True
    points_lidar = thinned(sighting.points_lidar)
    lasers = sighting.lasers if knows_lasers else None
    lags = None if lasers is None else firing_lags(points_lidar, beam_model(lasers))
    return np.zeros(len(points_lidar)) if lags is None else lags, lags is not None


def thinned(points: Points, most: int = KEPT_POINTS) -> Points:
    """Keep every k-th point, so that a look takes up no more memory and time than it is worth."""
    return points if len(points) <= most else np.ascontiguousarray(points[:: -(-len(points) // most)])
