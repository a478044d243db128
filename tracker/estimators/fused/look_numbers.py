"""What compiled loops want to know of looks, every frame: a row of numbers for each look."""

import math
from typing import Final

from tracker.estimators.fused.look import Look

# Columns: of `Look`; and when the beams met the object's centre, after what the clock tells [s], and how far that is
# past the direction in which sweeps end [m], NaN where that does not matter (`track.Tracks.look_back`).
N_POINTS: Final = 0
N_FROM_1M: Final = 1
SENSOR: Final = 2  # x, y
TIME: Final = 4
DELAY: Final = 5
CLOCK: Final = 6
FRAME: Final = 7
IS_TIMED: Final = 8
IS_TORN: Final = 9
LATE: Final = 10
PAST_END: Final = 11
N_COLUMNS: Final = 12


def numbers_of(look: Look) -> tuple[float, ...]:
    """Give the row of a look."""
    x, y = look.sensor.place.tolist()
    moments = look.time, look.delay, look.clock, look.frame
    return look.n_points, look.n_from_1m, x, y, *moments, look.is_timed, look.is_torn, 0.0, math.nan
