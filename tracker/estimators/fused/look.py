"""What is kept of one look at an object."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from registration.alignnet.method import AlignNetCars, AlignNetPersons, Cloud
from registration.synthetic.lidar import beam_model, firing_lags
from registration.types import Points
from tracker.estimators.contract import Sighting
from tracker.estimators.fused.sensor import SWEEP, Sensor
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

    def is_told_by(self, network: Networks) -> bool:
        """Say whether that network made it, and there were points enough for it to tell anything."""
        return self.network is network and self.cloud.encodings is not None

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
        middle: of the box around them, before any shift (2) [m].
        sensor: that saw them.
        shift: what was added to their places, since the sensor moved on until its beams passed them (2) [m]; in a world
            only, and where scans are raw sweeps.
        passed: when the beams passed each point, after the time of the frame [s]; None where all points are of one
            instant.
        is_timed: whether it is known when each point was seen: all are of one instant, or their lasers are known.
        learned: what the network makes of it.
        frame: number of the frame in its sequence.
        time: when the beams passed the middle [s].
        delay: how long after the time of the frame that was [s]; 0 where all points are of one instant.
        clock: time that velocities count by [s]: that of the frame, or of the look where they are to be over that.
        is_torn: a part was seen at the end of the sweep, and the rest at its start.
        late: how long after what the clock tells the beams met the object's centre [s]; see `Track.note_met`.
        past_end: how far that is past the direction in which sweeps end [m]; NaN where that does not matter.
    """

    points: Points
    n_points: int
    n_from_1m: float
    middle: Vector
    sensor: Sensor
    shift: Vector
    passed: Float64[np.ndarray, " n"] | None
    is_timed: bool
    learned: Encoding
    frame: int
    time: float
    delay: float
    clock: float
    is_torn: bool = False
    late: float = 0.0
    past_end: float = math.nan

    def seen_by(self, sensor: Sensor) -> "Look":
        """Put its points to where the beams met them, by a sensor that moves as is now known; nothing to do where all
        points are of one instant.

        Args:
            sensor: that saw them.
        """
        if self.passed is None:
            return self
        shift = self.delay * sensor.carried(self.middle)
        points = self.points.copy()
        points[:, :2] += shift - self.shift
        return replace(self, points=points, sensor=sensor, shift=shift)

    def straightened(self, velocity: Vector) -> "Look":
        """Undo what the object moved while the beams passed it, up to a decimetre at its ends when it is close.

        Its points go to where they were at the time of the look.

        Args:
            velocity: of the object relative to the sensor [m/s].
        """
        if self.passed is None:
            return self
        points = self.points.copy()
        points[:, :2] += (self.delay - self.passed)[:, None] * velocity
        return replace(self, points=points, passed=None)


def looked_at(sighting: Sighting, sensor: Sensor, learned: Encoding, knows_lasers: bool) -> Look:
    """Make a look of what is seen of an object.

    Args:
        sighting: of it.
        sensor: that saw it.
        learned: what the network makes of it.
        knows_lasers: whether it is known when each laser fires, if it is known which sensor's they are.
    """
    points, middle, delay, is_torn = thinned(sighting.points), sighting.midpoint[:2], 0.0, False
    passed, is_timed, time = None, True, sighting.timestamp
    if sighting.is_swept:
        lags, is_timed = _timing(sighting, knows_lasers)
        delay = float(sensor.delays(middle[None])[0])
        passed = sensor.delays(points[:, :2], lags)
        is_torn = bool(np.ptp(passed) > 0.5 * SWEEP.period)
        time = sighting.frame_timestamp + delay
    look = Look(
        points=points,
        n_points=len(sighting.points),
        n_from_1m=len(sighting.points) * sighting.range_m**2,
        middle=middle,
        sensor=sensor,
        shift=np.zeros(2),
        passed=passed,
        is_timed=is_timed,
        learned=learned,
        frame=sighting.frame,
        time=time,
        delay=delay,
        clock=time if sighting.is_timed_by_look else sighting.timestamp,
        is_torn=is_torn,
    )
    return look.seen_by(sensor)


def _timing(sighting: Sighting, knows_lasers: bool) -> tuple[Float64[np.ndarray, " n"], bool]:
    """Give how much later than the sensor's head each laser fired, and `Look.is_timed`; unknown lasers have no lags."""
    points_lidar = thinned(sighting.points_lidar)
    lasers = sighting.lasers if knows_lasers else None
    lags = None if lasers is None else firing_lags(points_lidar, beam_model(lasers))
    return np.zeros(len(points_lidar)) if lags is None else lags, lags is not None


def thinned(points: Points, most: int = KEPT_POINTS) -> Points:
    """Keep every k-th point, so that a look takes up no more memory and time than it is worth."""
    return points if len(points) <= most else np.ascontiguousarray(points[:: -(-len(points) // most)])
