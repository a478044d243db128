"""What is kept of one look at an object."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration.alignnet.method import AlignNetCars, AlignNetPersons, Cloud
from registration.neighbours import pack_arrays
from registration.synthetic.lidar import Rings, beam_model, firing_lags, rings
from registration.types import Points
from tracker.estimators.contract import Sighting
from tracker.estimators.fused import sensor_kernels
from tracker.estimators.fused.sensor import SWEEP, TURNS, Sensor
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


class Look(NamedTuple):
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
        mean: of the points that the network was shown, with the shift (x, y) [m].
        frame: number of the frame in its sequence.
        time: when the beams passed the middle [s].
        delay: how long after the time of the frame that was [s]; 0 where all points are of one instant.
        clock: time that velocities count by [s]: that of the frame, or of the look where they are to be over that.
        is_torn: a part was seen at the end of the sweep, and the rest at its start.
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
    mean: tuple[float, float]
    frame: int
    time: float
    delay: float
    clock: float
    is_torn: bool = False

    def seen_by(self, sensor: Sensor) -> "Look":
        """Put its points to where the beams met them, by a sensor that moves as is now known; nothing to do where all
        points are of one instant.

        Args:
            sensor: that saw them.
        """
        if self.passed is None:
            return self
        shift = self.delay * sensor.carried(self.middle[None])[0]
        points = self.points.copy()
        points[:, :2] += shift - self.shift
        mean = _mean(self.learned, shift)
        return self._replace(points=points, sensor=sensor, shift=shift, mean=mean)

    def straightened(self, velocity: Vector) -> "Look":
        """Undo what the object moved while the beams passed it, up to a decimetre at its ends when it is close.

        Its points go to where they were at the time of the look.

        Args:
            velocity: of the object relative to the sensor [m/s].
        """
        if self.passed is None:
            return self
        points = sensor_kernels.straighten(self.points, self.passed, self.delay, *velocity.tolist())
        return self._replace(points=points, passed=None)


def looked_at(
    sightings: Sequence[Sighting], sensor: Sensor, learned: Sequence[Encoding], knows_lasers: bool
) -> list[Look]:
    """Make looks of what is seen of a frame's objects.

    Args:
        sightings: one at least; either all are of a raw sweep, or none is.
        sensor: that saw them.
        learned: what the network makes of each.
        knows_lasers: whether it is known when each laser fires, if it is known which sensor's they are.
    """
    clouds = [thinned(sighting.points) for sighting in sightings]
    met = _met(sightings, clouds, sensor, knows_lasers) if sightings[0].is_swept else map(_at_once, clouds)
    return [
        Look(
            points=each.points,
            n_points=len(sighting.points),
            n_from_1m=len(sighting.points) * sighting.range_m**2,
            middle=sighting.midpoint[:2],
            sensor=sensor,
            shift=each.shift,
            passed=each.passed,
            is_timed=each.is_timed,
            learned=encoding,
            mean=_mean(encoding, each.shift),
            frame=sighting.frame,
            time=(time := sighting.timestamp if each.passed is None else sighting.frame_timestamp + each.delay),
            delay=each.delay,
            clock=time if sighting.is_timed_by_look else sighting.timestamp,
            is_torn=each.is_torn,
        )
        for sighting, encoding, each in zip(sightings, learned, met, strict=True)
    ]


def _mean(learned: Encoding, shift: Vector) -> tuple[float, float]:
    x, y = (learned.cloud.centroid[:2] + shift).tolist()
    return x, y


class _Met(NamedTuple):
    """Where and when the beams met the points of a look; see `Look`."""

    points: Points
    shift: Vector
    passed: Float64[np.ndarray, " n"] | None
    is_timed: bool
    delay: float
    is_torn: bool


def _at_once(points: Points) -> _Met:
    return _Met(points, np.zeros(2), None, True, 0.0, False)


def _met(sightings: Sequence[Sighting], clouds: Sequence[Points], sensor: Sensor, knows_lasers: bool) -> Iterator[_Met]:
    """Put points of a raw sweep to where the beams met them."""
    points, begin = pack_arrays(clouds)
    points = points.copy() if len(clouds) == 1 else points
    lags, is_timed = _lags(sightings, begin, knows_lasers)
    middles = np.array([sighting.midpoint[:2] for sighting in sightings])
    passed, delays, shifts, took = sensor_kernels.meet(points, begin, lags, middles, sensor.numbers(), TURNS)
    is_torn = took > 0.5 * SWEEP.period
    own = list(pairwise(begin.tolist()))
    parts = [points[a:b] for a, b in own], list(shifts), [passed[a:b] for a, b in own]
    return map(_Met, *parts, is_timed.tolist(), delays.tolist(), is_torn.tolist())


def _lags(
    sightings: Sequence[Sighting], begin: Int64[np.ndarray, " _"], knows_lasers: bool
) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " k"]]:
    """Give how much later than the sensor's head each laser fired; 0 where nobody knows, and for which looks one does.

    Args:
        sightings: k of them, with n points in all.
        begin: where the points of each begin.
        knows_lasers: whether it is known when each laser fires, if it is known which sensor's they are.
    """
    lasers = sightings[0].lasers if knows_lasers else None  # those of a frame are one sensor's
    if lasers is None:
        return np.zeros(begin[-1]), np.zeros(len(sightings), dtype=np.bool_)
    points, _ = pack_arrays([thinned(sighting.points_lidar) for sighting in sightings])
    return firing_lags(points, begin, _rings(lasers))


@cache
def _rings(lasers: str) -> Rings:
    return rings(beam_model(lasers))


def thinned(points: Points, most: int = KEPT_POINTS) -> Points:
    """Keep every k-th point, so that a look takes up no more memory and time than it is worth."""
    return points if len(points) <= most else np.ascontiguousarray(points[:: -(-len(points) // most)])
