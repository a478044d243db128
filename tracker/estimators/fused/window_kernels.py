"""Least squares over the windows of many objects, with heavy-tailed errors, compiled by numba; behind `window`.

An object's unknowns are, D numbers each for each frame: place, rate, and the offset by which what was seen of it is
off.  Comparisons of two frames measure the difference of place plus offset, in the axes of their frames.  How these
axes stand against ones that do not turn is unknown too, and the same for all objects: eliminating the objects one by
one (Schur complement) leaves a small system for the axes.

Sources: Student's t as a scale mixture of normals, Lange, Little & Taylor, "Robust statistical modeling using the t
distribution", JASA 84(408), 1989; elimination as in bundle adjustment, Triggs et al., "Bundle adjustment - a modern
synthesis", 2000, section 6.1.
"""

import typing
from typing import NamedTuple

import numpy as np
from numba import njit

MOST_ITERATIONS = 6
SETTLED = 1e-4  # largest change of a number that ends the iterations [m, m/s, rad, rad/s]
TURN_SETTLED = 1e-5  # and of the axes' angles [rad]
ANCHOR = 1e6  # information of the first place, which only fixes where zero is [1/m^2, 1/rad^2]
FIXED = 1e8  # information of the first angle [1/rad^2]
TURN_TAILS = (3.0, 4.0)  # degrees of freedom of the errors of what is heard of turns, and of their rate's change


class Windows(NamedTuple):
    """The windows of K objects, one after the other; N frames and M comparisons in all.

    Attributes:
        sizes: frames of each object (K).
        counts: comparisons of each object (K).
        times: of the frames [s] (N).
        axes: number of each frame among the open axes, or -1 (N).
        angles: of the axes of each frame [rad] (N); for open ones, where to start from.
        state: unknowns to start from, in the axes of their frames (N, 3, D).
        shakes: covariance that each frame's place has beside that of the motion (N, D, D); an object's first: unused.
        offset_sds: standard deviation of each frame's offset (N).
        rates: what is known of the rate at each object's first frame (K, D).
        rate_informations: inverse covariance of that (K, D, D).
        ends: older and newer frame of each comparison, within its object (M, 2).
        olders: the point whose motion was measured, in the axes of the older frame (M, D).
        newers: where it was in the newer frame, in the axes of that (M, D).
        informations: inverse covariance of the difference, in the axes of the newer frame (M, D, D).
    """

    sizes: np.ndarray
    counts: np.ndarray
    times: np.ndarray
    axes: np.ndarray
    angles: np.ndarray
    state: np.ndarray
    shakes: np.ndarray
    offset_sds: np.ndarray
    rates: np.ndarray
    rate_informations: np.ndarray
    ends: np.ndarray
    olders: np.ndarray
    newers: np.ndarray
    informations: np.ndarray


class Axes(NamedTuple):
    """The open axes, G of them.

    Attributes:
        times: [s] (G).
        angles, rates: to start from (G).
        first_rate: rate at the first, as known before, and its variance (2).
        heard: numbers of an older and a newer one, turn between them, information of that (H, 4).
        density: spectral density of the rate's change [rad^2/s^3].
    """

    times: np.ndarray
    angles: np.ndarray
    rates: np.ndarray
    first_rate: np.ndarray
    heard: np.ndarray
    density: float


