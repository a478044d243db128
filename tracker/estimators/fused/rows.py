"""What is known of many objects' windows, in arrays with a row for each, as compiled loops take it."""

import itertools
from typing import NamedTuple

import numpy as np


class Frames(NamedTuple):
    """The frames of C windows of n frames at most, the oldest first; what lies behind a window's last one is nothing.

    Attributes:
        sizes: frames of each window (C).
        times: of the frames [s] (C, n).
        axes: number of each frame in the `Heading` that all share (C, n).
        state: place, rate of each, in its own axes, d numbers each (C, n, 2, d).
        covariance: of all of a window, frame by frame (C, 2 n d, 2 n d); of m frames, the first 2 m d rows and columns.
        shakes: covariance that each frame's place has beside that of the motion (C, n, d, d).
        doubts: of the step to each frame, covariance that it has beside that of places and rates, since a look may be
            off as a whole; see `hypotheses` (C, n, d, d).
        is_off: whether the look of each frame is taken to be off (C, n).
        rates, rate_covariances: rate at each frame, known at its own time, and its covariance (C, n, d), (C, n, d, d).
    """

    sizes: np.ndarray
    times: np.ndarray
    axes: np.ndarray
    state: np.ndarray
    covariance: np.ndarray
    shakes: np.ndarray
    doubts: np.ndarray
    is_off: np.ndarray
    rates: np.ndarray
    rate_covariances: np.ndarray


class Comparisons(NamedTuple):
    """Measured differences of place between two frames of C windows, M at most of each, in the order they were heard.

    Attributes:
        counts: how many each window has (C).
        ends: older and newer frame of each comparison, within its window (C, M, 2).
        measured: a point of the object in the older frame (d), which matters where axes turn; the same point in the
            newer frame (d); inverse covariance of the step between, row by row (d d), singular where a direction was
            not measured; covariance beside that (d d).  In one row (C, M, 2 d + 2 d d).
    """

    counts: np.ndarray
    ends: np.ndarray
    measured: np.ndarray


class Explained(NamedTuple):
    """How the latest look at each of C objects is explained, and how the motion was to go on; see `hypotheses`.

    The other explanation is that of the latest look but for a frame that has just been added.

    Attributes:
        expected, expected_covariances: the last step, as the motion so far would have it, in the axes of the frame
            before: by what was taken of the look before, and by the other explanation (C, 2, d), (C, 2, d, d).
        rivals: where the last step would lead if it could be as sudden as its comparisons tell (C, d); NaN where it is.
        contrary: another place that some of these tell of, relative to the last one (C, d); NaN where none do.
        contrary_shares: its probability, beside the last one (C).
        unsettled: probability of the explanation of the look before that was not taken (C).
        others: where the object would be by the other explanation, relative to where it is taken to be (C, d); NaN
            where there is none.
        rates, rate_covariances: it would have (C, d), (C, d, d).
        costs: by how much it is less likely than what was taken: difference of negative logarithms (C).
        is_sudden: it is that the object moved suddenly; else, that the look is off (C).
        seconds: of the step to that look (C).
        known_rates, known_covariances: what would be known by it of the rate at the frame before (C, d), (C, d, d).
        left: doubt that the look before leaves, in the latest axes (C, d, d).
    """

    expected: np.ndarray
    expected_covariances: np.ndarray
    rivals: np.ndarray
    contrary: np.ndarray
    contrary_shares: np.ndarray
    unsettled: np.ndarray
    others: np.ndarray
    rates: np.ndarray
    rate_covariances: np.ndarray
    costs: np.ndarray
    is_sudden: np.ndarray
    seconds: np.ndarray
    known_rates: np.ndarray
    known_covariances: np.ndarray
    left: np.ndarray


class Rows(NamedTuple):
    """All of it."""

    frames: Frames
    comparisons: Comparisons
    explained: Explained


def empty(n_rows: int, n_frames: int, n_comparisons: int, d: int) -> Rows:
    """Make rows of which nothing is known yet, for places of d numbers."""
    c, n, whole = n_rows, n_frames, 2 * n_frames * d
    frames = Frames(
        sizes=np.zeros(c, np.int64),
        times=np.zeros((c, n)),
        axes=np.zeros((c, n), np.int64),
        state=np.zeros((c, n, 2, d)),
        covariance=np.zeros((c, whole, whole)),
        shakes=np.zeros((c, n, d, d)),
        doubts=np.zeros((c, n, d, d)),
        is_off=np.zeros((c, n), np.bool_),
        rates=np.zeros((c, n, d)),
        rate_covariances=np.zeros((c, n, d, d)),
    )
    measured = np.zeros((c, n_comparisons, 2 * d + 2 * d * d))
    comparisons = Comparisons(np.zeros(c, np.int64), np.zeros((c, n_comparisons, 2), np.int64), measured)
    return Rows(frames, comparisons, _unexplained(c, d))


def _unexplained(c: int, d: int) -> Explained:
    return Explained(
        expected=np.zeros((c, 2, d)),
        expected_covariances=np.zeros((c, 2, d, d)),
        rivals=np.full((c, d), np.nan),
        contrary=np.full((c, d), np.nan),
        contrary_shares=np.zeros(c),
        unsettled=np.zeros(c),
        others=np.full((c, d), np.nan),
        rates=np.zeros((c, d)),
        rate_covariances=np.zeros((c, d, d)),
        costs=np.zeros(c),
        is_sudden=np.zeros(c, np.bool_),
        seconds=np.zeros(c),
        known_rates=np.zeros((c, d)),
        known_covariances=np.zeros((c, d, d)),
        left=np.zeros((c, d, d)),
    )


def grown(rows: Rows, n_rows: int, n_comparisons: int) -> Rows:
    """Make more rows, or rows for more comparisons, that know what these do."""
    n_frames, d = rows.frames.state.shape[1], rows.frames.state.shape[3]
    larger = empty(n_rows, n_frames, n_comparisons, d)
    for old, new in zip(itertools.chain(*rows), itertools.chain(*larger), strict=True):
        new[tuple(slice(n) for n in old.shape)] = old
    return larger
