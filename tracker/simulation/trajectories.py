"""How simulated things move: smooth curves over the ground, driven along at smoothly changing speeds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline, PPoly

from registration import se3
from registration.types import Transform
from tracker.simulation.speeds import Speed, SpeedChange, SpeedProfile
from tracker.types import Vector2

__all__ = [
    "Curve", "Drive", "EgoDrive", "Motion", "Speed", "SpeedChange", "SpeedProfile", "Standing", "curve_from_curvature",
]  # fmt: skip

SPACING = 0.1  # between the knots of a curve [m]


@dataclass(frozen=True)
class Curve:
    """A smooth curve over the ground, by arc length; straight beyond its ends.

    Attributes:
        s: arc length of each knot [m], ascending.
        points: the knots (n, 2) [m].
    """

    s: Float64[np.ndarray, " n"]
    points: Float64[np.ndarray, "n 2"]

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.s, self.points)

    def position(self, s: float) -> Vector2:
        """Point at arc length s [m]."""
        inside = self._inside(s)
        return np.asarray(self._spline(inside) + (s - inside) * self._spline(inside, 1))

    def yaw(self, s: float) -> float:
        """Direction at arc length s [rad]."""
        dx, dy = self._spline(self._inside(s), 1)
        return float(np.arctan2(dy, dx))

    def curvature(self, s: float) -> float:
        """Curvature at arc length s, positive to the left [1/m]."""
        inside = self._inside(s)
        if inside != s:
            return 0.0
        (dx, dy), (ddx, ddy) = self._spline(s, 1), self._spline(s, 2)
        return float((dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3)

    def track(self, s: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, "m 3"]:
        """Point and direction at many arc lengths, in rows (x, y, yaw) [m, m, rad]."""
        inside = np.clip(s, self.s[0], self.s[-1])
        direction = self._spline(inside, 1)
        points = self._spline(inside) + (s - inside)[:, None] * direction
        return np.column_stack([points, np.arctan2(direction[:, 1], direction[:, 0])])

    def curvatures(self, s: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, " m"]:
        """Curvature at many arc lengths, positive to the left [1/m]."""
        inside = np.clip(s, self.s[0], self.s[-1])
        (dx, dy), (ddx, ddy) = self._spline(inside, 1).T, self._spline(inside, 2).T
        return np.where(inside == s, (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3, 0.0)

    def moved(self, T_dst_src: Transform) -> "Curve":
        """Give the same curve in another frame, turned about z and shifted."""
        points = np.column_stack([self.points, np.zeros(len(self.points))])
        return Curve(self.s, se3.transform(T_dst_src, points)[:, :2])

    def _inside(self, s: float) -> float:
        return float(np.clip(s, self.s[0], self.s[-1]))

    def beside(self, offset: Callable[[np.ndarray], np.ndarray]) -> "Curve":
        """Shift the curve to its left by offset(s) [m]; arc length is counted from the point beside s = 0."""
        tangent = self._spline(self.s, 1)
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.linalg.norm(tangent, axis=1)[:, None]
        points = self.points + offset(self.s)[:, None] * normal
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return Curve(s - np.interp(0.0, self.s, s), points)

    def parallel(self, offset: float) -> "Curve":
        """Shift the curve to its left by the same way all along [m]."""
        return self.beside(lambda s: np.full(len(s), offset))

    def reversed(self) -> "Curve":
        """Run through the curve the other way; s = 0 stays where it is, other arc lengths change sign."""
        return Curve(-self.s[::-1], self.points[::-1].copy())


def curve_from_curvature(
    start: Vector2, yaw: float, pieces: Sequence[tuple[float, float]], s_start: float = 0.0, spacing: float = SPACING
) -> Curve:
    """Draw a curve whose curvature changes linearly over each piece (straights, clothoids, arcs).

    Args:
        start: first point [m].
        yaw: direction there [rad].
        pieces: (length [m], curvature at its end [1/m]) one after the other; the curvature starts at 0.
        s_start: arc length of the first point [m].
        spacing: of the knots, at most [m].
    """
    knots = np.concatenate([[0.0], np.cumsum([length for length, _ in pieces])])
    curvature = np.array([0.0] + [end for _, end in pieces])
    s = np.linspace(0.0, knots[-1], max(int(np.ceil(knots[-1] / spacing)), 3) + 1)
    slope = np.diff(curvature) / np.diff(knots)
    turn = PPoly(np.stack([slope, curvature[:-1]]), knots).antiderivative()

    def direction(at: np.ndarray) -> np.ndarray:
        return np.column_stack([np.cos(yaw + turn(at)), np.sin(yaw + turn(at))])

    middle = 0.5 * (s[1:] + s[:-1])  # Simpson's rule on each interval
    steps = (direction(s[:-1]) + 4.0 * direction(middle) + direction(s[1:])) * np.diff(s)[:, None] / 6.0
    return Curve(s_start + s, start + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]))


@runtime_checkable
class Motion(Protocol):
    """Where something is at any time."""

    def pose(self, t: float) -> Transform:
        """Pose T_world_obj; the origin is on the ground."""

    def distance(self, t: float) -> float:
        """Way covered since time 0 [m]."""


@dataclass(frozen=True)
class Standing:
    """It does not move."""

    T_world_obj: Transform

    def pose(self, t: float) -> Transform:
        """Pose T_world_obj, at any time."""
        return self.T_world_obj.copy()

    def distance(self, t: float) -> float:
        """Way covered: none."""
        return 0.0

    def track(self, times: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        """Place and direction at many times, in rows (x, y, yaw) [m, m, rad]."""
        return np.tile([*self.T_world_obj[:2, 3], se3.yaw(self.T_world_obj)], (len(times), 1))


@dataclass(frozen=True)
class Drive:
    """It follows a curve, as a car's rear axle does: the origin ahead of the axle swings out in bends.

    Attributes:
        curve: what the axle follows.
        speed: of the axle along the curve.
        s_start: arc length of the axle at time 0 [m].
        z: height of the ground [m].
        axle_x: where the axle is in the object's axes, negative behind the origin [m]; 0 for a person.
    """

    curve: Curve
    speed: SpeedProfile
    s_start: float
    z: float
    axle_x: float = 0.0

    def pose(self, t: float) -> Transform:
        """Pose T_world_obj at time t."""
        s = self.s_start + self.speed.distance(t)
        yaw = self.curve.yaw(s)
        x, y = self.curve.position(s) - self.axle_x * np.array([np.cos(yaw), np.sin(yaw)])
        return se3.from_yaw(yaw, np.array([x, y, self.z]))

    def distance(self, t: float) -> float:
        """Way of the axle since time 0 [m]."""
        return self.speed.distance(t)

    def track(self, times: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        """Place and direction at many times, in rows (x, y, yaw) [m, m, rad]."""
        rows = self.curve.track(self.s_start + self.speed.distances(times))
        rows[:, :2] -= self.axle_x * np.column_stack([np.cos(rows[:, 2]), np.sin(rows[:, 2])])
        return rows


@dataclass(frozen=True)
class EgoDrive:
    """The GPS/IMU of the car with the sensor: it follows a drive, and the body sways on its springs.

    The body pitches forward when it brakes, rolls outwards in bends and bobs a little all the time.

    Attributes:
        drive: of the point below the IMU; at time 0 the IMU is at that point exactly.
        pitch_per_acceleration: [rad per m/s^2].
        roll_per_acceleration: [rad per m/s^2].
        bob: amplitude of the up and down [m].
    """

    drive: Drive
    pitch_per_acceleration: float = 0.003
    roll_per_acceleration: float = 0.004
    bob: float = 0.008

    def pose(self, t: float) -> Transform:
        """Pose T_world_imu at time t."""
        s = self.drive.s_start + self.drive.distance(t)
        speed = self.drive.speed.speed(t)
        pitch = -self.pitch_per_acceleration * self.drive.speed.acceleration(t)
        pitch += 0.0015 * float(np.sin(2.0 * np.pi * 1.3 * t))
        roll = self.roll_per_acceleration * self.drive.curve.curvature(s) * speed**2
        T_level_imu = se3.pose(_lean(roll, pitch), np.array([0.0, 0.0, self.bob * np.sin(2.0 * np.pi * 1.1 * t)]))
        return self.drive.pose(t) @ T_level_imu

    def distance(self, t: float) -> float:
        """Way since time 0 [m]."""
        return self.drive.distance(t)


def _lean(roll: float, pitch: float) -> Float64[np.ndarray, "3 3"]:
    """Rotate by `roll` about x, then by `pitch` about y [rad]; positive: right side down, nose down."""
    c, s = np.cos(roll), np.sin(roll)
    R_roll = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ R_roll
