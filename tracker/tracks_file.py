"""Tracks with velocities as a CSV file: what `regmot track` writes."""

import csv
from collections.abc import Iterable
from pathlib import Path

from tracker.files import whole_file
from tracker.pipeline import Track

COLUMNS = (
    "frame", "timestamp", "track_id", "class_name", "age", "frame_name", "x", "y", "vx", "vy", "speed",
    "var_vx", "cov_vxvy", "var_vy", "yaw_rate", "range_m", "n_points", "status",
)  # fmt: skip


def write_tracks(path: Path, tracks: Iterable[Track]) -> int:
    """Write one line a track and frame, as they come; the file appears when it is whole.

    Units are m, s, m/s and rad/s; velocities are in the frame that `frame_name` says.

    Returns:
        how many lines were written.
    """
    n_rows = 0
    with whole_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for track in tracks:
            writer.writerow(_row(track))
            n_rows += 1
    return n_rows


def _row(track: Track) -> list[object]:
    e = track.estimate
    (var_vx, cov_vxvy), (_, var_vy) = e.covariance
    numbers = (*e.position, *e.velocity, e.speed, var_vx, cov_vxvy, var_vy, e.yaw_rate, e.range_m)
    return [
        e.frame,
        f"{e.timestamp:.6f}",
        track.track_id,
        track.class_name,
        track.age,
        e.frame_name,
        *(f"{number:.6g}" for number in numbers),
        e.n_points,
        str(e.status),
    ]
