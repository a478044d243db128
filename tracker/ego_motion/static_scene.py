"""The part of a scan that stands still: everything outside the boxes of objects."""

from dataclasses import dataclass, replace

import numpy as np

from registration.types import Points
from tracker.boxes import points_in_boxes
from tracker.types import Frame

# A step is found from a metre off at most, and nothing tells how long the first one is: all that a car may drive are
# tried, a metre a step apart.
START_SPEEDS = (0.0, 10.0, 20.0, 30.0, 40.0)  # [m/s]


@dataclass(frozen=True)
class SceneSettings:
    """Which points count as the static scene."""

    margin: float = 0.3  # boxes are enlarged by this on each side: labels are loose, and objects have mirrors [m]
    min_range: float = 2.5  # nearer points are the car's own roof [m]
    max_range: float = 80.0  # farther ones are few, and their rings are metres apart [m]


def static_points(frame: Frame, settings: SceneSettings) -> Points:
    """Take the boxes of all objects, of every class, out of a scan; none where the frame has no scan.

    Args:
        frame: with points and boxes.
        settings: which points count.

    Returns:
        points (n, 3) in the order of the scan [m].
    """
    points = frame.points_lidar
    if points is None:
        return np.empty((0, 3))
    range_m = np.hypot(points[:, 0], points[:, 1])
    is_static = (settings.min_range < range_m) & (range_m < settings.max_range)
    boxes = [replace(box, size=box.size + 2.0 * settings.margin) for box in frame.boxes]
    for rows in points_in_boxes(points, boxes):
        is_static[rows] = False
    return points[is_static]
