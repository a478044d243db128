"""How fast things go: speeds over time whose accelerations are continuous."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import PchipInterpolator, PPoly

from tracker.errors import InputError

RAMP = 0.8  # time in which an acceleration builds up and fades [s]
_LONG_BEFORE, _LONG_AFTER = -60.0, 3600.0  # speeds are known between these times [s]


class SpeedProfile:
    """A speed over time, known through its piecewise polynomial `_speed`."""

    _speed: PPoly

    def distance(self, t: float) -> float:
        """Way since time 0 [m]."""
        return float(self._distance(t) - self._distance(0.0))

    def distances(self, times: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Way since time 0 at many times [m]."""
        return np.asarray(self._distance(times) - self._distance(0.0))

    def speed(self, t: float) -> float:
        """Speed at time t [m/s]."""
        return float(self._speed(t))

    def acceleration(self, t: float) -> float:
        """Acceleration along the way at time t [m/s^2]."""
        return float(self._acceleration(t))

    @cached_property
    def _acceleration(self) -> PPoly:
        return self._speed.derivative()

    @cached_property
    def _distance(self) -> PPoly:
        return self._speed.antiderivative()


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """From `start` on, for `duration`, the speed changes by `amount` [s, s, m/s]."""

    start: float
    duration: float
    amount: float


@dataclass(frozen=True)
class Speed(SpeedProfile):
    """A speed over time whose acceleration ramps up, holds and ramps down in each change.

    Attributes:
        initial: before the first change [m/s].
        changes: in any order; those that overlap add up.
    """

    initial: float
    changes: tuple[SpeedChange, ...] = ()

    def __post_init__(self) -> None:
        if self._speed(self._acceleration.x).min() < -1e-9:
            raise InputError("a simulated speed must never be negative: nothing drives backwards")

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


def _trapezoid(change: SpeedChange) -> tuple[Float64[np.ndarray, "4"], Float64[np.ndarray, "4"]]:
    """Give the corners of a change's acceleration over time."""
    ramp = min(RAMP, 0.5 * change.duration)
    peak = change.amount / (change.duration - ramp)
    steps = np.array([0.0, max(ramp, 1e-9), max(change.duration - ramp, ramp + 1e-9), change.duration])
    return change.start + steps, np.array([0.0, peak, peak, 0.0])


@dataclass(frozen=True)
class SampledSpeed(SpeedProfile):
    """A speed through samples: between them it neither overshoots nor goes below zero; constant beyond them.

    Attributes:
        times: of the samples, ascending [s].
        speeds: the samples [m/s].

    Source: Fritsch & Butland, "A method for constructing local monotone piecewise cubic interpolants", SIAM J. Sci.
    Stat. Comput. 5(2), 1984, through SciPy's `PchipInterpolator`.
    """

    times: Float64[np.ndarray, " n"]
    speeds: Float64[np.ndarray, " n"]

    def __post_init__(self) -> None:
        if self.speeds.min() < 0.0:
            raise InputError("a simulated speed must never be negative: nothing drives backwards")

    @cached_property
    def _speed(self) -> PPoly:
        knots = np.concatenate([[_LONG_BEFORE], self.times, [_LONG_AFTER]])
        return PchipInterpolator(knots, self.speeds[np.r_[0, 0 : len(self.speeds), -1]])
