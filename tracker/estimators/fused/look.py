"""What is kept of one look at an object."""

from dataclasses import dataclass, replace

import numpy as np

from registration.alignnet.method import AlignNetCars, AlignNetPersons, Cloud
from registration.types import Points
from tracker.estimators.fused.window import Vector

Networks = AlignNetCars | AlignNetPersons

KEPT_POINTS = 2000  # of a look, at most
SWEEP_PERIOD = 0.1  # of a sensor that turns clockwise, seen from above, as KITTI's does [s]


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
        sensor: where they were seen from (2) [m].
        is_bent: points are where they were when the beams passed them; see `straightened`.
        learned: what the network makes of it.
        frame: number of the frame in its sequence.
    """

    points: Points
    n_points: int
    n_from_1m: float
    sensor: Vector
    is_bent: bool
    learned: Encoding
    frame: int

    def straightened(self, velocity: Vector, center: Vector) -> "Look":
        """Undo what the object moved while the beams passed it, up to a decimetre at its ends when it is close.

        Args:
            velocity: of the object relative to the sensor [m/s].
            center: of the object: its points go to where they were when the beams passed it [m].
        """
        if not self.is_bent:
            return self
        x, y = (center - self.sensor).tolist()
        rays = self.points[:, :2] - self.sensor
        turned = np.arctan2(x * rays[:, 1] - y * rays[:, 0], rays @ (x, y))  # counter-clockwise: the beams were earlier
        points = self.points.copy()
        points[:, :2] += (SWEEP_PERIOD / (2.0 * np.pi) * turned)[:, None] * velocity
        return replace(self, points=points, is_bent=False)


def thinned(points: Points, most: int = KEPT_POINTS) -> Points:
    """Keep every k-th point, so that a look takes up no more memory and time than it is worth."""
    return points if len(points) <= most else np.ascontiguousarray(points[:: -(-len(points) // most)])
