"""Velocities weighed with how fast objects may be, a mixture of normals; compiled by numba, behind `speeds`."""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def mix(velocities, covariances, is_known, slips, expected, doubts, variances, shares, moving, flow):  # noqa: PLR0913
    """Give mean and covariance of each object's velocity, when what is known before it is measured is a mixture.

    Its first parts are normal about `expected`, the others about what the other objects have at the same time.  The
    error of what was measured is a mixture of two normals, one of them wide.

    Source: Bayes' theorem over all pairs of a part and an error; each pair's mean and covariance are a Kalman update's.

    Args:
        velocities: measured, of K objects at N times (K, N, 2) [m/s].
        covariances: of these (K, N, 2, 2).
        is_known: whether there are any (K, N).
        slips: probability that the measured is off, and the variance that it then has beside its own (K, N, 2).
        expected: what the first C parts are about (K, N, 2) [m/s].
        doubts: covariance of that (K, N, 2, 2).
        variances: what each of these parts has beside it, along each axis (C) [m^2/s^2].
        shares: of these parts, for each object (C, K).
        moving: probability that each object moves (K).
        flow: share of those that move as another one does, if all others move; what they have beside the covariance of
            the other's velocity, along each axis [m^2/s^2].

    Returns:
        means (K, N, 2) and covariances (K, N, 2, 2), as they were where nothing is known; logarithm of how much
        likelier the velocity at the first of the times is by all parts than by the first ones (K).
    """
    K, N, C = velocities.shape[0], velocities.shape[1], len(variances)
    means, found, gains = velocities.copy(), covariances.copy(), np.zeros(K)
    logs, parts = np.empty(2 * (C + K)), np.empty((2 * (C + K), 5))
    followed = flow[0] / max(K - 1, 1) * moving  # as each object's are, the others' parts
    for k in range(K):
        alone = 1.0 - (followed.sum() - followed[k])
        for n in range(N):
            if not is_known[k, n]:
                continue
            m = np.int64(0)  # not a literal; see window_kernels
            x, y, slip, wide = velocities[k, n, 0], velocities[k, n, 1], slips[k, n, 0], slips[k, n, 1]
            own = covariances[k, n, 0, 0], covariances[k, n, 0, 1], covariances[k, n, 1, 1]
            for c in range(C):
                p, q, r = doubts[k, n, 0, 0] + variances[c], doubts[k, n, 0, 1], doubts[k, n, 1, 1] + variances[c]
                off = x - expected[k, n, 0], y - expected[k, n, 1]
                m = _add(logs, parts, m, off, own, (p, q, r), alone * shares[c, k], (slip, wide))
            first = m
            for j in range(K):
                if j != k and followed[j] > 0.0 and is_known[j, n]:
                    p, q, r = covariances[j, n, 0, 0], covariances[j, n, 0, 1], covariances[j, n, 1, 1]
                    wider = flow[1] + slips[j, n, 0] * slips[j, n, 1]
                    off = x - velocities[j, n, 0], y - velocities[j, n, 1]
                    m = _add(logs, parts, m, off, own, (p + wider, q, r + wider), followed[j], (slip, wide))
            if n == 0:
                highest = logs[:first].max()
                gains[k] = np.log(np.exp(logs[:m] - highest).sum() / np.exp(logs[:first] - highest).sum())
            _sum_up(logs, parts, m, means, found, k, n)
    return means, found, gains


@njit(cache=True, nogil=True)
@typing.no_type_check
def together(owners, ends, numbers, lengths, velocities, covariances, places, slips, found):  # noqa: PLR0913
    """Put steps from one frame to the next side by side, by how many frames ago they ended; see `speeds.together`.

    Args:
        owners, numbers, lengths: see `steps.Steps` (N).
        ends: where each of K objects' steps end (K).
        velocities, places: (N, 2).
        covariances: (N, 2, 2).
        slips: (N, 2).
        found: written: velocities (K, n, 2), covariances (K, n, 2, 2), is_known (K, n), slips and places (K, n, 2).
    """
    means, spreads, is_known, own_slips, own_places = found
    for i in range(len(owners)):
        k = owners[i]
        back = numbers[ends[k] - 1] - numbers[i]
        if lengths[i] != 1 or back >= is_known.shape[1]:
            continue
        is_known[k, back] = True
        for d in range(2):
            means[k, back, d], own_slips[k, back, d] = velocities[i, d], slips[i, d]
            own_places[k, back, d] = places[i, d]
            for e in range(2):
                spreads[k, back, d, e] = covariances[i, d, e]


@njit(cache=True, nogil=True)
@typing.no_type_check
def apart(owners, ends, numbers, lengths, means, spreads, velocities, covariances):  # noqa: PLR0913
    """Do the reverse of `together`: into velocities (N, 2) and covariances (N, 2, 2), where steps have a place."""
    for i in range(len(owners)):
        k = owners[i]
        back = numbers[ends[k] - 1] - numbers[i]
        if lengths[i] == 1 and back < means.shape[1]:
            for d in range(2):
                velocities[i, d] = means[k, back, d]
                for e in range(2):
                    covariances[i, d, e] = spreads[k, back, d, e]


