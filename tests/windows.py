"""Single windows, as tests look at them: rows of arrays that several may share."""

from dataclasses import dataclass

import numpy as np

from tracker.estimators.fused import hypotheses, motion_kernels, row_kernels, solving
from tracker.estimators.fused.window import Windows


@dataclass(frozen=True)
class Comparison:
    """See `rows.Comparisons`; frames are numbered since the first that the window ever had."""

    older: int
    newer: int
    measured: np.ndarray


@dataclass(frozen=True)
class Other:
    """The other explanation of the latest look; see `rows.Explained`."""

    off: np.ndarray
    rate: np.ndarray
    cost: float
    is_sudden: bool

    @property
    def probability(self):
        return 1.0 / (1.0 + np.exp(self.cost))


class Window:
    """One row of windows."""

    def __init__(self, windows, row):
        self.windows, self.at, self.n_left = windows, np.array([row]), 0

    @classmethod
    def start(cls, model, time, axes, place):
        return cls.start_all(model, time, axes, place[None])[0]

    @classmethod
    def start_all(cls, model, time, axes, places):
        """Begin several that share their arrays, and can be solved for together."""
        windows = Windows(model, places.shape[1])
        while windows.n_rows < len(places):
            windows.make_room()
        windows.start(np.arange(len(places)), np.full(len(places), time), axes, np.ascontiguousarray(places))
        return [cls(windows, row) for row in range(len(places))]

    def __len__(self):
        return int(self.frames.sizes[self.row])

    @property
    def row(self):
        return int(self.at[0])

    @property
    def frames(self):
        return self.windows.rows.frames

    @property
    def explained(self):
        return self.windows.rows.explained

    def __getattr__(self, name):
        """Give what is known of its frames."""
        return getattr(self.frames, name)[self.row, : len(self)]

    @property
    def covariance(self):
        width = len(self) * self.state[0].size
        return self.frames.covariance[self.row, :width, :width]

    @property
    def first_rate(self):
        return self.rates[0], self.rate_covariances[0]

    @property
    def comparisons(self):
        heard = self.windows.rows.comparisons
        return [
            Comparison(*(heard.ends[self.row, c] + self.n_left).tolist(), heard.measured[self.row, c].copy())
            for c in range(heard.counts[self.row])
        ]

    @property
    def unsettled(self):
        return self.explained.unsettled[self.row]

    @property
    def other(self):
        own = self.explained
        if np.isnan(own.others[self.row, 0]):
            return None
        numbers = float(own.costs[self.row]), bool(own.is_sudden[self.row])
        return Other(own.others[self.row].copy(), own.rates[self.row].copy(), *numbers)

    def advance(self, time, axes, shake=None):
        d = self.state.shape[2]
        self.n_left += len(self) == self.windows.model.n_frames
        shakes = np.zeros((1, d, d)) if shake is None else shake[None]
        density = float(self.windows.model.density)
        frames, comparisons, explained = self.windows.rows
        row_kernels.expect(frames, explained, self.at, np.array([time]), density, shakes)
        row_kernels.advance(frames, comparisons, self.at, np.array([time]), axes.turned(), density, shakes)

    def place_last(self, place):
        row_kernels.place_last(self.frames.state, self.frames.times, self.row, len(self) - 1, place)

    def compare(self, lag, start, step, information, doubt=None):
        doubt = np.zeros(information.shape) if doubt is None else doubt
        measured = np.concatenate([start, start + step, information.ravel(), doubt.ravel()])
        if len(self.comparisons) == self.windows.rows.comparisons.ends.shape[1]:
            self.windows.make_room_for_comparisons()
        last = len(self) - 1
        row_kernels.hear(self.frames.is_off, self.windows.rows.comparisons, self.row, last - lag, last, measured)

    def weigh_look(self, axes):
        self.windows.weigh_looks(self.at, axes)

    def take_other(self):
        hypotheses.take_other(self.frames, self.explained, self.row)

    def steps(self):
        model, tells = self.windows.model, np.ones(len(self) - 1, np.bool_)
        return motion_kernels.steps(self.frames, self.at, tells, float(model.density), float(model.tails[1]))

    def step(self):
        """Give the mean rate over the latest step, and its covariance."""
        moved, covariances, shaken = self.steps()
        dt = self.times[-1] - self.times[-2]
        return moved[-1] / dt, (covariances[-1] + shaken[-1]) / dt**2

    def difference(self, i, j=-1):
        """Give the covariance of the difference of place between frame i and the last one."""
        last = len(self) - 1
        assert j % len(self) == last
        found = [
            motion_kernels.difference(self.frames.covariance, self.row, i % len(self), last, p, q)
            for p in range(2)
            for q in range(2)
        ]
        return np.array(found).reshape(2, 2)


def solve(windows, axes=None):
    """Solve for windows that share their arrays."""
    solving.solve(windows[0].windows, np.concatenate([window.at for window in windows]), axes)
