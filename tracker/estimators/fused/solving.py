"""Solve for the windows of many objects at once, and for the axes that they share."""

import numpy as np
from jaxtyping import Int64

from tracker.estimators.fused import heading, solving_kernels
from tracker.estimators.fused.heading import Heading, Turned
from tracker.estimators.fused.problem import Axes
from tracker.estimators.fused.window import Windows

NEVER = 2**62  # number of no frame
NOWHERE = Turned(first_kept=NEVER, first_open=NEVER, angles=np.zeros(1))
STILL = Axes(
    times=np.zeros(1),
    angles=np.zeros(1),
    rates=np.zeros(1),
    first_rate=np.array([0.0, heading.RATE_SD**2]),
    heard=np.zeros((0, 4)),
    density=heading.DENSITY,
)


def solve(windows: Windows, at: Int64[np.ndarray, " k"], axes: Heading | None = None) -> None:
    """Find the most likely places and rates of all frames of objects.

    Objects without comparisons stay as they are.  No axes: these do not matter, or do not turn.

    Args:
        windows: of the objects.
        at: their rows.
        axes: that they share.
    """
    model, turned = windows.model, NOWHERE if axes is None else axes.turned()
    opened = STILL if axes is None or not axes.turns else _open(axes)
    densities = float(model.density), float(model.change)
    found = solving_kernels.solve(windows.rows, at, turned, opened, densities, windows.tails, float(model.claimed))
    is_solved, angles, rates, rate_variance = found
    if is_solved and axes is not None:
        axes.settle(angles, rates, rate_variance)


def _open(axes: Heading) -> Axes:
    """Pack the axes that are still open."""
    first = axes.first
    kept = first - axes.first_kept
    return Axes(
        times=np.array(axes.times[kept:]),
        angles=axes.angles[kept:],
        rates=np.array(axes.rates[kept:]),
        first_rate=np.array(axes.first_rate),
        heard=np.array([(i - first, j - first, *rest) for i, j, *rest in axes.heard]).reshape(-1, 4),
        density=heading.DENSITY,
    )
