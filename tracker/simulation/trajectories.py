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
from tracker.errors import InputError
from tracker.types import Vector2

SPACING = 0.1  # between the knots of a curve [m]
RAMP = 0.8  # time in which an acceleration builds up and fades [s]
_LONG_BEFORE, _LONG_AFTER = -60.0, 3600.0  # speeds are known between these times [s]


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """From `start` on, for `duration`, the speed changes by `amount` [s, s, m/s]."""

    start: float
    duration: float
    amount: float


@dataclass(frozen=True)
class Speed:
    """A speed over time whose acceleration is continuous: it ramps up, holds and ramps down in each change.

    Attributes:
        initial: before the first change [m/s].
        changes: in any order; those that overlap add up.
    """

    initial: float
    changes: tuple[SpeedChange, ...] = ()

    def __post_init__(self) -> None:
        if self._speed(self._acceleration.x).min() < -1e-9:
            raise InputError("a simulated speed must never be negative: nothing drives backwards")

    def distance(self, t: float) -> float:
        """Way since time 0 [m]."""
        return float(self._distance(t) - self._distance(0.0))

    def speed(self, t: float) -> float:
        """Speed at time t [m/s]."""
        return float(self._speed(t))

    def acceleration(self, t: float) -> float:
        """Acceleration along the way at time t [m/s^2]."""
        return float(self._acceleration(t))

    @cached_property
    def _acceleration(self) -> PPoly:
        shapes = [_trapezoid(change) for change in self.changes]
        knots = np.unique(np.concatenate([[_LONG_BEFORE, _LONG_AFTER], *(times for times, _ in shapes)]))
        values = sum((np.interp(knots, *shape) for shape in shapes), np.zeros(len(knots)))
        return PPoly(np.stack([np.diff(values) / np.diff(knots), values[:-1]]), knots)

    @cached_property
    def _speed(self) -> PPoly:
        speed = self._acceleration.antiderivative()
        speed.c[-1] += self.initial
        return speed

    @cached_property
    def _distance(self) -> PPoly:
        return self._speed.antiderivative()


def _trapezoid(change: SpeedChange) -> tuple[Float64[np.ndarray, "4"], Float64[np.ndarray, "4"]]:
    """Give the corners of a change's acceleration over time."""
    ramp = min(RAMP, 0.5 * change.duration)
    peak = change.amount / (change.duration - ramp)
    steps = np.array([0.0, max(ramp, 1e-9), max(change.duration - ramp, ramp + 1e-9), change.duration])
    return change.start + steps, np.array([0.0, peak, peak, 0.0])


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

    def _inside(self, s: float) -> float:
        return float(np.clip(s, self.s[0], self.s[-1]))

    def beside(self, offset: Callable[[np.ndarray], np.ndarray]) -> "Curve":
        """Shift the curve to its left by offset(s) [m]; arc length is counted from the point beside s = 0."""
        tangent = self._spline(self.s, 1)
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.linalg.norm(tangent, axis=1)[:, None]
        points = self.points + offset(self.s)[:, None] * normal
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return Curve(s - np.interp(0.0, self.s, s), points)

    def reversed(self) -> "Curve":
        """Run through the curve the other way; s = 0 stays where it is, other arc lengths change sign."""
        return Curve(-self.s[::-1], self.points[::-1].copy())


def curve_from_curvature(
    start: Vector2, yaw: float, pieces: Sequence[tuple[float, float]], s_start: float = 0.0
) -> Curve:
    """Draw a curve whose curvature changes linearly over each piece (straights, clothoids, arcs).

    Args:
        start: first point [m].
        yaw: direction there [rad].
        pieces: (length [m], curvature at its end [1/m]) one after the other; the curvature starts at 0.
        s_start: arc length of the first point [m].
    """
    knots = np.concatenate([[0.0], np.cumsum([length for length, _ in pieces])])
    curvature = np.array([0.0] + [end for _, end in pieces])
    s = np.linspace(0.0, knots[-1], max(int(np.ceil(knots[-1] / SPACING)), 3) + 1)
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
    speed: Speed
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
