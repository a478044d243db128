"""Two explanations of a look: the object moved suddenly, or the look is off as a whole; the next look settles it."""

import math
import typing
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numba import njit

from tracker.estimators.fused import heavy_tails

# A look may be off as a whole, as by a box that jumps: share of such looks, and standard deviation along each axis [m].
OFF_SHARE, OFF_SD = 0.01, 0.3
# What moves may change its velocity at once, as in a crash: share of looks, standard deviation along each axis [m/s].
SUDDEN_SHARE, SUDDEN_SD = 0.002, 5.0
MOST_COST = 9.0  # an explanation that is less likely than that is not kept: difference of negative logarithms

Vector = Float64[np.ndarray, " d"]
Square = Float64[np.ndarray, "d d"]


@dataclass(frozen=True, slots=True)
class Other:
    """The explanation of the latest look that was not taken.

    Attributes:
        off: where the object would be, relative to where it is taken to be (d).
        rate: it would have (d).
        rate_covariance: of that (d, d).
        cost: by how much this is less likely than what was taken: difference of negative logarithms.
        is_sudden: this is that the object moved suddenly; else, that the look is off.
        seconds: of the step to the latest look.
    """

    off: Vector
    rate: Vector
    rate_covariance: Square
    cost: float
    is_sudden: bool
    seconds: float

    @property
    def probability(self) -> float:
        """How likely it is, before the next look."""
        return 1.0 / (1.0 + math.exp(self.cost))

    def expected(self, dt: float, covariance: Square) -> tuple[Vector, Square]:
        """Give the step of `dt` that would follow, and its covariance; `covariance` is that of what was taken."""
        if self.is_sudden:
            return dt * self.rate, covariance + dt**2 * self.rate_covariance
        return dt * self.rate, (self.seconds + dt) ** 2 * self.rate_covariance

    def reversed(self, rate: Vector) -> "Other":
        """Give what is the other one once this is taken; `rate` is that of what was taken before."""
        return replace(self, off=-self.off, rate=rate, cost=-self.cost, is_sudden=not self.is_sudden)


@dataclass(frozen=True, slots=True)
class Told:
    """What the comparisons of the latest look tell beside what was taken.

    Attributes:
        rival: where the last step would lead if it could be as sudden as they tell (d); NaN where it is.
        contrary: another place that some tell of, relative to the last one (d); NaN where none do.
        contrary_share: its probability, beside the last one.
        unsettled: probability of the other explanation of the look before.
    """

    rival: Vector
    contrary: Vector
    contrary_share: float = 0.0
    unsettled: float = 0.0

    def spread(self) -> Square:
        """Give the covariance of the last place that the contrary one adds (d, d)."""
        d = len(self.contrary)
        return self.contrary[:, None] * self.contrary if self.has_contrary else np.zeros((d, d))

    @property
    def has_rival(self) -> bool:
        """Whether the last step could be more sudden."""
        return not math.isnan(self.rival[0])

    @property
    def has_contrary(self) -> bool:
        """Whether some comparisons tell of another place."""
        return not math.isnan(self.contrary[0])


@dataclass(frozen=True, slots=True)
class Seen:
    """A step to the latest look, in its axes.

    Attributes:
        step: as it was taken (d).
        shown: as the comparisons tell (d).
        expected: as the motion so far would have it (d).
        covariance: of that (d, d).
        seconds: it took.
    """

    step: Vector
    shown: Vector
    expected: Vector
    covariance: Square
    seconds: float


def weigh(seen: Seen, tails: tuple[float, float]) -> tuple[Square, Other | None]:
    """Give the covariance that a step has beside its own, since either explanation may hold, and the one not taken.

    Args:
        seen: the step.
        tails: degrees of freedom of Student's t for errors of looks, and of the motion; 0: normal.
    """
    sudden = SUDDEN_SD * seen.seconds
    doubt, odds, away = _weigh(seen.step, seen.shown, seen.expected, seen.covariance, sudden, tails)
    is_sudden = bool((seen.step != seen.shown).any())
    cost = odds if is_sudden else -odds
    if cost > MOST_COST:
        return doubt, None
    off = seen.shown - seen.expected
    if is_sudden:  # somewhere in the step
        rate, open_ = (1.5 * seen.shown - 0.5 * seen.expected) / seen.seconds, 0.25 * np.outer(off, off)
    else:
        rate, open_ = seen.expected / seen.seconds, seen.covariance
    other = seen.shown - seen.step if is_sudden else -away
    return doubt, Other(other, rate, open_ / seen.seconds**2, cost, is_sudden, seen.seconds)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _weigh(step, shown, expected, covariance, sudden, tails):
    """Weigh both explanations: each is as likely as the motion, or an error of the look, makes what is seen.

    The motion is as it is expected, or, rarely, changes at once by `sudden` (standard deviation of the step [m]).

    Source: Bayes' theorem over two hypotheses.  Each adds, by its share, how far it is from the step that was taken.

    The motion's t is that of a place alone, where the windows' is of place and rate.

    Returns:
        covariance (D, D), logarithm of the odds that the look is off, and where the step was taken to relative to
        that (D).
    """
    D, off = len(step), shown - expected
    wider = covariance + OFF_SD**2 * np.eye(D)
    back = np.linalg.solve(wider, off)
    steady = _log_density(tails[1], off, covariance)
    changed = np.log(SUDDEN_SHARE) + _log_density(tails[1], off, covariance + sudden**2 * np.eye(D))
    odds = np.log(OFF_SHARE) + _log_density(tails[0], off, wider) - np.logaddexp(steady, changed)
    share, left = 1.0 / (1.0 + np.exp(-odds)), (step - shown).reshape(D, 1)
    away = left + OFF_SD**2 * back.reshape(D, 1)
    return (1.0 - share) * (left @ left.T) + share * (away @ away.T), odds, away[:, 0]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _log_density(tail, off, covariance):
    own = heavy_tails.log_density(tail, len(off), off @ np.linalg.solve(covariance, off))
    return own - 0.5 * np.log(np.linalg.det(covariance))