@njit(cache=True, nogil=True)
@typing.no_type_check
def solve(windows, axes, density, tails):
    """Find the most likely unknowns of all frames, and their covariance.

    Args:
        windows: see `Windows`.
        axes: see `Axes`; at least one, that nothing may refer to.
        density: spectral density of the objects' white acceleration [m^2/s^3, rad^2/s^3].
        tails: degrees of freedom of the errors of comparisons, of offsets, and of the motion; 0: normal.

    Returns:
        the unknowns in the axes of their frames (N, 3, D); each object's covariance over all its frames (K, 3 n D,
        3 n D), padded by zeros; angles, rates of the axes (G), and the variance of the latest rate.
    """
    K, G, D = len(windows.sizes), len(axes.times), windows.state.shape[2]
    width = 3 * D * windows.sizes.max()
    angles, rates = axes.angles.copy(), axes.rates.copy()
    x, motions = _begin(windows, angles, density, D)
    H, b, L = np.zeros((K, width, width)), np.zeros((K, width)), np.zeros((K, width, G))
    x_alone, levers = b.copy(), L.copy()
    common = np.zeros((2 * G, 2 * G))
    for iteration in range(MOST_ITERATIONS):
        A, a = _of_turns(axes, angles, rates)
        rotations = _rotations(windows, angles, D)
        frame = comparison = 0
        for k in range(K):
            m = 3 * D * windows.sizes[k]
            H[k], b[k], L[k] = 0.0, 0.0, 0.0
            _add_object(H[k], b[k], L[k], A, a, x[k], k, frame, comparison, windows, motions, rotations, tails, D)
            right = np.empty((m, G + 1))
            right[:, 0], right[:, 1:] = b[k, :m], L[k, :m]
            found = np.linalg.solve(H[k, :m, :m], right)
            x_alone[k, :m], levers[k, :m] = found[:, 0], -found[:, 1:]
            reduced = L[k, :m].T @ found
            A[:G, :G] -= reduced[:, 1:]
            a[:G] -= reduced[:, 0]
            frame, comparison = frame + windows.sizes[k], comparison + windows.counts[k]
        common = np.linalg.inv(A)
        # the last step leaves the axes where they are: places and axes must fit each other
        step = common @ a if iteration + 1 < MOST_ITERATIONS else np.zeros(2 * G)
        angles, rates = angles + step[:G], rates + step[G:]
        change = 0.0
        for k in range(K):
            found = x_alone[k] + levers[k] @ step[:G]
            change = max(change, np.abs(found - x[k]).max())
            x[k] = found
        if change < SETTLED and np.abs(step[:G]).max() < TURN_SETTLED:
            break
    state = _in_own_axes(x, H, levers, common[:G, :G].copy(), windows, angles, D)
    return state, H, angles, rates, common[2 * G - 1, 2 * G - 1]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _begin(windows, angles, density, D):
    """Give all unknowns in steady axes, padded (K, 3 n D), and the information of each step of motion (N, 4 D, 4 D)."""
    x = np.zeros((len(windows.sizes), 3 * D * windows.sizes.max()))
    motions = np.zeros((len(windows.times), 4 * D, 4 * D))
    rotations, f = _rotations(windows, angles, D), 0
    for k in range(len(windows.sizes)):
        for j in range(windows.sizes[k]):
            for p in range(3):
                x[k, (3 * j + p) * D : (3 * j + p + 1) * D] = rotations[f] @ windows.state[f, p]
            if j + 1 < windows.sizes[k]:
                motions[f] = _motion(windows.times[f + 1] - windows.times[f], density, windows.shakes[f + 1], D)
            f += 1
    return x, motions


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_object(H, b, L, A, a, x, k, frame, comparison, windows, motions, rotations, tails, D):
    """Add what is known of an object to its own system (H, b), to its levers L on the axes, and to theirs (A, a)."""
    R = rotations[frame]
    _add_beginning(H, b, x, R @ windows.rates[k], R @ windows.rate_informations[k] @ R.T, D)
    for i in range(windows.sizes[k] - 1):
        _add_motion(H, x, i, motions[frame + i], tails[2], D)
    for i in range(windows.sizes[k]):
        _add_offset(H, x, i, windows.offset_sds[frame + i], tails[1], D)
    for c in range(comparison, comparison + windows.counts[k]):
        _add_comparison(H, b, L, A, a, x, c, frame, windows, rotations, tails[0], D)


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
def _motion(dt, density, shake, D):
    """Give the information of one step of a motion of nearly constant rate over (place, rate) at both its ends."""
    Q = np.zeros((2 * D, 2 * D))
    Q[:D, :D] = shake
    J = np.zeros((2 * D, 4 * D))
    for d in range(D):
        Q[d, d] += density * dt**3 / 3.0
        Q[d, D + d] = Q[D + d, d] = density * dt**2 / 2.0
        Q[D + d, D + d] = density * dt
        J[d, D + d] = -dt
    for d in range(2 * D):
        J[d, d], J[d, 2 * D + d] = -1.0, 1.0
    return J.T @ np.linalg.inv(Q) @ J


@njit(cache=True, nogil=True)
@typing.no_type_check
def _weight(tail, dimension, distance):
    """Weigh a squared Mahalanobis distance by Student's t; what is nearer than expected counts no more for it."""
    return min((tail + dimension) / (tail + distance), 1.0) if tail > 0.0 else 1.0


