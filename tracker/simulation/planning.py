"""How road users choose their speeds: they follow, slow down for bends, give way, and stop at red lights."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import gaussian_filter1d

from tracker.simulation.speeds import SampledSpeed
from tracker.simulation.trajectories import Curve

STEP = 0.2  # between two decisions [s]
HORIZON = 40  # steps that a driver looks ahead
HARDEST_BRAKING = 3.6  # [m/s^2]
_GRID = 0.5  # spacing of what is known along a path [m]
_SMOOTHING = 0.45  # over which decisions are blurred, as feet on pedals do [s]


@dataclass(frozen=True, slots=True)
class Style:
    """How somebody drives, rides or walks.

    Attributes:
        speed: on a free and straight way [m/s].
        acceleration: [m/s^2].
        braking: comfortable one [m/s^2].
        time_gap: kept to whoever is ahead [s].
        min_gap: kept when standing [m].
        lateral: acceleration in bends [m/s^2].
        caution: time by which one keeps clear of those who cross [s].
        slowest: whoever would have to go slower stays away [m/s].
    """

    speed: float
    acceleration: float = 1.6
    braking: float = 2.0
    time_gap: float = 1.2
    min_gap: float = 2.0
    lateral: float = 2.2
    caution: float = 0.8
    slowest: float = 0.0


@dataclass(frozen=True)
class Occupancy:
    """Which part of a path others take, step by step; NaN where they are not on it.

    Attributes:
        low: nearest end of each taker's part, one row a taker [m].
        high: far end [m].
        pace: the taker's speed along the path [m/s].
    """

    low: Float64[np.ndarray, "k n"]
    high: Float64[np.ndarray, "k n"]
    pace: Float64[np.ndarray, "k n"]

    def widened(self, n_steps: int) -> "Occupancy":
        """Let everyone come this many steps earlier and leave as much later."""
        n = self.low.shape[1]
        low, high = np.full_like(self.low, np.inf), np.full_like(self.high, -np.inf)
        for shift in range(-n_steps, n_steps + 1):
            into, out = slice(max(shift, 0), n + min(shift, 0)), slice(max(-shift, 0), n - max(shift, 0))
            low[:, into] = np.fmin(low[:, into], self.low[:, out])
            high[:, into] = np.fmax(high[:, into], self.high[:, out])
        return Occupancy(np.where(np.isinf(low), np.nan, low), np.where(np.isinf(high), np.nan, high), self.pace)


class _Limits:
    """How fast a path may be driven, and how long that takes, by arc length."""

    def __init__(self, path: Curve, style: Style, s_start: float, reach: float) -> None:
        self.s = np.arange(s_start - 1.0, s_start + reach + 1.0, _GRID)
        bend = np.sqrt(style.lateral / np.maximum(np.abs(path.curvatures(self.s)), 1e-6))
        speed = np.minimum(style.speed, bend)
        for i in range(len(speed) - 2, -1, -1):  # brake in time
            speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 1.2 * style.braking * _GRID))
        self.speed = speed
        self.time = np.concatenate([[0.0], np.cumsum(_GRID / speed[:-1])])

    def at(self, s: float) -> float:
        return float(np.interp(s, self.s, self.speed))

    def freely(self, s: float, speed: float, acceleration: float) -> Float64[np.ndarray, " n"]:
        """Say how far one gets over the next steps when nobody is in the way [m]."""
        tau = STEP * np.arange(HORIZON)
        fastest = np.interp(np.interp(s, self.s, self.time) + tau, self.time, self.s)
        return np.minimum(fastest, s + speed * tau + 0.5 * acceleration * tau**2)


def plan_speed(
    path: Curve,
    s_start: float,
    style: Style,
    ends: tuple[float, float],
    occupancy: Occupancy,
    times: Float64[np.ndarray, " n"],
) -> SampledSpeed:
    """Choose a speed along a path on which others take their parts, whose future is known.

    Each step looks some seconds ahead: whoever would be in the way of a free drive is followed, waited for, or left
    alone since one passes before.  It is a choice, no proof: the caller checks that nobody touches anybody.

    Args:
        path: of the reference point.
        s_start: where it is at the first time [m].
        style: of the driver.
        ends: of the body, seen from the reference point: the rear one (negative) and the front one [m].
        occupancy: of the path by the others, at `times`.
        times: of the decisions, `STEP` apart [s].

    Source: the following is Treiber, Hennecke & Helbing, "Congested traffic states in empirical observations and
    microscopic simulations", Phys. Rev. E 62, 2000, eq. 2-4 (the intelligent driver model).
    """
    reach = style.speed * (times[-1] - times[0]) + 40.0
    limits, wide = _Limits(path, style, s_start, reach), occupancy.widened(round(style.caution / STEP))
    s, speeds = s_start, np.zeros(len(times))
    steady = limits.freely(s, limits.at(s), 0.0) - s
    speeds[0] = _first_speed(limits.at(s), _leaders(occupancy, wide, 0, s, (steady, ends)), style)
    for k in range(len(times) - 1):
        ahead = limits.freely(s, speeds[k], style.acceleration) - s
        leaders = _leaders(occupancy, wide, k, s, (ahead, ends))
        change = _acceleration(speeds[k], limits.at(s + 0.5 * speeds[k]), leaders, style)
        speeds[k + 1] = max(speeds[k] + STEP * change, 0.0)
        s += 0.5 * STEP * (speeds[k] + speeds[k + 1])
    smooth = gaussian_filter1d(speeds, _SMOOTHING / STEP, mode="nearest")
    return SampledSpeed(times, np.maximum(smooth, 0.0))


_Leaders = Float64[np.ndarray, "m 2"]  # gap [m] and speed [m/s] of those who matter
_Way = tuple[Float64[np.ndarray, " h"], tuple[float, float]]  # how far one would get, step by step, and one's ends [m]


def _leaders(occupancy: Occupancy, wide: Occupancy, now: int, s: float, way: _Way) -> _Leaders:
    """Find who is in the way of a body at s that would go on like that."""
    (ahead, ends), front = way, s + way[1][1]
    low, high = wide.low[:, now : now + HORIZON], wide.high[:, now : now + HORIZON]
    ahead = ahead[: low.shape[1]]
    meets: Bool[np.ndarray, "k h"] = (front + ahead + 0.7 > low) & (s + ends[0] + ahead - 0.7 < high)
    who = np.flatnonzero(meets.any(axis=1))
    when = now + meets[who].argmax(axis=1)
    here = occupancy.low[who, now]
    is_here = ~np.isnan(here)
    pace = np.maximum(occupancy.pace[who, np.where(is_here, now, when)], 0.0)
    there = wide.low[who, when] - np.where(pace > 1.0, pace, 0.0) * STEP * (when - now)
    gap = np.where(is_here, here, there) - front
    # Who is beside or behind the front cannot be waited for; those who merge closely can.
    matters = np.where(is_here, here, wide.low[who, when]) > front - 0.3
    return np.column_stack([np.maximum(gap, 0.3), np.where(is_here | (pace > 1.0), pace, 0.0)])[matters]


def _first_speed(limit: float, leaders: _Leaders, style: Style) -> float:
    """Start at a speed that suits those ahead."""
    room = np.maximum(leaders[:, 0] - style.min_gap, 0.0)
    suits = np.minimum(np.sqrt(leaders[:, 1] ** 2 + 2.0 * room), leaders[:, 1] + room / style.time_gap)
    return float(min(limit, suits.min(initial=np.inf)))


def _acceleration(speed: float, limit: float, leaders: _Leaders, style: Style) -> float:
    """Choose the acceleration: towards the speed limit, and as each leader allows [m/s^2]."""
    free = float(np.clip((limit - speed) / 0.9, -style.braking, style.acceleration))
    gap, pace = leaders.T
    closing = speed * (speed - pace) / (2.0 * np.sqrt(style.acceleration * style.braking))
    wish = style.min_gap + np.maximum(speed * style.time_gap + closing, 0.0)
    behind = style.acceleration * (1.0 - (wish / gap) ** 2)
    is_too_late = (pace < 0.5) & (speed**2 > 2.0 * (HARDEST_BRAKING + 0.4) * gap)  # nobody stops within that
    behind = np.where(is_too_late, free, behind)
    return float(np.clip(min(free, behind.min(initial=np.inf)), -HARDEST_BRAKING, style.acceleration))