@njit(cache=True, nogil=True)
@typing.no_type_check
def of_class(shares, logs):
    """Give probabilities of C classes for K objects, of shares and log likelihoods (C, K)."""
    found = np.empty(logs.shape)
    for k in range(logs.shape[1]):
        highest, total = -np.inf, 0.0
        for c in range(logs.shape[0]):
            found[c, k] = np.log(shares[c, k]) + logs[c, k]
            highest = max(highest, found[c, k])
        for c in range(logs.shape[0]):
            found[c, k] = np.exp(found[c, k] - highest)
            total += found[c, k]
        for c in range(logs.shape[0]):
            found[c, k] /= total
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def learned(before, logs, strength):
    """Give the shares of C classes for each of K objects (C, K); see `speeds.learned`.

    Args:
        before: shares of the classes (C).
        logs: log likelihoods (C, K).
        strength: objects that `before` counts for.
    """
    (C, K), shares = logs.shape, np.empty(logs.shape)
    for c in range(C):
        shares[c] = before[c]
    counts = of_class(shares, logs)
    for c in range(C):
        total = counts[c].sum()
        for k in range(K):
            shares[c, k] = (strength * before[c] + total - counts[c, k]) / (strength + K - 1.0)
    return shares


@njit(cache=True, nogil=True)
@typing.no_type_check
def halted(owners, standing, variance, velocities, covariances, doubts):
    """Give mean and covariance of velocities that are 0 with a probability, and what is left of the doubts.

    Args:
        owners: of N steps, which of K objects each is of.
        standing: probability that each object stands (K).
        variance: of the velocity of what stands [m^2/s^2].
        velocities, covariances, doubts: else (N, 2), (N, 2, 2), (N, 2, 2).
    """
    means, spreads, left = np.empty(velocities.shape), np.empty(covariances.shape), np.empty(doubts.shape)
    for i in range(len(owners)):
        share = standing[owners[i]]
        moving = 1.0 - share
        for d in range(2):
            means[i, d] = moving * velocities[i, d]
            for e in range(2):
                spread = moving * covariances[i, d, e] + share * moving * velocities[i, d] * velocities[i, e]
                spreads[i, d, e] = spread + (share * variance if d == e else 0.0)
                left[i, d, e] = moving * doubts[i, d, e]
    return means, spreads, left


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add(logs, parts, m, off, own, beside, weight, slip):
    """Add the two parts, by either error, of a velocity that is `off` the middle of a normal; say how many there are.

    A part is a logarithm of its likelihood, and by how much its mean differs from what was measured (2), and its
    covariance (xx, xy, yy).  Covariances come as such threes too.
    """
    for is_off in range(2):
        share = weight * (slip[0] if is_off == 1 else 1.0 - slip[0])
        if share <= 0.0:
            continue
        wide = is_off * slip[1]
        a, b, c = own[0] + wide, own[1], own[2] + wide
        u, v, w = a + beside[0], b + beside[1], c + beside[2]
        determinant = u * w - v * v
        x, y = (w * off[0] - v * off[1]) / determinant, (u * off[1] - v * off[0]) / determinant
        logs[m] = np.log(share) - 0.5 * (np.log(determinant) + off[0] * x + off[1] * y)
        parts[m, 0], parts[m, 1] = -a * x - b * y, -b * x - c * y
        # own - own (own + beside)^-1 own
        parts[m, 2] = a - (a * a * w - 2.0 * a * b * v + b * b * u) / determinant
        parts[m, 3] = b - (a * b * w - (a * c + b * b) * v + b * c * u) / determinant
        parts[m, 4] = c - (b * b * w - 2.0 * b * c * v + c * c * u) / determinant
        m += 1
    return m


@njit(cache=True, nogil=True)
@typing.no_type_check
def _sum_up(logs, parts, m, means, found, k, n):
    """Put mean and covariance of all m parts in place of what was measured."""
    highest, total, x, y = logs[:m].max(), 0.0, 0.0, 0.0
    for i in range(m):
        weight = np.exp(logs[i] - highest)
        total, x, y = total + weight, x + weight * parts[i, 0], y + weight * parts[i, 1]
    x, y, xx, xy, yy = x / total, y / total, 0.0, 0.0, 0.0
    for i in range(m):
        weight, dx, dy = np.exp(logs[i] - highest) / total, parts[i, 0] - x, parts[i, 1] - y
        xx += weight * (parts[i, 2] + dx * dx)
        xy += weight * (parts[i, 3] + dx * dy)
        yy += weight * (parts[i, 4] + dy * dy)
    means[k, n, 0] += x
    means[k, n, 1] += y
    found[k, n, 0, 0], found[k, n, 1, 1] = xx, yy
    found[k, n, 0, 1] = found[k, n, 1, 0] = xy
