"""How the ego turns, as all objects of a frame tell: what they have in common is the sensor's own turn."""

import numpy as np

from tracker.estimators.fused.window import Comparison, MotionModel, Window

TURN_SD = 0.15  # of the ego's rate of turn before anything is known [rad/s]
# How fast that rate changes, as white noise: by 0.05 rad/s within a second.  The start of a bend is a heavy tail.
TURN_MODEL = MotionModel(density=0.003)
# Of an object's own rate of turn [rad/s]: most go straight, some turn.  Twice what cars do, since all comparisons of
# one object share it.
OWN_TURN_SD = 0.3


class EgoHeading:
    """Turn the sensor's axes back to where they pointed in the first frame, by the objects alone.

    Seen from a sensor that turns, everything turns the other way, and far objects move sideways at metres a second:
    no motion model holds in such axes.  Steady ones need not be right in the long run, only smooth; a slow drift of
    theirs is a slow drift of all velocities, and is undone when these are given in the sensor's axes again.
    """

    def __init__(self, time: float) -> None:
        """Start with heading 0."""
        self._window = Window.start(TURN_MODEL, time, np.zeros(1), TURN_SD)
        self._first = 0  # number of the first in the window
        self.headings = [0.0]  # of the frames in the window: fixed once a frame is over

    @property
    def latest(self) -> int:
        """Number of the latest heading, from 0."""
        return self._first + len(self.headings) - 1

    def advance(self, time: float) -> float:
        """Begin a frame; give the heading to expect [rad]."""
        if self._window.advance(time):
            self._first += 1
            self.headings.pop(0)
        self.headings.append(self._predicted())
        return self.headings[-1]

    def compare(self, older: int, turn: float, variance: float) -> None:
        """Hear how an object seems to have turned, in the sensor's axes, from heading `older` to the latest.

        Args:
            older: number of a heading; one that has left the window says nothing.
            turn: [rad].
            variance: of its measurement [rad^2].
        """
        i = older - self._first
        if i < 0:
            return
        own = OWN_TURN_SD * (self._window.times[-1] - self._window.times[i])
        information = np.array([[1.0 / (variance + own**2)]])
        self._window.compare(Comparison(i, len(self._window) - 1, np.array([-turn]), information))

    def settle(self) -> float:
        """Weigh all that was heard; give by how much the latest heading changes [rad]."""
        if len(self._window) < 2:
            return 0.0
        self._window.solve()
        change = self._predicted() - self.headings[-1]
        self.headings[-1] += change
        return change

    def step_variance(self) -> float:
        """Give the variance of the latest step of the heading [rad^2]."""
        return float(self._window.difference(-2)[0, 0])

    def learn(self) -> None:
        """Weigh all that was heard for the frames to come; the latest heading stays as it is."""
        self._window.solve()

    def _predicted(self) -> float:
        previous = self.headings[-2] if len(self.headings) == len(self._window) else self.headings[-1]
        return previous + float(self._window.state[-1, 0, 0] - self._window.state[-2, 0, 0])
