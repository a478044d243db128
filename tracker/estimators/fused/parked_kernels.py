"""How well standing and moving explain where objects were throughout their windows; compiled by numba, for `parked`."""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import motion_kernels, speed_kernels


@njit(cache=True, nogil=True)
@typing.no_type_check
def settle(frames, at, steps, classes, variances, changing, flow):
    """Weigh velocities with how fast objects are, and which stand; see `parked.settle`.

    Args:
        frames, at: see `log_likelihoods`.
        steps: of `steps.Steps`: owners, ends, numbers, lengths, velocities, covariances, places, slips, doubts.
        classes: shares of these before any object is measured, how fast they are, and how many objects that counts for.
        variances: of the ego's own place between two frames, of a slip [m^2], of the velocity of what stands [m^2/s^2].
        changing: see `log_likelihoods`.
        flow: see `speed_kernels.mix`, and the most that it can make a velocity likelier: a logarithm.

    Returns:
        velocities (N, 2), covariances (N, 2, 2), and what is left of doubts (N, 2, 2).
    """
    owners, ends, numbers, lengths, velocities, covariances, places, slips, doubts = steps
    (before, sds, strength), K, n = classes, len(at), 0
    latest = np.empty(K)
    for k in range(K):
        latest[k], n = slips[ends[k] - 1, 0], max(n, ends[k] - (ends[k - 1] if k > 0 else 0))
    logs = log_likelihoods(frames, at, latest, sds, variances[0], variances[1], changing)
    shares = speed_kernels.learned(before, logs, strength)
    standing = speed_kernels.of_class(shares, logs)[0].copy()
    means, spreads, is_known = np.zeros((K, n, 2)), np.zeros((K, n, 2, 2)), np.zeros((K, n), np.bool_)
    beside = np.zeros((K, n, 2)), np.zeros((K, n, 2))
    speed_kernels.together(
        owners, ends, numbers, lengths, velocities, covariances, places, slips,
        (means, spreads, is_known, beside[0], beside[1]),
    )  # fmt: skip
    nowhere = np.zeros((K, n, 2)), np.zeros((K, n, 2, 2))
    found, wide, gains = speed_kernels.mix(
        means, spreads, is_known, beside[0], nowhere[0], nowhere[1], sds[1:] ** 2, shares[1:].copy(), 1.0 - standing,
        (flow[0], flow[1]),
    )  # fmt: skip
    for k in range(K):
        gain = np.exp(min(gains[k], flow[2]))
        standing[k] /= standing[k] + (1.0 - standing[k]) * gain
    weighed, sure = velocities.copy(), covariances.copy()
    speed_kernels.apart(owners, ends, numbers, lengths, found, wide, weighed, sure)
    return speed_kernels.halted(owners, standing, variances[2], weighed, sure, doubts)


@njit(cache=True, nogil=True)
@typing.no_type_check
def log_likelihoods(frames, at, slips, sds, place_variance, slip_variance, changing):
    """Say how well standing and moving, slowly or fast, explain where objects were throughout their windows.

    The displacement's likelihood is a normal's about 0; moving makes it wider by the speed's.  So is that of how far
    the middle is off the line: what turns back may be where it was without ever having stood.  Source: Bayes' theorem
    over the mixture; each window is judged anew, since those of neighbouring frames share their evidence.

    Args:
        frames: of objects' windows, see `rows.Frames`.
        at: rows of K objects with two frames at least.
        slips: probability that what is seen of each object is off by `slip_variance` (K) [m^2].
        sds: how fast classes of objects are, along each axis (C) [m/s]; the first one stands.
        place_variance: of the ego's own place between two frames [m^2].
        changing: share of what moves that changes its velocity, and standard deviation of the acceleration [m/s^2].

    Returns:
        the log likelihood of each class for each object (C, K), up to a constant.
    """
    share, acceleration = changing
    found, whole, half = np.empty((len(sds), len(at))), np.empty(3), np.empty(3)
    state, times = frames.state, frames.times
    for k in range(len(at)):
        r, last = at[k], frames.sizes[at[k]] - 1
        ago = last // 2
        _difference(frames.covariance, r, 0, last, place_variance, whole)
        _difference(frames.covariance, r, ago, last, place_variance, half)
        seconds, short = times[r, last] - times[r, 0], times[r, last] - times[r, ago]
        x, y = state[r, last, 0, 0] - state[r, 0, 0, 0], state[r, last, 0, 1] - state[r, 0, 0, 1]
        x_bend = state[r, last, 0, 0] - state[r, ago, 0, 0] - short / seconds * x
        y_bend = state[r, last, 0, 1] - state[r, ago, 0, 1] - short / seconds * y
        steady = _log_density(x_bend, y_bend, half, 0.0)
        bent = _log_density(x_bend, y_bend, half, (0.5 * acceleration * short * (seconds - short)) ** 2)
        bending = np.logaddexp(np.log(1.0 - share) + steady, np.log(share) + bent)
        for c in range(len(sds)):
            beside = (sds[c] * seconds) ** 2
            surely = np.log(1.0 - slips[k]) + _log_density(x, y, whole, beside)
            off = np.log(slips[k]) + _log_density(x, y, whole, beside + slip_variance)
            found[c, k] = np.logaddexp(surely, off) + (steady if c == 0 else bending)
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def _difference(covariance, r, ago, last, beside, found):
    """Give the covariance of a window's last place less that of an older frame (xx, xy, yy)."""
    for m in range(3):
        d, e = m // 2, (m + 1) // 2
        found[m] = motion_kernels.difference(covariance, r, ago, last, d, e) + (beside if d == e else 0.0)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _log_density(x, y, covariance, beside):
    """Give the logarithm of a normal's density, but for a constant, with a variance beside its covariance."""
    a, b, c = covariance[0] + beside, covariance[1], covariance[2] + beside
    determinant = a * c - b * b
    return -0.5 * (np.log(determinant) + (c * x * x - 2.0 * b * x * y + a * y * y) / determinant)
