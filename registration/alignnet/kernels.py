"""Compiled loops of the maximum over points, on a CPU: which point it comes from, and the gradients that follow.

The maximum of a feature is one point's: its gradient is a sparse matrix with one entry a cloud and feature.  Dense
products would spend a hundred times the work on zeros.
"""

import typing

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
@typing.no_type_check
def best_rows(values, begin, best, row):
    """Find the largest value of each column over each cloud, and the row it stands in (the first, of equals).

    Args:
        values: (n, d); of any type that compares.
        begin: (b + 1,); cloud k is rows begin[k] to begin[k + 1].
        best: (b, d), written; untouched for an empty cloud.
        row: (b, d) int32, written; -1 for an empty cloud.
    """
    d = values.shape[1]
    for k in range(len(begin) - 1):
        if begin[k] == begin[k + 1]:
            row[k, :] = -1
            continue
        best[k, :] = values[begin[k]]
        row[k, :] = begin[k]
        for i in range(begin[k] + 1, begin[k + 1]):
            for c in range(d):
                larger = values[i, c] > best[k, c]
                best[k, c] = values[i, c] if larger else best[k, c]
                row[k, c] = i if larger else row[k, c]


@njit(cache=True, nogil=True)
@typing.no_type_check
def scatter_gradient(gradient, row, features, weight, of_features, of_weight):
    """Give each maximum's gradient to the point it came from, and to the weights that made it.

    Args:
        gradient: (b, d_out), of the maxima.
        row: (b, d_out), of `best_rows`.
        features: (n, d_in), of the points.
        weight: (d_out, d_in).
        of_features: (n, d_in), added to.
        of_weight: (d_out, d_in), added to.
    """
    d = features.shape[1]
    for k in range(gradient.shape[0]):
        for c in range(gradient.shape[1]):
            g, i = gradient[k, c], row[k, c]
            if g == 0.0 or i < 0:
                continue
            for j in range(d):
                of_weight[c, j] += g * features[i, j]
                of_features[i, j] += g * weight[c, j]


def ordered(bits: np.ndarray) -> np.ndarray:
    """Turn the bits of bfloat16 numbers into integers of the same order, or back: int16 to int16."""
    return bits ^ ((bits >> 15) & np.int16(0x7FFF))
