"""What least squares over the windows of many objects start from, as compiled loops take it."""

from typing import NamedTuple

import numpy as np


class Problem(NamedTuple):
    """The windows of K objects, one after the other; N frames and M comparisons in all.

    Attributes:
        sizes: frames of each object (K).
        counts: comparisons of each object (K).
        times: of the frames [s] (N).
        axes: number of each frame among the open axes, or -1 (N).
        angles: of the axes of each frame [rad] (N); for open ones, where to start from.
        state: unknowns to start from, in the axes of their frames (N, 2, D).
        shakes: covariance that each frame's place has beside that of the motion (N, D, D); an object's first: unused.
        expected: each object's last step, as its motion so far would have it, in the axes of the frame before (K, D).
        expected_covariances: of that (K, D, D).
        rates: what is known of the rate at each object's first frame (K, D).
        rate_informations: inverse covariance of that (K, D, D).
        others: places of the frames before the last by the other explanation of these looks (see `hypotheses`), against
            the state's, in axes of these frames (K, D); NaN where there is none.
        other_rates: rates there (K, D).
        other_expected, other_covariances: expected last steps from there, and their covariances (K, D), (K, D, D).
        other_costs: by how much the other explanation is less likely: difference of negative logarithms (K).
        is_sudden: the other explanation is a sudden change, the state's that the look is off; else the reverse (K).
        ends: older and newer frame of each comparison, within its object (M, 2).
        olders: the point whose motion was measured, in the axes of the older frame (M, D).
        newers: where it was in the newer frame, in the axes of that (M, D).
        informations: inverse covariance of the difference that is claimed, in the axes of the newer frame (M, D, D).
        doubts: covariance beside that, in the same axes (M, D, D).
    """

    sizes: np.ndarray
    counts: np.ndarray
    times: np.ndarray
    axes: np.ndarray
    angles: np.ndarray
    state: np.ndarray
    shakes: np.ndarray
    expected: np.ndarray
    expected_covariances: np.ndarray
    rates: np.ndarray
    rate_informations: np.ndarray
    others: np.ndarray
    other_rates: np.ndarray
    other_expected: np.ndarray
    other_covariances: np.ndarray
    other_costs: np.ndarray
    is_sudden: np.ndarray
    ends: np.ndarray
    olders: np.ndarray
    newers: np.ndarray
    informations: np.ndarray
    doubts: np.ndarray


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
