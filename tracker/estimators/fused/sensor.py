"""Where the sensor is in one frame, how it moves, and when its beams pass a place."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from registration import planar
from tracker.estimators.fused.window import Vector
from tracker.types import Sweep

SWEEP = Sweep(np.zeros(6))  # of a sensor that turns clockwise, seen from above, 10 times a second, as KITTI's does
TURNS = SWEEP.period, -1.0 if SWEEP.is_clockwise else 1.0, SWEEP.cut_azimuth  # as `sensor_kernels` take it


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

    def carried(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Give the velocities that places would have if the sensor took them along [m/s]."""
        found: Float64[np.ndarray, "n 2"] = (places - self.place)[:, ::-1] * [-self.rate, self.rate] + self.velocity
        return found

    def numbers(self) -> tuple[float, float, float, float, float, float]:
        """Give place, yaw, velocity and rate, as compiled loops take them."""
        return (*self.place.tolist(), self.yaw, *self.velocity.tolist(), self.rate)