@njit(cache=True, nogil=True)
@typing.no_type_check
def _place(a, i, D):
    """Say where the a-th of (place, rate) of frame i and (place, rate) of frame i + 1 stands."""
    return 3 * D * i + a if a < 2 * D else 3 * D * (i + 1) + a - 2 * D


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_motion(H, x, i, motion, tail, D):
    u = np.empty(4 * D)
    for a in range(4 * D):
        u[a] = x[_place(a, i, D)]
    weight = _weight(tail, 2 * D, u @ motion @ u)
    for a in range(4 * D):
        for c in range(4 * D):
            H[_place(a, i, D), _place(c, i, D)] += weight * motion[a, c]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_offset(H, x, i, sd, tail, D):
    first, distance = 3 * D * i + 2 * D, 0.0
    for d in range(D):
        distance += (x[first + d] / sd) ** 2
    weight = _weight(tail, D, distance)
    for d in range(D):
        H[first + d, first + d] += weight / sd**2


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_comparison(H, b, L, A, a, x, c, frame, windows, rotations, tail, D):
    """Add comparison c: x_newer - x_older = R_newer q_newer - R_older q_older, about the present angles."""
    i, j = frame + windows.ends[c, 0], frame + windows.ends[c, 1]
    older, newer = 3 * D * windows.ends[c, 0], 3 * D * windows.ends[c, 1]
    Ri, Rj = rotations[i], rotations[j]
    ends, step, off, information = np.zeros((2, D)), np.empty(D), np.empty(D), np.zeros((D, D))
    for d in range(D):
        for e in range(D):
            ends[0, d] += Rj[d, e] * windows.newers[c, e]
            ends[1, d] += Ri[d, e] * windows.olders[c, e]
            for p in range(D):
                for q in range(D):
                    information[d, e] += Rj[d, p] * windows.informations[c, p, q] * Rj[e, q]
        step[d] = ends[0, d] - ends[1, d]
        off[d] = x[newer + d] + x[newer + 2 * D + d] - x[older + d] - x[older + 2 * D + d] - step[d]
    distance = 0.0
    for d in range(D):
        for e in range(D):
            distance += off[d] * information[d, e] * off[e]
    information *= _weight(tail, D, distance)
    _add_step(H, b, older, newer, step, information, D)
    if D > 1 and max(windows.axes[i], windows.axes[j]) >= 0:
        _add_lever(L, A, a, (windows.axes[j], windows.axes[i]), (newer, older), ends, step, information)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_step(H, b, older, newer, step, information, D):
    """Add a difference of place plus offset between the frames that begin at `older` and `newer`."""
    for d in range(D):
        pull = 0.0
        for e in range(D):
            share = information[d, e]
            pull += share * step[e]
            for p in range(0, 3 * D, 2 * D):  # place and offset
                for q in range(0, 3 * D, 2 * D):
                    H[newer + p + d, newer + q + e] += share
                    H[older + p + d, older + q + e] += share
                    H[newer + p + d, older + q + e] -= share
                    H[older + p + d, newer + q + e] -= share
        for p in range(0, 3 * D, 2 * D):
            b[newer + p + d] += pull
            b[older + p + d] -= pull


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_lever(L, A, a, numbers, at, ends, step, information):
    """Add how a comparison's step in steady axes changes with the angles of both frames."""
    for s in range(2):
        if numbers[s] < 0:
            continue
        sign = 1.0 - 2.0 * s
        x = sign * (information[0, 1] * ends[s, 0] - information[0, 0] * ends[s, 1])
        y = sign * (information[1, 1] * ends[s, 0] - information[1, 0] * ends[s, 1])
        a[numbers[s]] -= x * step[0] + y * step[1]
        for t in range(2):
            sign = 1.0 - 2.0 * t
            if numbers[t] >= 0:
                A[numbers[s], numbers[t]] += sign * (y * ends[t, 0] - x * ends[t, 1])
            for p in range(0, 6, 4):  # place and offset
                L[at[t] + p, numbers[s]] -= sign * x
                L[at[t] + p + 1, numbers[s]] -= sign * y


@njit(cache=True, nogil=True)
@typing.no_type_check
def _of_turns(axes, angles, rates):
    """Give the system of changes of the axes' angles and rates, from what is known of these alone."""
    G = len(axes.times)
    A, a = np.zeros((2 * G, 2 * G)), np.zeros(2 * G)
    A[0, 0] = FIXED
    A[G, G] = 1.0 / axes.first_rate[1]
    a[G] = (axes.first_rate[0] - rates[0]) / axes.first_rate[1]
    u, at = np.empty(4), np.empty(4, np.int64)
    for g in range(G - 1):
        motion = _motion(axes.times[g + 1] - axes.times[g], axes.density, np.zeros((1, 1)), 1)
        at[0], at[1], at[2], at[3] = g, G + g, g + 1, G + g + 1
        u[0], u[1], u[2], u[3] = angles[g], rates[g], angles[g + 1], rates[g + 1]
        pull = motion @ u
        weight = _weight(TURN_TAILS[1], 2, u @ pull)
        for p in range(4):
            a[at[p]] -= weight * pull[p]
            for q in range(4):
                A[at[p], at[q]] += weight * motion[p, q]
    for h in range(len(axes.heard)):
        i, j = int(axes.heard[h, 0]), int(axes.heard[h, 1])
        off = axes.heard[h, 2] - (angles[j] - angles[i])
        weight = _weight(TURN_TAILS[0], 1, off**2 * axes.heard[h, 3]) * axes.heard[h, 3]
        a[j] += weight * off
        a[i] -= weight * off
        A[i, i] += weight
        A[j, j] += weight
        A[i, j] -= weight
        A[j, i] -= weight
    return A, a


