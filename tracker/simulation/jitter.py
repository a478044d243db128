"""Labels as people draw them: boxes that jitter about the truth."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from registration import se3
from tracker.errors import InputError
from tracker.types import Box

_STREAM = 0x3B0  # keeps these random numbers apart from those of the scans
_SMALLEST = 0.5  # a size never shrinks below this share of the true one


@dataclass(frozen=True)
class BoxJitter:
    """How far a label lies off: standard deviations, and how long an error lasts.

    The defaults are those of the labels of sequence 0000, of nine parked cars and vans in the world (GPS/IMU drift
    included): their centres step by 0.03 to 0.04 m along each axis from frame to frame, 0.3 to 0.4 m/s, and their
    headings by 0.006 rad.  KITTI's labels keep one size over a track, so an error of the size does so too; how large
    it is cannot be seen in the labels, and 0.05 m is our guess.

    Attributes:
        along: of the centre, along the heading [m].
        across: of the centre, to the left [m].
        up: of the centre, upwards [m].
        yaw: of the heading [rad].
        size: of length, width and height, once a track [m].
        correlation: of an error with that of the frame before; 0 makes every frame independent.
    """

    along: float = 0.10
    across: float = 0.08
    up: float = 0.07
    yaw: float = 0.013
    size: float = 0.05
    correlation: float = 0.92

    def __post_init__(self) -> None:
        if min(self.along, self.across, self.up, self.yaw, self.size) < 0.0 or not 0.0 <= self.correlation < 1.0:
            raise InputError(f"a jitter needs deviations >= 0 and 0 <= correlation < 1, got {self}")


def jittered(box: Box, frame: int, jitter: BoxJitter, seed: tuple[int, ...]) -> Box:
    """Draw the label of a box as a person might.

    Args:
        box: the exact one.
        frame: its number.
        jitter: how far off people are.
        seed: of the sequence's jitter; a track's errors do not depend on other tracks, nor on the order of frames.
    """
    n_steps = 64 * (frame // 64 + 1)  # series are made in blocks: a longer one starts like a shorter one
    offsets, size_offset = _series(jitter, (*seed, _STREAM, box.track_id), n_steps)
    along, across, up, turn = offsets[frame]
    T_box_label = se3.from_yaw(float(turn), np.array([along, across, up]))
    size = np.maximum(box.size + size_offset, _SMALLEST * box.size)
    return replace(box, T_lidar_obj=box.T_lidar_obj @ T_box_label, size=size)


@lru_cache(maxsize=1024)
def _series(
    jitter: BoxJitter, seed: tuple[int, ...], n_steps: int
) -> tuple[Float64[np.ndarray, "n 4"], Float64[np.ndarray, "3"]]:
    """Give the errors of a track's boxes, frame by frame, and that of its size."""
    from scipy.signal import lfilter  # takes a second to load, and few simulations jitter

    rng = np.random.default_rng(seed)
    size_offset = jitter.size * rng.normal(size=3)
    rho = jitter.correlation
    fresh = rng.normal(size=(n_steps, 4))
    fresh[1:] *= np.sqrt(1.0 - rho**2)  # the variance stays that of the first
    series = lfilter([1.0], [1.0, -rho], fresh, axis=0)
    return series * [jitter.along, jitter.across, jitter.up, jitter.yaw], size_offset
