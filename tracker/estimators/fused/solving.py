"""Solve for the windows of many objects at once: packed for the compiled least squares, and given back."""

from collections.abc import Sequence

import numpy as np

from tracker.estimators.fused import heading, window_kernels
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.hypotheses import Told
from tracker.estimators.fused.window import Window

STILL = Heading(turns=False, n_frames=1)
STILL.advance(0.0)


def solve(windows: Sequence[Window], axes: Heading | None = None) -> None:
    """Find the most likely places and rates of all frames of objects that share a model and axes.

    Objects without comparisons stay as they are.  No axes: these do not matter, or do not turn.
    """
    windows = [window for window in windows if window.comparisons]
    if not windows:
        return
    state, covariances, angles, rates, rate_variance, chosen = window_kernels.solve(
        _packed(windows, axes),
        _open(axes or STILL),
        (float(windows[0].model.density), float(windows[0].model.change)),
        np.array(windows[0].model.tails),
        float(windows[0].model.claimed),
    )
    frame, width = 0, 2 * state.shape[2]
    for k, window in enumerate(windows):
        n = len(window)
        window.state = state[frame : frame + n]
        # contiguous, or numba would compile all that takes it once more
        window.covariance = np.ascontiguousarray(covariances[k, : n * width, : n * width])
        window.told = Told(chosen.rivals[k], chosen.contrary[k], chosen.contrary_shares[k], chosen.unsettled[k])
        if chosen.is_other[k]:
            window.take_other()
        window.learn_rate()
        frame += n
    if axes is not None:
        axes.settle(angles, rates, rate_variance)


def _packed(windows: Sequence[Window], axes: Heading | None) -> window_kernels.Windows:
    comparisons = [comparison for window in windows for comparison in window.comparisons]
    counts = [len(window.comparisons) for window in windows]
    ends = np.column_stack([[c.older for c in comparisons], [c.newer for c in comparisons]])
    d = windows[0].state.shape[2]
    measured = np.concatenate([comparison.measured for comparison in comparisons]).reshape(len(comparisons), -1)
    numbers = np.array([number for window in windows for number in window.axes])
    rates, rate_covariances = zip(*(window.first_rate for window in windows), strict=True)
    expected, step_covariances = zip(*(window.expected for window in windows), strict=True)
    return window_kernels.Windows(
        sizes=np.array([len(window) for window in windows]),
        counts=np.array(counts),
        times=np.array([time for window in windows for time in window.times]),
        axes=np.full(len(numbers), -1) if axes is None else np.maximum(numbers - axes.first, -1),
        angles=np.zeros(len(numbers)) if axes is None else axes.angles_at(numbers),
        state=np.concatenate([window.state for window in windows]),
        shakes=np.concatenate([window.shakes for window in windows]),
        rates=np.array(rates),
        expected=np.array(expected),
        expected_covariances=np.array(step_covariances),
        rate_informations=np.linalg.inv(np.array(rate_covariances)),
        **_packed_others(windows),
        ends=ends - np.repeat([window.n_left for window in windows], counts)[:, None],
        olders=np.ascontiguousarray(measured[:, :d]),
        newers=np.ascontiguousarray(measured[:, d : 2 * d]),
        informations=np.ascontiguousarray(measured[:, 2 * d : -d * d]).reshape(-1, d, d),
        doubts=np.ascontiguousarray(measured[:, -d * d :]).reshape(-1, d, d),
    )


def _packed_others(windows: Sequence[Window]) -> dict[str, np.ndarray]:
    """Pack the other explanations of the looks before."""
    n, d = len(windows), windows[0].state.shape[2]
    covariances, is_sudden = np.tile(np.eye(d), (n, 1, 1)), np.zeros(n, dtype=np.bool_)
    others, rates, expected, costs = np.full((n, d), np.nan), np.zeros((n, d)), np.zeros((n, d)), np.zeros(n)
    for k, window in enumerate(windows):
        if window.other is not None:
            others[k], rates[k], costs[k] = window.other.off, window.other.rate, window.other.cost
            expected[k], covariances[k] = window.other_expected
            is_sudden[k] = window.other.is_sudden
    return {
        "others": others,
        "other_rates": rates,
        "other_expected": expected,
        "other_covariances": covariances,
        "other_costs": costs,
        "is_sudden": is_sudden,
    }


def _open(axes: Heading) -> window_kernels.Axes:
    """Pack the axes that are still open; the latest one where none are."""
    first = min(axes.first, axes.latest)
    kept = first - axes.first_kept
    return window_kernels.Axes(
        times=np.array(axes.times[kept:]),
        angles=np.array(axes.angles[kept:]),
        rates=np.array(axes.rates[kept:]),
        first_rate=np.array(axes.first_rate),
        heard=np.array([(i - first, j - first, *rest) for i, j, *rest in axes.heard]).reshape(-1, 4),
        density=heading.DENSITY,
    )
