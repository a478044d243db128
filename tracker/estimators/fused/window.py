"""Where something was at the last few frames, from comparisons of any two of them: a fixed-lag smoother."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from tracker.estimators.fused import window_kernels

Vector = Float64[np.ndarray, " d"]
Square = Float64[np.ndarray, "d d"]
Joint = Float64[np.ndarray, "m m"]  # over all frames, m = 3 n d

SHORTEST_STEP = 0.01  # [s]
NO_OFFSET = 1e-4  # standard deviation of an offset where there is none, so that it has an inverse [m, rad]
PLACED = 1e-6  # variance of the first place, which only fixes where zero is


@dataclass(frozen=True)
class MotionModel:
    """How a place changes, and how far single errors may be off.

    Attributes:
        density: spectral density of the acceleration's white noise [m^2/s^3], or of a turn's [rad^2/s^3].
        tails: degrees of freedom of Student's t for the errors of comparisons, of offsets, and of the motion; 0 for
            normal ones.
        n_frames: length of the window.
    """

    density: float
    tails: tuple[float, float, float] = (3.0, 2.0, 4.0)
    n_frames: int = 9


@dataclass(frozen=True, slots=True)
class Comparison:
    """A measured difference of place plus offset between two frames.

    Attributes:
        older, newer: places of the frames in the window.
        step: the difference (d).
        information: its inverse covariance (d, d); singular where a direction was not measured.
    """

    older: int
    newer: int
    step: Vector
    information: Square


@dataclass
class Window:
    """The latest frames of one object: place, rate and offset at each, with their joint covariance.

    The offset is that of what was seen of the object in a frame, as when a part of it is hidden: it is common to all
    comparisons with that frame, which would seem to agree otherwise.  Frames leave the window at its end; what they
    said stays in the rate of the frame that follows, as it was known at its own time.

    Attributes:
        model: of the motion.
        times: of the frames [s].
        state: place, rate, offset of each (n, 3, d).
        covariance: of all of it, frame by frame (3 n d, 3 n d).
        comparisons: between frames of the window.
    """

    model: MotionModel
    times: list[float]
    state: Float64[np.ndarray, "n 3 d"]
    covariance: Joint
    comparisons: list[Comparison] = field(default_factory=list)
    _shakes: list[Square] = field(default_factory=list)
    _offset_sds: list[float] = field(default_factory=list)
    _rates: list[tuple[Vector, Square]] = field(default_factory=list)  # of each frame, known at its own time

    @classmethod
    def start(
        cls, model: MotionModel, time: float, place: Vector, rate_sd: float, offset_sd: float = NO_OFFSET
    ) -> "Window":
        """Begin with one frame, whose rate is about 0."""
        d = len(place)
        state = np.zeros((1, 3, d))
        state[0, 0] = place
        variances = np.repeat([PLACED, rate_sd**2, offset_sd**2], d)
        rate = (np.zeros(d), rate_sd**2 * np.eye(d))
        return cls(model, [time], state, np.diag(variances), [], [np.zeros((d, d))], [offset_sd], [rate])

    def __len__(self) -> int:
        return len(self.times)

    def seen(self, i: int) -> Vector:
        """Give place plus offset of frame i: where what was seen of the object was."""
        return self.state[i, 0] + self.state[i, 2]

    def step(self, j: int = -1) -> tuple[Vector, Square]:
        """Give the mean rate over the step that ends at frame j, and its covariance."""
        j %= len(self)
        dt = self.times[j] - self.times[j - 1]
        return (self.state[j, 0] - self.state[j - 1, 0]) / dt, self.difference(j - 1, j) / dt**2

    def difference(self, i: int, j: int = -1, is_seen: bool = False) -> Square:
        """Give the covariance of the difference of place, or of place plus offset, between frames i and j."""
        d, n = self.state.shape[2], len(self)
        i, j = i % n, j % n
        blocks = self.covariance.reshape(n, 3, d, n, 3, d)
        if is_seen:
            blocks = blocks[:, ::2, :, :, ::2].sum(axis=(1, 4))[:, None, :, :, None]
        across = blocks[i, 0, :, j, 0]
        found: Square = blocks[i, 0, :, i, 0] + blocks[j, 0, :, j, 0] - across - across.T
        return found

    def advance(self, time: float, shake: Square | None = None, offset_sd: float = NO_OFFSET) -> bool:
        """Add a frame where the motion so far would lead; say whether the oldest one had to leave for it.

        Args:
            time: of the new frame [s]; at least SHORTEST_STEP after the last.
            shake: covariance that its place has beside that of the motion (d, d).
            offset_sd: standard deviation of its offset.
        """
        d, n = self.state.shape[2], len(self)
        time = max(time, self.times[-1] + SHORTEST_STEP)
        dt, q = time - self.times[-1], self.model.density
        shake = np.zeros((d, d)) if shake is None else shake
        place, rate, _ = self.state[-1]
        self.state = np.concatenate([self.state, [[place + dt * rate, rate, np.zeros(d)]]])
        A = np.zeros((3 * d, 3 * d * n))
        A[: 2 * d, -3 * d : -d] = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(d))
        noise = np.kron(q * np.array([[dt**3 / 3, dt**2 / 2, 0], [dt**2 / 2, dt, 0], [0, 0, 0]]), np.eye(d))
        noise[:d, :d] += shake
        noise[2 * d :, 2 * d :] = offset_sd**2 * np.eye(d)
        across = A @ self.covariance
        self.covariance = np.block([[self.covariance, across.T], [across, across @ A.T + noise]])
        self.times.append(time)
        self._shakes.append(shake)
        self._offset_sds.append(offset_sd)
        self._rates.append(self._latest_rate())
        if len(self) <= self.model.n_frames:
            return False
        self._drop_oldest()
        return True

    def place_last(self, place: Vector) -> None:
        """Say where the last frame is to be looked for first."""
        self.state[-1, 0] = place

    def compare(self, comparison: Comparison) -> None:
        """Take a comparison into account, from the next `solve` on; one that says nothing is left out."""
        if comparison.information.any():
            self.comparisons.append(comparison)

    def solve(self) -> None:
        """Find the most likely places, rates and offsets of all frames."""
        if not self.comparisons:
            return
        mean, covariance = self._rates[0]
        self.state, self.covariance = window_kernels.solve(
            np.array(self.times),
            self.state,
            float(self.model.density),
            np.array(self._shakes),
            np.array(self._offset_sds),
            np.array(self.model.tails),
            mean,
            np.linalg.inv(covariance),
            np.array([(c.older, c.newer) for c in self.comparisons]),
            np.array([c.step for c in self.comparisons]),
            np.array([c.information for c in self.comparisons]),
        )
        self._rates[-1] = self._latest_rate()

    def _latest_rate(self) -> tuple[Vector, Square]:
        d = self.state.shape[2]
        return self.state[-1, 1].copy(), self.covariance[-2 * d : -d, -2 * d : -d].copy()

    def _drop_oldest(self) -> None:
        d = self.state.shape[2]
        for series in (self.times, self._shakes, self._offset_sds, self._rates):
            series.pop(0)
        self.state, self.covariance = self.state[1:], self.covariance[3 * d :, 3 * d :]
        self.comparisons = [
            Comparison(c.older - 1, c.newer - 1, c.step, c.information) for c in self.comparisons if c.older > 0
        ]
