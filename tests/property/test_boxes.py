"""Whatever the boxes and points: the raster finds what testing every point against every box finds."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from registration import se3
from tracker.boxes import points_in_boxes
from tracker.types import Box

ROUNDING = 1e-9  # relative to the coordinates: nearer to a border than this, both answers are right


@st.composite
def scenes(draw):
    """Boxes, upright or rolled, and points in and about them, over any area from one box to a continent."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    extent = draw(st.sampled_from([0.1, 5.0, 80.0, 3e3, 1e6]))
    n_boxes, n_points, is_upright = draw(st.integers(0, 8)), draw(st.integers(0, 200)), draw(st.booleans())
    boxes = [random_box(rng, i, extent, is_upright) for i in range(n_boxes)]
    points = rng.uniform(-extent, extent, (n_points, 3))
    for box in boxes:  # a third of each box's own points are in it: 0.7^3
        shape = rng.uniform(-0.7, 0.7, (draw(st.integers(0, 20)), 3)) * box.size
        points = np.concatenate([points, se3.transform(box.T_lidar_obj, shape)])
    return rng.permutation(points), boxes


def random_box(rng, track_id, extent, is_upright):
    R = se3.from_yaw(rng.uniform(-np.pi, np.pi), np.zeros(3))[:3, :3]
    if not is_upright:
        R = se3.nearest_rotation(rng.normal(size=(3, 3)))
    center = rng.uniform(-extent, extent, 3)
    return Box(track_id, "Car", se3.pose(R, center), rng.uniform([0.1, 0.1, 0.1], [12.0, 3.0, 4.0]))


def excess(points, box):
    """How far each point is out of a box along its worst axis [m]; negative inside."""
    R, center = box.T_lidar_obj[:3, :3], box.T_lidar_obj[:3, 3]
    if len(points) == 0:
        return np.empty(0)
    return np.max(np.abs((points - center) @ R) - box.size / 2, axis=1)


@given(scene=scenes())
def test_every_point_is_found_in_the_boxes_that_hold_it_and_in_no_other(scene):
    points, boxes = scene
    tolerance = ROUNDING * (1.0 + np.abs(points).max(initial=0.0))
    found = points_in_boxes(points, boxes)
    assert len(found) == len(boxes)
    for box, rows in zip(boxes, found, strict=True):
        out = excess(points, box)
        is_found = np.zeros(len(points), dtype=bool)
        is_found[rows] = True
        assert is_found[out < -tolerance].all()
        assert not is_found[out > tolerance].any()
        assert (np.diff(rows) > 0).all()


@given(scene=scenes(), seed=st.integers(0, 2**32 - 1))
def test_neither_other_boxes_nor_the_order_of_points_matter(scene, seed):
    points, boxes = scene
    order = np.random.default_rng(seed).permutation(len(points))
    together = points_in_boxes(points, boxes)
    for box, rows in zip(boxes, together, strict=True):
        (alone,) = points_in_boxes(points[order], [box])
        np.testing.assert_array_equal(np.sort(order[alone]), rows)
