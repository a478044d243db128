"""A static world of walls, posts and ground, seen by a sensor that drives: written by plain code, shared by tests."""

from dataclasses import dataclass

import numpy as np

from registration import se3
from tracker.types import Box, Frame, Sweep

PERIOD = 0.1  # between sweeps [s]


@dataclass(frozen=True)
class Drive:
    """A sensor on its way through the world: a steady speed along its x-axis, a steady turn.

    Attributes:
        speed: [m/s].
        yaw_rate: [rad/s], not 0.
        rolling: the sensor moves while it turns.
        noise: of the points [m].
    """

    speed: float = 12.0
    yaw_rate: float = 0.1
    rolling: bool = False
    noise: float = 0.015

    @property
    def twist(self) -> np.ndarray:
        return np.array([self.speed, 0.0, 0.0, 0.0, 0.0, self.yaw_rate])

    def pose(self, t: float) -> np.ndarray:
        """Give T_world_lidar at a time [s]: along a circle."""
        angle, radius = self.yaw_rate * t, self.speed / self.yaw_rate
        return se3.from_yaw(angle, radius * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0]))

    def poses(self, n_frames: int) -> np.ndarray:
        return np.array([self.pose(PERIOD * k) for k in range(n_frames)])

    def look(self, world: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Bring points into the sensor's frame, each at its own time."""
        angle, radius = self.yaw_rate * times, self.speed / self.yaw_rate
        x, y = world[:, 0] - radius * np.sin(angle), world[:, 1] - radius * (1.0 - np.cos(angle))
        c, s = np.cos(angle), np.sin(angle)
        return np.column_stack([c * x + s * y, c * y - s * x, world[:, 2]])

    def points(self, frame: int, world: np.ndarray, reach: float = 45.0) -> np.ndarray:
        """Measure the points of the world within reach, each when the beams meet it."""
        rng = np.random.default_rng([frame, 11])
        times = np.full(len(world), PERIOD * frame)
        seen = self.look(world, times)
        for _ in range(4 * self.rolling):  # a point's direction says when it is met, and when says its direction
            seen = self.look(world, times + clockwise_times(seen))
        seen = seen[np.hypot(seen[:, 0], seen[:, 1]) < reach]
        return seen + self.noise * rng.standard_normal(seen.shape)

    def frame(
        self, index: int, world: np.ndarray, pose: np.ndarray | None = None, boxes: tuple[Box, ...] = ()
    ) -> Frame:
        """Make a frame, with or without a pose."""
        return Frame(
            index=index,
            timestamp=PERIOD * index,
            boxes=boxes,
            points_lidar=self.points(index, world),
            T_world_lidar=pose,
            sweep=Sweep(np.zeros(6)) if self.rolling else None,
        )


def clockwise_times(points: np.ndarray) -> np.ndarray:
    """Tell when a sensor that turns clockwise, ten times a second, and is cut at the rear meets points [s]."""
    return -np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) * PERIOD


def street(seed: int = 0, length: float = 60.0, density: float = 5.0) -> np.ndarray:
    """Scatter points over ground, two rows of house fronts with corners, and posts (n, 3) [m]."""
    rng = np.random.default_rng(seed)
    ends = np.array([-45.0, length])
    ground = _patch(rng, density, (*ends, -14.0, 14.0))
    parts = [np.column_stack([ground, np.full(len(ground), -1.7)])]
    for side in (-1.0, 1.0):
        for start in np.arange(ends[0], ends[1], 12.0):
            front = side * float(rng.uniform(9.0, 12.0))
            wall = _patch(rng, 2.0 * density, (start, start + 9.0, -1.7, 4.0))
            parts.append(np.column_stack([wall[:, 0], np.full(len(wall), front), wall[:, 1]]))
            flank = _patch(rng, 2.0 * density, (abs(front), abs(front) + 5.0, -1.7, 4.0))
            parts.append(np.column_stack([np.full(len(flank), start), side * flank[:, 0], flank[:, 1]]))
    for start in np.arange(ends[0], ends[1], 8.0):
        angle, z = rng.uniform(0.0, 2.0 * np.pi, 60), rng.uniform(-1.7, 4.0, 60)
        parts.append(np.column_stack([start + 0.15 * np.cos(angle), 7.0 + 0.15 * np.sin(angle), z]))
    return np.concatenate(parts)


def _patch(rng: np.random.Generator, density: float, sides: tuple[float, float, float, float]) -> np.ndarray:
    """Scatter points over a rectangle (low, high, low, high)."""
    low, high = np.array(sides[::2]), np.array(sides[1::2])
    return rng.uniform(low, high, (int(density * np.prod(high - low)), 2))
