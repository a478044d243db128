"""Where objects were at the last few frames, from comparisons of any two of them: a fixed-lag smoother."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from tracker.estimators.fused import hypotheses, row_kernels, rows
from tracker.estimators.fused.heading import Heading

Vector = Float64[np.ndarray, " d"]
Rows = Int64[np.ndarray, " k"]

N_ROWS, N_COMPARISONS = 8, 64  # that there is room for at first


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


class Windows:
    """The latest frames of many objects: place and rate at each, in its own axes, with their joint covariance.

    Each object has a row.  Frames leave a window at its end; what they said stays in the rate of the frame that
    follows, as it was known at its own time.

    Attributes:
        model: of the motion, of all of them.
        rows: what is known; arrays that are replaced by larger ones where there is no more room.
        tails: those of the model.
    """

    def __init__(self, model: MotionModel, d: int) -> None:
        """Make room for places of d numbers."""
        self.model = model
        self.rows = rows.empty(N_ROWS, model.n_frames, N_COMPARISONS, d)
        self.tails = np.array(model.tails, dtype=np.float64)

    @property
    def n_rows(self) -> int:
        """How many objects there is room for."""
        return len(self.rows.frames.sizes)

    def make_room(self) -> None:
        """Make room for twice as many objects."""
        self.rows = rows.grown(self.rows, 2 * self.n_rows, self.rows.comparisons.ends.shape[1])

    def make_room_for_comparisons(self) -> None:
        """Make room for twice as many comparisons of each."""
        self.rows = rows.grown(self.rows, self.n_rows, 2 * self.rows.comparisons.ends.shape[1])

    def start(
        self,
        at: Rows,
        times: Float64[np.ndarray, " k"],
        axes: Heading,
        places: Float64[np.ndarray, "k d"],
        rate_sd: float | None = None,
    ) -> None:
        """Begin windows with one frame each, the latest of the axes; rates are about 0 there.

        Args:
            at: their rows.
            times: of the frames [s].
            axes: that all share.
            places: of the objects.
            rate_sd: instead of the model's; None: that.
        """
        own = self.model.rate_sd if rate_sd is None else rate_sd
        row_kernels.start(self.rows, at, times, axes.latest, places, float(own))

    def weigh_looks(self, at: Rows, axes: Heading) -> None:
        """Settle the looks before, and say how much the latest may be off; see `hypotheses`."""
        hypotheses.weigh(self.rows, at, axes.turned(), self.tails)
