"""Where something was at the last few frames, from comparisons of any two of them: a fixed-lag smoother."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from registration import planar
from tracker.estimators.fused import hypotheses, motion_kernels
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.hypotheses import Other, Seen, Told

Vector = Float64[np.ndarray, " d"]
Square = Float64[np.ndarray, "d d"]
Moved = tuple[Float64[np.ndarray, "m d"], Float64[np.ndarray, "m d d"], Float64[np.ndarray, "m d d"]]
Joint = Float64[np.ndarray, "m m"]  # over all frames, m = 2 n d

ONES = {1: np.eye(1), 2: np.eye(2)}
SHORTEST_STEP = 0.01  # [s]
UNSETTLED = 0.05  # what is left of the probability that a look is right when it is dropped
PLACED = 1e-6  # variance of the first place, which only fixes where zero is


@dataclass(frozen=True)
class MotionModel:
    """How a place changes, and how far single errors may be off.

    Attributes:
        density: spectral density of the acceleration's white noise [m^2/s^3], or of a turn's [rad^2/s^3].
        rate_sd: standard deviation of a rate before anything is known, along each axis [m/s, rad/s].
        change: spectral density of what changes the acceleration [m^2/s^5, rad^2/s^5]: it lasts for a while.  Infinite:
            it need not.
        tails: degrees of freedom of Student's t for the errors of comparisons, and of the motion; 0 for normal ones.
        n_frames: length of the window.
        claimed: how many comparisons count for errors being as large as claimed, beside those of the window, which
            tell it by how well they agree; infinite: claims hold (see `claims`).
    """

    density: float
    rate_sd: float
    tails: tuple[float, float] = (3.0, 4.0)
    n_frames: int = 9
    claimed: float = 5.0
    change: float = math.inf


@dataclass(frozen=True, slots=True)
class Comparison:
    """A measured difference of place between two frames, each in the axes of its own frame.

    Attributes:
        older, newer: numbers of the frames since the first that the window ever had.
        measured: a point of the object in the older frame (d), which matters where axes turn; the same point in the
            newer frame (d); inverse covariance of the step between, row by row (d d), singular where a direction was
            not measured; covariance beside that (d d).  In one row, since a frame's comparisons are many, and are
            stacked three times.
    """

    older: int
    newer: int
    measured: Float64[np.ndarray, " row"]


@dataclass
class Window:
    """The latest frames of one object: place and rate at each, in its own axes, with their joint covariance.

    Frames leave the window at its end; what they said stays in the rate of the frame that follows, as it was known at
    its own time.

    Attributes:
        model: of the motion.
        times: of the frames [s].
        axes: number of each frame in the `Heading` that they share with other objects.
        state: place, rate of each (n, 2, d).
        covariance: of all of it, frame by frame (2 n d, 2 n d).
        expected: the last step, as the motion so far would have it, in the axes of the frame before; its covariance.
        told: what the comparisons of the latest look tell beside that.
        other: the other explanation of the latest look but for a frame that `advance` has just added; None where there
            is none.
        other_expected: the last step, as the motion would have it by that; its covariance.
        doubts: of the step to each frame, covariance that it has beside that of places and rates, since a look may be
            off as a whole; see `weigh_look`.
        is_off: whether the look of each frame is taken to be off.
        n_left: how many frames have left the window.
        comparisons: between frames of the window.
        shakes: of the frames; see `advance`.
    """

    model: MotionModel
    times: list[float]
    axes: list[int]
    state: Float64[np.ndarray, "n 2 d"]
    covariance: Joint
    expected: tuple[Vector, Square]
    told: Told
    other_expected: tuple[Vector, Square]
    other: Other | None = None
    n_left: int = 0
    comparisons: list[Comparison] = field(default_factory=list)
    shakes: list[Square] = field(default_factory=list)
    doubts: list[Square] = field(default_factory=list)
    is_off: list[bool] = field(default_factory=list)
    _rates: list[tuple[Vector, Square]] = field(default_factory=list)  # of each frame, known at its own time
    # what would be known of the rate at the frame before by its other explanation; doubt that its look leaves
    _other_known: tuple[Vector, Square] = field(default_factory=lambda: (np.zeros(2), np.eye(2)))
    _left: Square = field(default_factory=lambda: np.zeros((2, 2)))
    _told_of: list[int] = field(default_factory=list)  # comparisons of earlier frames with each frame, as the older

    @classmethod
    def start(cls, model: MotionModel, time: float, axes: Heading, place: Vector) -> "Window":
        """Begin with one frame, the latest of the axes; the rate is about 0 there."""
        d = len(place)
        state = np.zeros((1, 2, d))
        state[0, 0] = place
        variances = np.repeat([PLACED, model.rate_sd**2], d)
        rate = (np.zeros(d), model.rate_sd**2 * np.eye(d))
        expected, told = (np.zeros(d), np.eye(d)), Told(np.full(d, np.nan), np.full(d, np.nan))
        frame = ([time], [axes.latest], state, np.diag(variances), expected, told, expected)
        return cls(model, *frame, shakes=[np.zeros((d, d))], doubts=[np.zeros((d, d))], is_off=[False], _rates=[rate])

    def __len__(self) -> int:
        return len(self.times)

    def at(self, i: int) -> Vector:
        """Give the place at frame i."""
        place: Vector = self.state[i, 0].copy()
        return place

    def steps(self) -> Moved:
        """Give how far the object moved from each frame to the next; see `steps`."""
        return steps([self], np.ones(len(self) - 1, np.bool_))

    def step(self) -> tuple[Vector, Square]:
        """Give the mean rate over the latest step, and its covariance."""
        moved, covariances, shaken = self.steps()
        dt = self.times[-1] - self.times[-2]
        return moved[-1] / dt, (covariances[-1] + shaken[-1]) / dt**2

    def weigh_look(self, axes: Heading) -> None:
        """Settle the look before, and say how much the latest one may be off, once all comparisons are solved for.

        The comparisons of a look share its error, so nothing but the next look tells it from a sudden change.  What a
        look told that is off is dropped.  As far as the look before is not settled, both its step and the next may err.
        """
        turned = planar.rotation(-axes.turn_since(self.axes[-2]))
        left = np.zeros_like(self.doubts[-1])
        if self.other is not None:
            left = self.told.unsettled * np.outer(self.other.off, self.other.off)
            has_told = self.comparisons[-1:] and self.comparisons[-1].newer == self._newest
            if self.other.is_sudden and has_told and self.told.unsettled < UNSETTLED:
                self._drop_look_before()
        doubt, self.other = hypotheses.weigh(self._seen(turned), self.model.tails)
        if self.told.has_contrary and not self.told.has_rival:
            doubt = doubt + self.told.contrary_share * self.told.spread()
        self.doubts[-2] = self._left + left
        self._left = turned @ left @ turned.T
        self.doubts[-1] = doubt + self._left

    def _seen(self, turned: Square) -> Seen:
        expected, covariance = self.expected
        step = self.state[-1, 0] - turned @ self.state[-2, 0]
        shown = self.told.rival if self.told.has_rival else step
        seconds = self.times[-1] - self.times[-2]
        return Seen(step, shown, turned @ expected, turned @ covariance @ turned.T, seconds)

    def difference(self, i: int, j: int = -1) -> Square:
        """Give the covariance of the difference of place between frames i and j."""
        d, n = self.state.shape[2], len(self)
        i, j = i % n, j % n
        blocks = self.covariance.reshape(n, 2, d, n, 2, d)
        across = blocks[i, 0, :, j, 0]
        found: Square = blocks[i, 0, :, i, 0] + blocks[j, 0, :, j, 0] - across - across.T
        return found

    def advance(self, time: float, axes: Heading, shake: Square | None = None) -> bool:
        """Add a frame where the motion so far would lead; say whether the oldest one had to leave for it.

        Args:
            time: of the new frame [s]; at least SHORTEST_STEP after the last.
            axes: whose latest frame it is.
            shake: covariance that the new place has beside that of the motion (d, d).
        """
        d, is_full = self.state.shape[2], len(self) == self.model.n_frames
        time = max(time, self.times[-1] + SHORTEST_STEP)
        dt = time - self.times[-1]
        shake = np.zeros((d, d)) if shake is None else shake
        rate, rate_covariance = self._latest_rate()
        noise = self.model.density * dt**3 / 3.0 * ONES[d]
        self.expected = dt * rate, dt**2 * rate_covariance + noise + shake
        nowhere = np.full(d, np.nan)
        self.told = Told(nowhere, nowhere, unsettled=0.0 if self.other is None else self.other.probability)
        if self.other is not None:
            self.other_expected = self.other.expected(dt, self.expected[1])
            self._other_known = self.other.rate, self.other.rate_covariance + rate_covariance
        turned = planar.rotation(-axes.turn_since(self.axes[-1])) if d > 1 else ONES[d]
        self.state, self.covariance = motion_kernels.advance(
            self.state, self.covariance, dt, turned, float(self.model.density), shake, is_full
        )
        self.times.append(time)
        self.axes.append(axes.latest)
        self.shakes.append(shake)
        self.doubts.append(np.zeros((d, d)))
        self._rates.append(self._latest_rate())
        self.is_off.append(False)
        if is_full:
            self._drop_oldest()
        self._told_of = [0] * len(self)
        for comparison in self.comparisons:
            self._told_of[comparison.older - self.n_left] += 1
        return is_full

    def place_last(self, place: Vector) -> None:
        """Say where the last frame is to be looked for first; rates are those that lead there."""
        self.state[-1, 0] = place
        self.state[-2:, 1] = (place - self.state[-2, 0]) / (self.times[-1] - self.times[-2])

    def compare(self, lag: int, start: Vector, step: Vector, information: Square, doubt: Square | None = None) -> None:
        """Take a comparison of the latest frame with the one `lag` before into account, from the next `solve` on.

        One that says nothing is left out, and one with a look that is off; see `Comparison`.  Beside what it claims
        it has the covariance `doubt`; None: nothing.
        """
        beside = np.zeros(information.size) if doubt is None else doubt.ravel()
        if information.any():
            self.take(lag, np.concatenate((start, start + step, information.ravel(), beside)))

    def take(self, lag: int, measured: Float64[np.ndarray, " row"]) -> None:
        """Do `compare` with what is measured in one row already (see `Comparison`), and says something."""
        if not self.is_off[-1 - lag]:
            self.comparisons.append(Comparison(self._newest - lag, self._newest, measured))

    def n_told(self, lag: int) -> int:
        """Say how many comparisons of earlier frames there are with the frame `lag` before the latest, as the older."""
        return self._told_of[-1 - lag]

    @property
    def _newest(self) -> int:
        return self.n_left + len(self) - 1

    @property
    def first_rate(self) -> tuple[Vector, Square]:
        """The rate at the first frame, as it was known at its own time, and its covariance."""
        return self._rates[0]

    def take_other(self) -> None:
        """Take the other explanation of the look before; the state is that of it already."""
        assert self.other is not None
        self._rates[-2], self._other_known = self._other_known, self._rates[-2]
        rate = self.expected[0] / (self.times[-1] - self.times[-2])
        self.other, self.expected, self.other_expected = self.other.reversed(rate), self.other_expected, self.expected

    def learn_rate(self) -> None:
        """Take the latest rate for what is known of it at its own time."""
        self._rates[-1] = self._latest_rate()

    def _latest_rate(self) -> tuple[Vector, Square]:
        d = self.state.shape[2]
        return self.state[-1, 1].copy(), self.covariance[-d:, -d:].copy()

    def _drop_look_before(self) -> None:
        self.is_off[-2] = True
        before = self._newest - 1
        self.comparisons = [c for c in self.comparisons if before not in (c.older, c.newer)]

    def _drop_oldest(self) -> None:
        self.n_left += 1
        for series in (self.times, self.axes, self.shakes, self.doubts, self.is_off, self._rates):
            series.pop(0)
        self.comparisons = [c for c in self.comparisons if c.older >= self.n_left]


def steps(windows: Sequence[Window], tells: Bool[np.ndarray, " m"]) -> Moved:
    """Give how far objects moved from each frame to the next, one object after the other, without what axes shook.

    Args:
        windows: of K objects that share a model, N frames in all.
        tells: whether the places at both ends tell of each step's velocity (N - K), as where some time lies between
            the looks; else the rates alone do.

    Returns:
        displacements (N - K, d), and two parts of their covariances (N - K, d, d): what is open since places and rates
        are, and since axes shake.
    """
    flat, model = flattened(windows), windows[0].model
    shakes = np.concatenate([window.shakes for window in windows])
    found: Moved = motion_kernels.steps(
        *flat, tells, shakes, float(model.density), float(model.tails[1]), flat.state.shape[2]
    )
    return found


class Flat(NamedTuple):
    """Windows one after the other, as compiled loops take them.

    Attributes:
        sizes: frames of each of K objects (K).
        state: place and rate at each frame (N, 2, d).
        covariances: of all of an object's, object by object, flat.
        times: of the frames (N) [s].
    """

    sizes: Int64[np.ndarray, " k"]
    state: Float64[np.ndarray, "n 2 d"]
    covariances: Float64[np.ndarray, " _"]
    times: Float64[np.ndarray, " n"]


def flattened(windows: Sequence[Window]) -> Flat:
    """Lay windows, one at least, one after the other."""
    return Flat(
        sizes=np.array([len(window) for window in windows]),
        state=np.concatenate([window.state for window in windows]),
        covariances=np.concatenate([window.covariance.ravel() for window in windows]),
        times=np.array([time for window in windows for time in window.times]),
    )
