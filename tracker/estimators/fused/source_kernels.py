"""From what methods answer of pairs of looks to evidence of an object's motion; compiled by numba, behind `sources`."""

import math
import typing

import numpy as np
from numba import njit

ROUNDING = 1e-8  # so that a covariance that claims certainty has an inverse [m^2]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def opinions(motions, covariances, is_doubtful, numbers, looks, places, evidence):  # noqa: PLR0913
    """Say how the places of objects move, by the network's answers about m of M pairs of looks.

    Args:
        motions: the object's centre in the earlier cloud and in the newer one, relative to the clouds' means, and its
            turn (m, 7) [m, rad].
        covariances: of (x, y, yaw) about that centre (m, 3, 3).
        is_doubtful: answers that tell nothing (m).
        numbers: of the pairs, among the M (m).
        looks: of each pair, where the means of both clouds are put (x, y) [m], and what few points add to the variance
            of the turn (m, 5).
        places: of the objects' reference points in the earlier looks (M, 2) [m].
        evidence: steps of these (M, 2), informations of the steps (M, 2, 2), turns, and their variances (M); written.
    """
    steps, informations, turns, turn_variances = evidence
    for k in range(len(numbers)):
        if is_doubtful[k]:
            continue
        m = numbers[k]
        x, y = places[m, 0] - looks[k, 0] - motions[k, 0], places[m, 1] - looks[k, 1] - motions[k, 1]
        c, s = math.cos(motions[k, 6]), math.sin(motions[k, 6])
        x, y = c * x - s * y, s * x + c * y
        steps[m, 0] = looks[k, 2] + motions[k, 3] + x - places[m, 0]
        steps[m, 1] = looks[k, 3] + motions[k, 4] + y - places[m, 1]
        xx, xy, yy = _carried(covariances, k, x, y)
        _invert(xx + ROUNDING, xy, yy + ROUNDING, informations, m)
        turns[m], turn_variances[m] = motions[k, 6], covariances[k, 2, 2] + ROUNDING + looks[k, 4]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def laid(motions, covariances, is_found, arms, between, turns, steps, known):  # noqa: PLR0913
    """Say how places move by what the planes found, where they found anything.

    Args:
        motions: (x, y, yaw) between the clouds about their centroids (M, 3).
        covariances: of these (M, 3, 3).
        is_found: whether there are any (M).
        arms: places relative to the centroids of the earlier clouds (M, 2) [m].
        between: from centroid to centroid (M, 2) [m].
        turns: (M), written.
        steps: of the places (M, 2), written.
        known: their covariances xx, xy, yy, and the turn's variance (M, 4), written.
    """
    for k in range(len(motions)):
        if is_found[k]:
            x, y = arms[k, 0], arms[k, 1]
            c, s = math.cos(motions[k, 2]), math.sin(motions[k, 2])
            steps[k, 0] = between[k, 0] + motions[k, 0] + c * x - s * y - x
            steps[k, 1] = between[k, 1] + motions[k, 1] + s * x + c * y - y
            turns[k] = motions[k, 2]
            known[k, 0], known[k, 1], known[k, 2] = _carried(covariances, k, x, y)
            known[k, 3] = covariances[k, 2, 2]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def weigh(known, expected, is_told, was_searched, seen, shares, evidence):  # noqa: PLR0913
    """Turn M motions beside those that were expected to evidence: what was expected is none of it.

    Args:
        known: covariances xx, xy, yy of the steps, and variances of the turns, infinite where none is measured (M, 4).
        expected: steps (M, 2), their covariances (M, 2, 2), turns (M), and whether anything was expected (M).
        is_told: whether there is anything (M).
        was_searched: where histograms had a say (M).
        seen: points of the smaller cloud (M).
        shares: that errors have of the steps' covariances, by histograms and by planes, which have less of it where
            points are more: from how many on, up to how many, and by which power; and share of the information that a
            direction needs to count as measured: one that nothing else told of is left without.
        evidence: steps (M, 2) and turns (M), of which become whole ones, and informations of the steps (M, 2, 2).
    """
    (shifts, priors, swings, is_expected), (steps, turns, informations) = expected, evidence
    by_search, by_planes, dense, densest, power, least = shares
    for k in range(len(known)):
        turns[k] = np.pi - (np.pi - turns[k] - swings[k]) % (2.0 * np.pi)
        informations[k] = 0.0
        if not is_told[k]:
            steps[k] = 0.0
            continue
        steps[k, 0] += shifts[k, 0]
        steps[k, 1] += shifts[k, 1]
        _invert(known[k, 0], known[k, 1], known[k, 2], informations, k)
        if is_expected[k]:
            small = least * (informations[k, 0, 0] + informations[k, 1, 1])
            a, b, c = priors[k, 0, 0], priors[k, 0, 1], priors[k, 1, 1]
            determinant = a * c - b * b
            informations[k, 0, 0] -= c / determinant
            informations[k, 0, 1] += b / determinant
            informations[k, 1, 0] += b / determinant
            informations[k, 1, 1] -= a / determinant
            _keep(informations, k, small)
        share = by_search if was_searched[k] else by_planes * (dense / min(max(seen[k], dense), densest)) ** power
        for p in range(2):
            for q in range(2):
                informations[k, p, q] /= share


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _keep(informations, k, least):
    """Keep the directions of an information that have more than the least."""
    a, b, c = informations[k, 0, 0], informations[k, 0, 1], informations[k, 1, 1]
    if a > least and (a - least) * (c - least) > b * b:
        return
    half = math.hypot(0.5 * (a - c), b)  # eigenvalues are the mean, more or less this; of two alike neither is left
    largest = 0.5 * (a + c) + half if half > 0.0 else 0.0
    share = largest / (2.0 * half) if largest > least else 0.0  # of the matrix less the smaller one
    smaller = largest - 2.0 * half
    informations[k, 0, 0], informations[k, 1, 1] = share * (a - smaller), share * (c - smaller)
    informations[k, 0, 1] = informations[k, 1, 0] = share * b


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
@typing.no_type_check
def _carried(covariances, k, x, y):
    """Carry the covariance of a motion to a place that is moved to so far from its centre: xx, xy, yy of the shift."""
    tt, xt, yt = covariances[k, 2, 2], covariances[k, 0, 2], covariances[k, 1, 2]
    xx = covariances[k, 0, 0] - 2.0 * y * xt + y * y * tt
    xy = covariances[k, 0, 1] + x * xt - y * yt - x * y * tt
    return xx, xy, covariances[k, 1, 1] + 2.0 * x * yt + x * x * tt


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
@typing.no_type_check
def _invert(a, b, c, inverses, k):
    """Invert a symmetric matrix of two rows, into row k."""
    determinant = a * c - b * b
    inverses[k, 0, 0], inverses[k, 1, 1] = c / determinant, a / determinant
    inverses[k, 0, 1] = inverses[k, 1, 0] = -b / determinant
