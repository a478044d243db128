"""How the axes turn that objects are seen in: what all objects of a frame have in common."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

RATE_SD = 0.2  # of the ego's rate of turn before anything is known [rad/s]
# White noise of its change [rad^2/s^3]: 0.3 rad/s^2 for a tenth of a second.
DENSITY = 0.01
OWN_TURN_SD = 0.15  # of an object's own rate of turn [rad/s]: most go straight, some turn
SHORTEST_STEP = 0.01  # [s]
MOST_KEPT = 100  # frames whose angles are remembered, for objects that nothing was seen of in between

Numbers = Float64[np.ndarray, " n"]


class Turned(NamedTuple):
    """How the axes of frames stand, as compiled loops take it.

    Attributes:
        first_kept: number of the first frame that is remembered.
        first_open: number of the first one that is still open to what is heard.
        angles: of the axes at each frame that is remembered, up to the latest [rad].
    """

    first_kept: int
    first_open: int
    angles: np.ndarray


class Heading:
    """The sensor's axes against axes that do not turn; or axes that never turn, as the world's.

    Seen from a sensor that turns, everything turns the other way, and far objects swing sideways with accelerations
    that no motion model has room for.  Steady axes need not be right in the long run, only smooth: a slow drift of
    theirs is a slow drift of all velocities, and is undone when these are given in the sensor's axes again.

    Attributes:
        turns: whether the axes turn at all.
        first_kept: number of the first frame that is remembered.
        times: of the frames from that on [s].
        rates: of the axes at each [rad/s].
        heard: of the open frames: numbers of an older and a newer one, by how much the axes turned between them as
            one object tells [rad], and the information of that [1/rad^2].
    """

    def __init__(self, turns: bool, n_frames: int) -> None:
        """Start with no frames; the latest `n_frames` stay open to what is heard of them, those before are fixed."""
        self.turns = turns
        self.first_kept = 0
        self.times: list[float] = []
        self._room = np.zeros(MOST_KEPT + 1)
        self.rates: list[float] = []
        self.heard: list[tuple[int, int, float, float]] = []
        self._n_frames = n_frames
        self._known: list[tuple[float, float]] = []  # rate of turn at each frame, known at its own time, and variance

    @property
    def angles(self) -> Numbers:
        """The axes' angle at each frame that is remembered [rad]."""
        return self._room[: len(self.times)]

    @property
    def latest(self) -> int:
        """Number of the latest frame, from 0."""
        return self.first_kept + len(self.times) - 1

    @property
    def first(self) -> int:
        """Number of the first frame that is still open; axes that never turn have none."""
        return max(self.latest + 1 - self._n_frames, self.first_kept) if self.turns else self.latest + 1

    @property
    def first_rate(self) -> tuple[float, float]:
        """The rate of turn at the first open frame, as it was known at its own time, and its variance."""
        return self._known[self.first - self.first_kept] if self.turns else (0.0, RATE_SD**2)

    def turned(self) -> Turned:
        """Give how the axes stand in all frames that are remembered."""
        return Turned(self.first_kept, self.first, self.angles)

    def advance(self, time: float) -> None:
        """Begin a frame, and expect the axes to have gone on turning as they did."""
        if not self.times:
            self.times, self.rates, self._known = [time], [0.0], [(0.0, RATE_SD**2)]
            return
        dt = max(time - self.times[-1], SHORTEST_STEP)
        mean, variance = self._known[-1]
        self.times.append(self.times[-1] + dt)
        self.angles[-1] = self.angles[-2] + dt * self.rates[-1]
        self.rates.append(self.rates[-1])
        self._known.append((mean, variance + DENSITY * dt))
        if len(self.times) > MOST_KEPT:
            self.first_kept += 1
            self._room[:-1] = self._room[1:]
            for series in (self.times, self.rates, self._known):
                del series[0]
        first = self.first
        self.heard = [heard for heard in self.heard if heard[0] >= first]

    def step_variance(self) -> float:
        """Give the variance of the turn that was expected of the latest frame [rad^2]."""
        if not self.turns or len(self.times) == 1:
            return 0.0
        dt = self.times[-1] - self.times[-2]
        return dt**2 * self._known[-1][1] + DENSITY * dt**3 / 3.0

    def hear(self, olders: Sequence[int], turns: Numbers, variances: Numbers) -> None:
        """Hear how objects seem to have turned from older frames to the latest, in the axes of each.

        Args:
            olders: numbers of the frames (m).
            turns: (m) [rad].
            variances: of their measurements (m) [rad^2].
        """
        if not self.turns:
            return
        first, latest, now = self.first, self.latest, self.times[-1]
        for older, turn, variance in zip(olders, turns.tolist(), variances.tolist(), strict=True):
            if older >= first:
                own = OWN_TURN_SD * (now - self.times[older - self.first_kept])
                self.heard.append((older, latest, -turn, 1.0 / (variance + own**2)))

    def settle(self, angles: Float64[np.ndarray, " n"], rates: Float64[np.ndarray, " n"], rate_variance: float) -> None:
        """Take what was found out about the open frames; the variance is that of the latest rate."""
        if self.turns:
            first = self.first - self.first_kept
            self.angles[first:], self.rates[first:] = angles, rates.tolist()
            self._known[-1] = (self.rates[-1], rate_variance)
