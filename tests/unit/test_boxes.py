"""Points in boxes: borders, overlaps, nothing at all, and boxes at the end of the world."""

import tracemalloc
from math import pi

import numpy as np
import pytest

from registration import se3
from tests.kitti_folder import scan, things
from tracker.boxes import points_in_boxes
from tracker.types import Box


def box(center, size=(4.0, 2.0, 1.0), yaw=0.0, track_id=0):
    return Box(track_id, "Car", se3.from_yaw(yaw, np.array(center, dtype=float)), np.array(size, dtype=float))


def rows(points, *boxes):
    return [found.tolist() for found in points_in_boxes(np.array(points, dtype=float).reshape(-1, 3), boxes)]


def test_the_tiny_scans_objects_are_found_point_by_point():
    for k in range(5):
        boxes = [box(thing.center, thing.size, thing.yaw) for thing in things(k)]
        found = points_in_boxes(scan(k)[:, :3].astype(float), boxes)
        start = (12 + k + 1) // 2  # half the wall's points come first
        for thing, inside in zip(things(k), found, strict=True):
            np.testing.assert_array_equal(inside, np.arange(start, start + thing.n_points))
            start += thing.n_points


def test_a_point_on_a_border_is_in_and_the_next_number_beyond_it_is_out():
    border = np.array([2.0, 1.0, 0.5])  # half the size, all powers of two: no rounding
    points = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            on = np.zeros(3)
            on[axis] = sign * border[axis]
            beyond = on.copy()
            beyond[axis] = sign * np.nextafter(border[axis], np.inf)
            points += [on, beyond]
    assert rows(points, box((0.0, 0.0, 0.0))) == [[0, 2, 4, 6, 8, 10]]


def test_corners_and_edges_are_in():
    corners = [[x, y, z] for x in (8.0, 12.0) for y in (-4.0, -2.0) for z in (-1.5, -0.5)]
    assert rows([*corners, [8.0, -3.0, -1.5]], box((10.0, -3.0, -1.0))) == [list(range(9))]


def test_a_turned_box_holds_what_its_turned_sides_enclose():
    quarter = box((5.0, 5.0, 0.0), yaw=pi / 2)  # 4 m along y now
    assert rows([[5.0, 6.9, 0.0], [6.9, 5.0, 0.0], [5.9, 3.1, 0.4], [5.0, 7.1, 0.0]], quarter) == [[0, 2]]
    eighth = box((0.0, 0.0, 0.0), yaw=pi / 4)  # the corner of its upright rectangle is far outside
    assert rows([[1.2, 1.2, 0.0], [1.2, -1.2, 0.0], [-1.4, -1.4, 0.0]], eighth) == [[0, 2]]


def test_a_point_in_two_boxes_belongs_to_both():
    assert rows([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [3.0, 0.0, 0.0]], box((0, 0, 0)), box((2, 0, 0), track_id=1)) == [
        [0, 1],
        [0, 1, 2],
    ]


def test_rows_come_in_the_scans_order_as_integers():
    (found,) = points_in_boxes(np.zeros((5, 3)), [box((0.0, 0.0, 0.0))])
    assert found.dtype == np.int64
    assert found.tolist() == [0, 1, 2, 3, 4]


def test_an_empty_scan_leaves_every_box_empty():
    assert rows([], box((0, 0, 0)), box((9, 9, 0))) == [[], []]


def test_a_scan_without_boxes_gives_nothing():
    assert rows([[0.0, 0.0, 0.0]]) == []


def test_a_box_where_no_point_is_stays_empty():
    assert rows([[0.0, 0.0, 0.0], [0.0, 0.0, 40.0]], box((100.0, -70.0, 0.0)), box((0.0, 0.0, 20.0))) == [[], []]


@pytest.mark.parametrize("far", [1e4, 1e7, 1e15, 1e300])
def test_a_box_far_away_costs_no_memory_and_changes_no_other(far):
    points = np.array([[1.0, 0.5, 0.0], [50.0, 0.0, 0.0], [far, far, 0.0]])
    tracemalloc.start()
    found = points_in_boxes(points, [box((0.0, 0.0, 0.0)), box((far, far, 0.0), track_id=1)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [inside.tolist() for inside in found] == [[0], [2]]
    assert peak < 10e6


def test_a_box_as_large_as_a_country_holds_the_scan():
    assert rows([[1.0, 0.5, 0.0], [500.0, -300.0, 10.0], [0.0, 0.0, 2e5]], box((0, 0, 0), (1e6, 1e6, 1e3))) == [[0, 1]]


def test_points_far_away_from_all_boxes_do_no_harm():
    assert rows([[1e300, -1e300, 0.0], [1.0, 0.0, 0.0], [-1e18, 0.0, 0.0]], box((0, 0, 0))) == [[1]]
