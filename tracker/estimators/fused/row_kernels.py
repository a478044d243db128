"""Windows begin, go on by a frame, and hear comparisons, many at once and in place; compiled by numba.

Rows are those of `rows`; `at` says which.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import motion_kernels

SHORTEST_STEP = 0.01  # [s]
PLACED = 1e-6  # variance of the first place, which only fixes where zero is


@njit(cache=True, nogil=True)
@typing.no_type_check
def start(rows, at, times, number, places, rate_sd):
    """Begin windows with one frame each; nothing is known of what was in these rows before.

    Args:
        rows: see `rows.Rows`; changed.
        at: which begin (K).
        times: of their frames [s] (K).
        number: of these frames' axes.
        places: (K, D).
        rate_sd: standard deviation of the rates, which are about 0, along each axis.
    """
    frames, explained, D = rows.frames, rows.explained, places.shape[1]
    for k in range(len(at)):
        r = at[k]
        frames.sizes[r], rows.comparisons.counts[r] = 1, 0
        frames.times[r, 0], frames.axes[r, 0], frames.is_off[r, 0] = times[k], number, False
        for d in range(D):
            frames.state[r, 0, 0, d], frames.state[r, 0, 1, d], frames.rates[r, 0, d] = places[k, d], 0.0, 0.0
            explained.rivals[r, d] = explained.contrary[r, d] = explained.others[r, d] = np.nan
            for e in range(D):
                frames.shakes[r, 0, d, e] = frames.doubts[r, 0, d, e] = explained.left[r, d, e] = 0.0
                frames.covariance[r, d, D + e] = frames.covariance[r, D + d, e] = 0.0
                frames.covariance[r, d, e] = PLACED if d == e else 0.0
                known = rate_sd**2 if d == e else 0.0
                frames.covariance[r, D + d, D + e] = frames.rate_covariances[r, 0, d, e] = known
        explained.contrary_shares[r] = explained.unsettled[r] = 0.0


@njit(cache=True, nogil=True)
@typing.no_type_check
def advance(frames, comparisons, at, times, turned, density, shakes):
    """Add a frame where the motion so far would lead; full windows lose their oldest one.

    Args:
        frames, comparisons: see `rows.Rows`; changed.
        at: which go on (K).
        times: of their new frames [s] (K).
        turned: how the axes stand, see `heading.Turned`; the new frames' are the latest.
        density: of the acceleration's noise.
        shakes: covariance that the new places have beside that of the motion (K, D, D).
    """
    n, D, oldest = frames.state.shape[1], frames.state.shape[3], np.int64(0)  # not a literal; see window_kernels
    rotations = turns_since(frames, at, turned)
    number = turned.first_kept + len(turned.angles) - 1
    for k in range(len(at)):
        r = at[k]
        time = next_time(frames, r, times[k])
        dt = time - frames.times[r, frames.sizes[r] - 1]
        if frames.sizes[r] == n:
            _leave(frames, r)
            forget(comparisons, r, oldest)
            for c in range(comparisons.counts[r]):
                comparisons.ends[r, c, 0] -= 1
                comparisons.ends[r, c, 1] -= 1
        m = frames.sizes[r]
        motion_kernels.advance(frames.state, frames.covariance, r, m, dt, rotations, k, density, shakes)
        frames.times[r, m], frames.axes[r, m], frames.is_off[r, m] = time, number, False
        for d in range(D):
            for e in range(D):
                frames.shakes[r, m, d, e], frames.doubts[r, m, d, e] = shakes[k, d, e], 0.0
        frames.sizes[r] = m + 1
        learn_rate(frames, r)


@njit(cache=True, nogil=True)
@typing.no_type_check
def next_time(frames, r, time):
    """Say when a window's next frame is [s]; what comes sooner than SHORTEST_STEP after the last is to come then."""
    return max(time, frames.times[r, frames.sizes[r] - 1] + SHORTEST_STEP)


@njit(inline="always")
@typing.no_type_check
def expect(frames, explained, at, times, density, shakes):
    """Say where the motion would lead, by what was taken of the latest looks and by the other explanations.

    Args:
        frames, explained: see `rows.Rows`; the latter is changed.
        at, times, density, shakes: see `advance`, which comes next.
    """
    expected, covariances, D = explained.expected, explained.expected_covariances, frames.state.shape[3]
    for k in range(len(at)):
        r, last = at[k], frames.sizes[at[k]] - 1
        dt, first = next_time(frames, r, times[k]) - frames.times[r, last], 2 * D * last + D
        explained.contrary_shares[r] = 0.0
        has_other = not np.isnan(explained.others[r, 0])
        explained.unsettled[r] = 1.0 / (1.0 + np.exp(explained.costs[r])) if has_other else 0.0
        for d in range(D):
            expected[r, 0, d], expected[r, 1, d] = dt * frames.state[r, last, 1, d], dt * explained.rates[r, d]
            explained.known_rates[r, d] = explained.rates[r, d]
            explained.rivals[r, d] = explained.contrary[r, d] = np.nan
            for e in range(D):
                known, other = frames.covariance[r, first + d, first + e], explained.rate_covariances[r, d, e]
                own = dt**2 * known + shakes[k, d, e] + (density * dt**3 / 3.0 if d == e else 0.0)
                since = dt if explained.is_sudden[r] else explained.seconds[r] + dt
                covariances[r, 0, d, e] = own
                covariances[r, 1, d, e] = since**2 * other + (own if explained.is_sudden[r] else 0.0)
                explained.known_covariances[r, d, e] = other + known


