"""When each scan was taken: timestamp files, or KITTI's nominal ten sweeps a second."""

import re
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from tracker.errors import DataError
from tracker.kitti.text import read_lines

NOMINAL_PERIOD = 0.1  # [s]

_STAMP = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(\.\d+)?$")


def read_times(path: Path) -> Float64[np.ndarray, " n"]:
    """Read one timestamp a line: `2011-09-26 13:04:32.335337762`, or seconds.

    Seconds count from midnight (UTC) before the first stamp: a float64 holds nanoseconds of a day, not of an epoch.

    Line k + 1 is frame k: a blank line between others is a frame without a time, and no reason to move the next up.

    Raises:
        DataError: a line is neither, or time does not advance; the message has path and line.
    """
    lines = [line.strip() for line in read_lines(path)]
    seconds = [_parse(path, number, line) for number, line in enumerate(lines, start=1)]
    if not seconds:
        raise DataError(path, "expected one timestamp a line, got an empty file")
    origin = 86400 * int(seconds[0][0] // 86400) if seconds[0][0] > 86400 else 0
    times = np.array([whole - origin + fraction for whole, fraction in seconds])
    backwards = np.flatnonzero(np.diff(times) <= 0.0)
    if len(backwards):
        k = int(backwards[0])
        what = f"expected a later time than in line {k + 1}, got {lines[k + 1]!r} after {lines[k]!r}"
        raise DataError(path, what, k + 2)
    return times


def nominal_times(n_frames: int) -> Float64[np.ndarray, " n"]:
    """Give the times of sweeps at the nominal 10 Hz."""
    return NOMINAL_PERIOD * np.arange(n_frames)


def _parse(path: Path, number: int, text: str) -> tuple[int, float]:
    """Split a stamp into whole seconds and their fraction."""
    match = _STAMP.match(text)
    if match:
        try:
            whole = datetime.strptime(match[1], "%Y-%m-%d %H:%M:%S").replace(tzinfo=timezone.utc)
        except ValueError:
            raise DataError(path, f"expected a date and a time, got {text!r}", number) from None
        return int(whole.timestamp()), float(match[2] or 0.0)
    try:
        seconds = float(text)
    except ValueError:
        what = f"expected a timestamp (2011-09-26 13:04:32.335337762, or seconds), got {text!r}"
        raise DataError(path, what, number) from None
    if not np.isfinite(seconds):
        raise DataError(path, f"expected a finite time, got {text!r}", number)
    return int(seconds // 1), seconds % 1
