"""The axes that all objects of a frame share, in their common least squares; compiled by numba.

Source: elimination as in bundle adjustment, Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 6.1.
"""

import typing

import numpy as np
from numba import njit

from tracker.estimators.fused import heavy_tails, motion_kernels

FIXED = 1e8  # information of the first angle [1/rad^2]
TURN_TAILS = (3.0, 4.0)  # degrees of freedom of the errors of what is heard of turns, and of their rate's change


@njit(cache=True, nogil=True)
@typing.no_type_check
def of_turns(axes, angles, rates):
    """Give the system of changes of the axes' angles and rates, from what is known of these alone."""
    times, heard, G = axes.times, axes.heard, len(axes.times)
    A, a = np.zeros((2 * G, 2 * G)), np.zeros(2 * G)
    A[0, 0] = FIXED
    A[G, G] = 1.0 / axes.first_rate[1]
    a[G] = (axes.first_rate[0] - rates[0]) / axes.first_rate[1]
    u, at = np.empty(4), np.empty(4, np.int64)
    for g in range(G - 1):
        motion = motion_kernels.information(times[g + 1] - times[g], axes.density, np.zeros((1, 1)), 1)
        at[0], at[1], at[2], at[3] = g, G + g, g + 1, G + g + 1
        u[0], u[1], u[2], u[3] = angles[g], rates[g], angles[g + 1], rates[g + 1]
        pull = motion @ u
        weight = heavy_tails.weight(TURN_TAILS[1], 2, u @ pull)
        for p in range(4):
            a[at[p]] -= weight * pull[p]
            for q in range(4):
                A[at[p], at[q]] += weight * motion[p, q]
    for h in range(len(heard)):
        i, j = int(heard[h, 0]), int(heard[h, 1])
        off = heard[h, 2] - (angles[j] - angles[i])
        weight = heavy_tails.weight(TURN_TAILS[0], 1, off**2 * heard[h, 3]) * heard[h, 3]
        a[j] += weight * off
        a[i] -= weight * off
        A[i, i] += weight
        A[j, j] += weight
        A[i, j] -= weight
        A[j, i] -= weight
    return A, a


@njit(cache=True, nogil=True)
@typing.no_type_check
def to_steady(windows, angles, D):
    """Turn each frame's axes to the steady ones (N, D, D); a turn itself is no vector, and needs none."""
    found = np.ones((len(windows.times), D, D))
    if D > 1:
        numbers, fixed = windows.axes, windows.angles
        for f in range(len(found)):
            angle = angles[numbers[f]] if numbers[f] >= 0 else fixed[f]
            c, s = np.cos(angle), np.sin(angle)
            found[f, 0, 0], found[f, 0, 1], found[f, 1, 0], found[f, 1, 1] = c, -s, s, c
    return found


@njit(cache=True, nogil=True)
@typing.no_type_check
def turn(own, rotations, j, D, information):
    """Turn an information from the axes of frame j to steady ones, into `information`."""
    for d in range(D):
        for e in range(D):
            information[d, e] = 0.0
            for p in range(D):
                for q in range(D):
                    information[d, e] += rotations[j, d, p] * own[p, q] * rotations[j, e, q]


@njit(cache=True, nogil=True)
@typing.no_type_check
def in_own_axes(x, H, levers, common, windows, angles, D):
    """Turn unknowns back to the axes of their frames; put their covariances, with what the axes add, in place of H."""
    state, rotations = np.zeros(windows.state.shape), to_steady(windows, angles, D)
    sizes, numbers, frame = windows.sizes, windows.axes, 0
    for k in range(len(sizes)):
        n = sizes[k]
        m, last = 2 * D * n, frame + n
        unknowns, lever, own = x[k, :m].copy().reshape(m, 1), levers[k, :m].copy(), H[k, :m, :m]
        own[:] = np.linalg.inv(own)
        turns = rotations[frame:last]
        _turn_back(unknowns, turns, D)
        _turn_back(lever, turns, D)
        _turn_back(own, turns, D)
        _turn_back(own.T, turns, D)
        state[frame:last] = unknowns.reshape(n, 2, D)
        for f in range(frame, last):
            if D == 2 and numbers[f] >= 0:
                at = 2 * D * (f - frame)
                lever[at, numbers[f]] += state[f, 0, 1]
                lever[at + 1, numbers[f]] -= state[f, 0, 0]
        if len(common):
            own += lever @ common @ lever.T
        frame = last
    return state


@njit(cache=True, nogil=True)
@typing.no_type_check
def _turn_back(rows, rotations, D):
    """Turn the rows of each frame's place and rate from the steady axes to its own, in place."""
    if D < 2:
        return
    for i in range(len(rows) // 2):
        c, s = rotations[i // 2, 0, 0], rotations[i // 2, 1, 0]
        if s == 0.0 and c == 1.0:
            continue
        for e in range(rows.shape[1]):
            along, across = rows[2 * i, e], rows[2 * i + 1, e]
            rows[2 * i, e], rows[2 * i + 1, e] = c * along + s * across, c * across - s * along


@njit(cache=True, nogil=True)
@typing.no_type_check
def add_lever(L, A, a, numbers, at, ends, step, information):
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
            L[at[t], numbers[s]] -= sign * x
            L[at[t] + 1, numbers[s]] -= sign * y