@njit(cache=True, nogil=True)
@typing.no_type_check
def turns_since(frames, at, turned):
    """Give the rotations from the axes of windows' last frames to the latest (K, D, D)."""
    D = frames.state.shape[3]
    found = np.ones((len(at), D, D))
    if D > 1:
        for k in range(len(at)):
            number = frames.axes[at[k], frames.sizes[at[k]] - 1]
            motion_kernels.rotate(-turn_since(turned, number), found, k)
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def turn_since(turned, number):
    """Say by how much the axes turned from a frame to the latest [rad]; from a forgotten one, from the oldest known."""
    return turned.angles[-1] - turned.angles[max(number - turned.first_kept, 0)]


@njit(inline="always")
@typing.no_type_check
def _leave(frames, r):
    """Let the oldest frame of a window go."""
    n, D = frames.sizes[r] - 1, frames.state.shape[3]
    times, axes, is_off, state = frames.times, frames.axes, frames.is_off, frames.state
    shakes, doubts, rates, rate_covariances = frames.shakes, frames.doubts, frames.rates, frames.rate_covariances
    for j in range(n):
        times[r, j], axes[r, j], is_off[r, j] = times[r, j + 1], axes[r, j + 1], is_off[r, j + 1]
        for d in range(D):
            state[r, j, 0, d], state[r, j, 1, d] = state[r, j + 1, 0, d], state[r, j + 1, 1, d]
            rates[r, j, d] = rates[r, j + 1, d]
            for e in range(D):
                shakes[r, j, d, e], doubts[r, j, d, e] = shakes[r, j + 1, d, e], doubts[r, j + 1, d, e]
                rate_covariances[r, j, d, e] = rate_covariances[r, j + 1, d, e]
    covariance = frames.covariance
    for p in range(2 * D * n):
        for q in range(2 * D * n):
            covariance[r, p, q] = covariance[r, p + 2 * D, q + 2 * D]
    frames.sizes[r] = n


@njit(cache=True, nogil=True)
@typing.no_type_check
def learn_rate(frames, r):
    """Take the latest rate for what is known of it at its own time."""
    last, D = frames.sizes[r] - 1, frames.state.shape[3]
    first = 2 * D * last + D
    for d in range(D):
        frames.rates[r, last, d] = frames.state[r, last, 1, d]
        for e in range(D):
            frames.rate_covariances[r, last, d, e] = frames.covariance[r, first + d, first + e]


@njit(cache=True, nogil=True)
@typing.no_type_check
def forget(comparisons, r, frame):
    """Drop a window's comparisons with one of its frames."""
    counts, ends, measured = comparisons.counts, comparisons.ends, comparisons.measured
    kept = 0
    for c in range(counts[r]):
        if ends[r, c, 0] == frame or ends[r, c, 1] == frame:
            continue
        ends[r, kept, 0], ends[r, kept, 1] = ends[r, c, 0], ends[r, c, 1]
        for i in range(measured.shape[2]):
            measured[r, kept, i] = measured[r, c, i]
        kept += 1
    counts[r] = kept


@njit(cache=True, nogil=True)
@typing.no_type_check
def hear(is_off, comparisons, r, older, last, measured):
    """Take a comparison of a window's last frame with an older one into account, from the next solving on.

    One that says nothing is left out, and one with a look that is off; there has to be room for it.

    Args:
        is_off: see `rows.Frames`.
        comparisons: see `rows.Comparisons`; changed.
        r: which window.
        older, last: both frames.
        measured: see `rows.Comparisons` (2 D + 2 D D).
    """
    tells, c, D = False, comparisons.counts[r], 1 if len(measured) == 4 else 2
    for i in range(2 * D, 2 * D + D * D):
        tells |= measured[i] != 0.0
    if tells and not is_off[r, older]:
        comparisons.ends[r, c, 0], comparisons.ends[r, c, 1] = older, last
        for i in range(len(measured)):
            comparisons.measured[r, c, i] = measured[i]
        comparisons.counts[r] = c + 1


@njit(cache=True, nogil=True)
@typing.no_type_check
def place_last(state, times, r, last, place):
    """Say where a window's last frame is to be looked for first; rates are those that lead there."""
    seconds = times[r, last] - times[r, last - 1]
    for d in range(len(place)):
        rate = (place[d] - state[r, last - 1, 0, d]) / seconds
        state[r, last, 0, d] = place[d]
        state[r, last, 1, d] = state[r, last - 1, 1, d] = rate
