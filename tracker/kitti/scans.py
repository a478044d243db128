"""Velodyne scans: `.bin` files of float32 x, y, z, reflectance."""

from pathlib import Path

import numpy as np

from registration.types import Points
from tracker.errors import DataError, MissingDataError

BYTES_PER_POINT = 16


def read_scan(path: Path) -> Points:
    """Read the points of one sweep (n, 3) in LiDAR axes [m].

    Raises:
        MissingDataError: there is no such file.
        DataError: the file ends in the middle of a point, or a coordinate is NaN or infinite.
    """
    if not path.is_file():
        raise MissingDataError(f"{path}: no such scan")
    n_bytes = path.stat().st_size
    if n_bytes % BYTES_PER_POINT:
        what = f"expected a multiple of {BYTES_PER_POINT} bytes (float32 x, y, z, reflectance), got {n_bytes}"
        raise DataError(path, f"{what}: the last point is cut off")
    columns = np.fromfile(path, dtype=np.float32).reshape(-1, 4)
    points = columns[:, :3].astype(np.float64)
    if not np.isfinite(points).all():
        finite = np.isfinite(points).all(axis=1)
        first = int(np.argmin(finite))
        what = f"expected finite coordinates, got {int((~finite).sum())} of {len(points)} points with NaN or infinity"
        raise DataError(path, f"{what}, first at point {first}")
    return points
