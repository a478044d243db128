"""Least squares over the windows of many objects, with heavy-tailed errors, compiled by numba; behind `window`.

An object's unknowns are, D numbers each for each frame: place and rate.  Comparisons of two frames measure the
difference of place, in the axes of their frames.  How these axes stand against ones that do not turn is unknown too,
and the same for all objects: eliminating the objects one by one (Schur complement) leaves a small system for the axes.

Loops over comparisons take arrays out of the tuples first, hand them on whole, with the row that is meant, and make
none: numba counts references to arrays, with locked instructions, wherever a tuple or a row is taken apart, which was
half of the time.
numba optimises what is called once more within its caller: large functions, and those that are called in one place,
are put into that (`inline`), or all of them would be compiled twice.  Its cache looks at the caller's file only: after
a change in a neighbour, delete `__pycache__/*.nb*` beside it.

Source: iteratively reweighted least squares for Student's t (`heavy_tails`); elimination as in bundle adjustment,
Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 6.1.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import axes_kernels, claims, heavy_tails, motion_kernels, start_kernels

MOST_ITERATIONS = 3
SETTLED = 1e-4  # largest change of a number that ends the iterations [m, m/s, rad, rad/s]
TURN_SETTLED = 1e-5  # and of the axes' angles [rad]
# Of the axes in one iteration [rad], and how many iterations more that may take: what is round looks straight from axes
# that turn with it, and least squares would jump between the two.
LARGEST_TURN, MOST_SHORT = 0.01, 12
# Degrees of freedom of what changes an acceleration: brakes are hit, or they are not.
CHANGE_TAIL = 1.0
ANCHOR = 1e6  # information of the first place, which only fixes where zero is [1/m^2, 1/rad^2]


@njit(inline="always")
@typing.no_type_check
def solve(windows, axes, densities, tails, claimed):
    """Find the most likely unknowns of all frames, and their covariance.

    Args:
        windows: see `problem.Problem`.
        axes: see `problem.Axes`; at least one, that nothing may refer to.
        densities: spectral densities of the objects' white acceleration and of what changes it [m^2/s^3, m^2/s^5;
            rad^2/s^3, rad^2/s^5].
        tails: degrees of freedom of the errors of comparisons and of the motion; 0: normal.
        claimed: how many comparisons the claims of an object's errors count for; see `claims.scale`.

    Returns:
        the unknowns in the axes of their frames (N, 2, D); each object's covariance over all its frames (K, 2 n D,
        2 n D), padded by zeros; angles, rates of the axes (G), and the variance of the latest rate; what was
        chosen to start from (see `start_kernels.Chosen`).
    """
    K, G, D = len(windows.sizes), len(axes.times), windows.state.shape[2]
    width = 2 * D * windows.sizes.max()
    angles, rates = axes.angles.copy(), axes.rates.copy()
    x, motions = _begin(windows, angles, densities[0], D)
    if D > 1:
        chosen = start_kernels.choose(x, windows, axes_kernels.to_steady(windows, angles, D), tails)
    else:  # turns are told well enough, and slow
        chosen = start_kernels.nothing(K, D)
    n_open = G if D > 1 and windows.axes.max() >= 0 else 0  # axes that any object tells of
    H, b, L = np.zeros((K, width, width)), np.zeros((K, width)), np.zeros((K, width, n_open))
    x_alone, levers = b.copy(), L.copy()
    common, scales = np.zeros((2 * G, 2 * G)), np.ones(K)
    iteration = n_short = 0
    while iteration < MOST_ITERATIONS:
        A, a = axes_kernels.of_turns(axes, angles, rates)
        rotations = axes_kernels.to_steady(windows, angles, D)
        frame = comparison = np.int64(0)  # not a literal 0, for which numba would compile all that takes it once more
        for k in range(K):
            m = 2 * D * windows.sizes[k]
            H[k], b[k], L[k] = 0.0, 0.0, 0.0
            misfit, n_told = _add_object(
                H[k], b[k], L[k], A, a, x[k], k, frame, comparison, windows, motions, rotations, tails, scales[k], D
            )
            if np.isfinite(densities[1]):
                times = windows.times[frame : frame + windows.sizes[k]]
                _add_changes(H[k], x[k], times, densities[1], scales[k], D)
            scales[k] = claims.scale(claimed, misfit, n_told)
            _eliminate(H[k, :m, :m], b[k], L[k], A, a, x_alone[k], levers[k])
            frame, comparison = frame + windows.sizes[k], comparison + windows.counts[k]
        common = np.linalg.inv(A)
        # the last step leaves the axes where they are: places and axes must fit each other
        step = common @ a if iteration + 1 < MOST_ITERATIONS else np.zeros(2 * G)
        largest = np.abs(step[:G]).max()
        if largest > LARGEST_TURN:
            step *= LARGEST_TURN / largest
            n_short += 1
        iteration += 1 if largest <= LARGEST_TURN or n_short > MOST_SHORT else 0
        angles, rates = angles + step[:G], rates + step[G:]
        change = 0.0  # the first iteration takes claims as they are
        for k in range(K):
            found = x_alone[k] + levers[k] @ step[:n_open]
            change = max(change, np.abs(found - x[k]).max())
            x[k] = found
        if iteration > 1 and change < SETTLED and np.abs(step[:G]).max() < TURN_SETTLED:
            break
    state = axes_kernels.in_own_axes(x, H, levers, common[:n_open, :n_open].copy(), windows, angles, D)
    return state, H, angles, rates, common[2 * G - 1, 2 * G - 1], chosen


@njit(inline="always")
@typing.no_type_check
def _eliminate(H, b, L, A, a, x, levers):
    """Solve an object's own system, and leave to that of the axes what it tells of these.

    x becomes the unknowns if the axes stay where they are, `levers` how these go with the axes' angles.
    """
    m, n_open = len(H), L.shape[1]
    right = np.empty((m, n_open + 1))
    right[:, 0], right[:, 1:] = b[:m], L[:m]
    right[:] = np.linalg.solve(H, right)
    x[:m], levers[:m] = right[:, 0], -right[:, 1:]
    if n_open:
        reduced = L[:m].T @ right
        A[:n_open, :n_open] -= reduced[:, 1:]
        a[:n_open] -= reduced[:, 0]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _begin(windows, angles, density, D):
    """Give all unknowns in steady axes, padded (K, 2 n D), and the information of each step of motion (N, 4 D, 4 D)."""
    x = np.zeros((len(windows.sizes), 2 * D * windows.sizes.max()))
    motions = np.zeros((len(windows.times), 4 * D, 4 * D))
    rotations, f = axes_kernels.to_steady(windows, angles, D), 0
    sizes, times, state, shakes = windows.sizes, windows.times, windows.state, windows.shakes
    for k in range(len(sizes)):
        for j in range(sizes[k]):
            for p in range(2):
                for d in range(D):
                    for e in range(D):
                        x[k, (2 * j + p) * D + d] += rotations[f, d, e] * state[f, p, e]
            if j + 1 < sizes[k]:
                motions[f] = motion_kernels.information(times[f + 1] - times[f], density, shakes[f + 1], D)
            f += 1
    return x, motions


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_object(H, b, L, A, a, x, k, frame, comparison, windows, motions, rotations, tails, scale, D):
    """Add what is known of an object to its own system (H, b), to its levers L on the axes, and to theirs (A, a).

    Variances are `scale` times those claimed.  Returns how far all is off, and how many comparisons tell of that.
    """
    R = rotations[frame]
    _add_beginning(H, b, x, R @ windows.rates[k], R @ windows.rate_informations[k] @ R.T, D)
    misfit = n_told = 0.0
    for i in range(windows.sizes[k] - 1):
        misfit += _add_motion(H, x, i, motions, frame + i, tails[1], scale, D)
    ends, olders, newers, numbers = windows.ends, windows.olders, windows.newers, windows.axes
    informations, doubts = windows.informations, windows.doubts
    own, information, at, step = np.empty((D, D)), np.empty((D, D)), np.empty((2, D)), np.empty(D)
    for c in range(comparison, comparison + windows.counts[k]):
        i, j = frame + ends[c, 0], frame + ends[c, 1]
        older, newer = 2 * D * ends[c, 0], 2 * D * ends[c, 1]
        part = claims.believe(informations, doubts, c, scale, D, own)
        for d in range(D):
            at[0, d] = at[1, d] = 0.0
            for e in range(D):
                at[0, d] += rotations[j, d, e] * newers[c, e]
                at[1, d] += rotations[i, d, e] * olders[c, e]
            step[d] = at[0, d] - at[1, d]
        axes_kernels.turn(own, rotations, j, D, information)
        distance = _distance(x, older, newer, step, information, D)
        weight = heavy_tails.weight(tails[0], D, distance)
        for d in range(D):
            for e in range(D):
                information[d, e] *= weight
        _add_step(H, b, older, newer, step, information, D)
        if D > 1 and max(numbers[i], numbers[j]) >= 0:
            axes_kernels.add_lever(L, A, a, (numbers[j], numbers[i]), (newer, older), at, step, information)
        misfit, n_told = misfit + part * weight * distance * scale, n_told + part
    return misfit, n_told


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_beginning(H, b, x, rate_mean, rate_information, D):
    """Add what is known of the first frame; its place stays where it is."""
    for d in range(D):
        H[d, d] += ANCHOR
        b[d] += ANCHOR * x[d]
        for e in range(D):
            H[D + d, D + e] += rate_information[d, e]
            b[D + d] += rate_information[d, e] * rate_mean[e]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_motion(H, x, i, motions, f, tail, scale, D):
    """Add step i of the motion, of which row f tells, and give how far it is off: its weighed squared distance."""
    first, distance = 2 * D * i, 0.0
    for p in range(4 * D):
        for q in range(4 * D):
            distance += x[first + p] * motions[f, p, q] * x[first + q]
    weight = heavy_tails.weight(tail, 2 * D, distance / scale)
    for p in range(4 * D):
        for q in range(4 * D):
            H[first + p, first + q] += weight / scale * motions[f, p, q]
    return weight * distance


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_changes(H, x, times, density, scale, D):
    """Add that accelerations last: those of neighbouring steps differ by what `density` dt allows."""
    c = np.empty(3)  # of the rates at three frames
    for i in range(1, len(times) - 1):
        before, after = times[i] - times[i - 1], times[i + 1] - times[i]
        c[0], c[1], c[2] = 1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after
        first, variance, distance = 2 * D * (i - 1) + D, density * 0.5 * (before + after), 0.0
        for d in range(D):
            change = 0.0
            for p in range(3):
                change += c[p] * x[first + 2 * D * p + d]
            distance += change**2 / variance
        information = heavy_tails.weight(CHANGE_TAIL, D, distance / scale) / scale / variance
        for d in range(D):
            for p in range(3):
                for q in range(3):
                    H[first + 2 * D * p + d, first + 2 * D * q + d] += information * c[p] * c[q]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _distance(x, older, newer, step, information, D):
    """Give how far places are off a step between them: a squared distance."""
    distance = 0.0
    for d in range(D):
        for e in range(D):
            p, q = x[newer + d] - x[older + d] - step[d], x[newer + e] - x[older + e] - step[e]
            distance += p * information[d, e] * q
    return distance


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_step(H, b, older, newer, step, information, D):
    """Add a difference of place between the frames that begin at `older` and `newer`."""
    for d in range(D):
        pull = 0.0
        for e in range(D):
            share = information[d, e]
            pull += share * step[e]
            H[newer + d, newer + e] += share
            H[older + d, older + e] += share
            H[newer + d, older + e] -= share
            H[older + d, newer + e] -= share
        b[newer + d] += pull
        b[older + d] -= pull