@njit(cache=True, nogil=True)
@typing.no_type_check
def _rotations(windows, angles, D):
    """Turn each frame's axes to the steady ones (N, D, D); a turn itself is no vector, and needs none."""
    rotations = np.ones((len(windows.times), D, D))
    if D > 1:
        for f in range(len(windows.times)):
            angle = angles[windows.axes[f]] if windows.axes[f] >= 0 else windows.angles[f]
            c, s = np.cos(angle), np.sin(angle)
            rotations[f] = np.array([[c, -s], [s, c]])
    return rotations


@njit(cache=True, nogil=True)
@typing.no_type_check
def _in_own_axes(x, H, levers, common, windows, angles, D):
    """Turn unknowns back to the axes of their frames; put their covariances, with what the axes add, in place of H."""
    state, rotations = np.zeros(windows.state.shape), _rotations(windows, angles, D)
    frame = 0
    for k in range(len(windows.sizes)):
        m = 3 * D * windows.sizes[k]
        turn, lever = np.zeros((m, m)), levers[k, :m].copy()
        for j in range(windows.sizes[k]):
            R = rotations[frame].T
            for p in range(3):
                at = (3 * j + p) * D
                turn[at : at + D, at : at + D] = R
                state[frame, p] = R @ x[k, at : at + D]
            frame += 1
        lever = turn @ lever
        for j in range(windows.sizes[k]):
            f = frame - windows.sizes[k] + j
            if D == 2 and windows.axes[f] >= 0:
                lever[3 * j * D, windows.axes[f]] += state[f, 0, 1]
                lever[3 * j * D + 1, windows.axes[f]] -= state[f, 0, 0]
        own = turn @ np.linalg.inv(H[k, :m, :m].copy()) @ turn.T
        H[k, :m, :m] = own + lever @ common @ lever.T
    return state


@njit(cache=True, nogil=True)
@typing.no_type_check
def advance(state, covariance, dt, turned, model, is_full):
    """Add a frame where the motion would lead; a full window loses its first one.

    Args:
        state: (n, 3, D), in the axes of the frames.
        covariance: of all of it (3 n D, 3 n D).
        dt: [s].
        turned: rotation from the last frame's axes to the new one's (D, D).
        model: density of the acceleration's noise, covariance that the place has beside that (D, D), standard
            deviation of the new offset.
        is_full: whether the first frame goes.

    Returns:
        both, with the new frame.
    """
    density, shake, offset_sd = model
    n, D = state.shape[0], state.shape[2]
    first = 1 if is_full else 0
    size, gone, last = 3 * D * (n - first), 3 * D * first, 3 * D * (n - 1)
    moved, found = np.zeros((n - first + 1, 3, D)), np.zeros((size + 3 * D, size + 3 * D))
    moved[:-1], found[:size, :size] = state[first:], covariance[gone:, gone:]
    moved[-1, 0], moved[-1, 1] = turned @ (state[-1, 0] + dt * state[-1, 1]), turned @ state[-1, 1]
    A = np.zeros((3 * D, 3 * D))
    A[:D, :D], A[:D, D : 2 * D], A[D : 2 * D, D : 2 * D] = turned, dt * turned, turned
    across = A @ covariance[last:, gone:].copy()
    found[size:, :size], found[:size, size:] = across, across.T
    noise = A @ covariance[last:, last:].copy() @ A.T
    noise[:D, :D] += shake
    for d in range(D):
        noise[d, d] += density * dt**3 / 3.0
        noise[D + d, D + d] += density * dt
        noise[d, D + d] += density * dt**2 / 2.0
        noise[D + d, d] += density * dt**2 / 2.0
        noise[2 * D + d, 2 * D + d] += offset_sd**2
    found[size:, size:] = noise
    return moved, found


@njit(cache=True, nogil=True)
@typing.no_type_check
def step_covariances(covariance, D):
    """Give the covariance of each step of place, from frame to frame (n - 1, D, D)."""
    n = len(covariance) // (3 * D)
    found = np.empty((n - 1, D, D))
    for j in range(n - 1):
        a, b = 3 * D * j, 3 * D * (j + 1)
        for d in range(D):
            for e in range(D):
                across = covariance[a + d, b + e] + covariance[b + d, a + e]
                found[j, d, e] = covariance[a + d, a + e] + covariance[b + d, b + e] - across
    return found
