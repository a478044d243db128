"""Where the sensor is in one frame, how it moves, and when its beams pass a place."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from registration import planar
from tracker.estimators.fused.window import Vector

SWEEP_PERIOD = 0.1  # of a sensor that turns clockwise, seen from above, as KITTI's does [s]


@dataclass(frozen=True, slots=True)
class Sensor:
    """Where the sensor is at the time of a frame, when it looks forward, and how it moves.

    Attributes:
        place: [m].
        yaw: [rad].
        velocity: [m/s].
        rate: of its turn [rad/s].
        is_moving: whether velocity and rate are known; else they are 0.
    """

    place: Vector
    yaw: float
    velocity: Vector = field(default_factory=lambda: np.zeros(2))
    rate: float = 0.0
    is_moving: bool = False

    def since(self, before: "Sensor", seconds: float) -> "Sensor":
        """Tell how it moves from where it was so many seconds before."""
        return self._with((self.place - before.place) / seconds, planar.wrap(self.yaw - before.yaw) / seconds)

    def as_of(self, other: "Sensor") -> "Sensor":
        """Let it move as at another time."""
        return self._with(other.velocity, other.rate)

    def _with(self, velocity: Vector, rate: float) -> "Sensor":
        return replace(self, velocity=velocity, rate=rate, is_moving=True)

    def carried(self, place: Vector) -> Vector:
        """Give the velocity that a place would have if the sensor took it along [m/s]."""
        x, y = (place - self.place).tolist()
        return self.velocity + np.array([-self.rate * y, self.rate * x])

    def missed(self, place: Vector) -> Vector:
        """Give how far the sensor takes a place along from the time of the frame to when its beams pass it [m]."""
        x, y = (place - self.place).tolist()
        delay = -planar.wrap(math.atan2(y, x) - self.yaw) * SWEEP_PERIOD / (2.0 * math.pi)
        return delay * self.carried(place)
