"""Nearest neighbours equal SciPy's, wherever the cloud lies and however odd it is."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from registration import icp_kernels, iterative, planar
from registration.neighbours import (
    CELLS_ANYWAY,
    CELLS_PER_POINT,
    build_grid,
    build_grids,
    k_nearest,
    nearest,
    nearest_many,
    pack,
    pack_arrays,
)


def car_side(n, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-2.2, 2.2, n), rng.normal(0.0, 0.03, n), rng.uniform(0.0, 1.5, n)])


def assert_as_scipy(cloud, queries, radius, found):
    """Rows may differ where two points are equally near; distances may not."""
    rows, distances = found
    expected, _ = KDTree(cloud).query(queries, distance_upper_bound=radius)
    np.testing.assert_allclose(distances, expected, rtol=1e-12, atol=0.0)
    np.testing.assert_array_equal(rows >= 0, np.isfinite(expected))
    has_one = rows >= 0
    off = np.linalg.norm(queries[has_one] - cloud[rows[has_one]], axis=1)
    np.testing.assert_allclose(off, expected[has_one], rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("cell", [0.01, 0.1, 0.7, 50.0])
@pytest.mark.parametrize("radius", [0.05, 0.4, 100.0])
@pytest.mark.parametrize("place", [[0.0, 0.0, 0.0], [5e5, -6e6, 300.0]])
def test_they_are_scipys_whatever_the_cells_the_radius_and_the_place(cell, radius, place):
    cloud, queries = car_side(400) + place, car_side(300, 1) + [0.1, 0.05, 0.0] + place
    assert_as_scipy(cloud, queries, radius, nearest(build_grid(cloud, cell), queries, radius))


@pytest.mark.parametrize("k", [1, 3, 40])
def test_the_k_nearest_are_scipys_too_and_missing_ones_are_told(k):
    cloud, queries = car_side(30), car_side(50, 1)
    rows, distances = k_nearest(build_grid(cloud, 0.3), queries, k, 0.5)
    expected, _ = KDTree(cloud).query(queries, k=np.arange(1, k + 1), distance_upper_bound=0.5)
    assert rows.shape == (50, k)
    np.testing.assert_allclose(distances, expected, rtol=1e-12)
    np.testing.assert_array_equal(rows == -1, np.isinf(expected))


def test_a_neighbour_exactly_on_the_radius_is_out_as_in_scipy():
    cloud = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    rows, distances = nearest(build_grid(cloud, 0.25), np.array([[-0.25, 0.0, 0.0], [0.625, 0.0, 0.0]]), 0.25)
    assert rows.tolist() == [-1, 1]
    assert distances.tolist() == [np.inf, 0.125]


def test_points_on_the_borders_of_cells_are_found():
    axis = np.arange(8) * 0.25
    cloud = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    rows, distances = nearest(build_grid(cloud, 0.25), cloud, 0.1)
    np.testing.assert_array_equal(rows, np.arange(len(cloud)))
    assert distances.max() == 0.0


def test_an_empty_cloud_has_no_neighbours_and_no_queries_have_none():
    empty = np.empty((0, 3))
    rows, distances = nearest(build_grid(empty, 0.1), car_side(3), 1.0)
    assert rows.tolist() == [-1, -1, -1]
    assert np.isinf(distances).all()
    assert len(nearest(build_grid(car_side(3), 0.1), empty, 1.0)[0]) == 0
    assert nearest_many([], [], 1.0) == []


def test_one_point_and_duplicates_are_clouds_like_any_other():
    one = np.array([[3.0, 4.0, 0.0]])
    assert nearest(build_grid(one, 0.1), np.zeros((1, 3)), 5.1)[1] == 5.0
    same = np.repeat(one, 1000, axis=0)
    rows, distances = nearest(build_grid(same, 0.1), one + [0.0, 0.0, 0.01], 0.1)
    assert 0 <= rows[0] < 1000
    assert distances[0] == pytest.approx(0.01)


def test_a_cloud_that_spans_the_world_takes_no_more_memory_than_its_points():
    cloud = np.concatenate([car_side(100), car_side(100) + [1e7, -1e7, 0.0]])
    grid = build_grid(cloud, 0.1)
    assert len(grid.first) <= CELLS_PER_POINT * 200 + CELLS_ANYWAY + 1
    assert_as_scipy(cloud, cloud + 0.01, 0.1, nearest(grid, cloud + 0.01, 0.1))
    huge = np.array([[1e300, 0.0, 0.0], [-1e300, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert nearest(build_grid(huge, 0.1), np.array([[1.01, 0.0, 0.0]]), 0.1)[0].tolist() == [2]


def test_far_queries_find_nothing_and_break_nothing():
    grid = build_grid(car_side(50), 0.1)
    queries = np.array([[1e300, 0.0, 0.0], [-1e9, 1e9, 0.0], [np.inf, 0.0, 0.0]])
    assert nearest(grid, queries, 0.5)[0].tolist() == [-1, -1, -1]


@pytest.mark.parametrize("threads", [1, 3])
def test_many_clouds_at_once_are_the_same_as_one_by_one(threads):
    sizes = [(1, 5), (0, 3), (300, 200), (7, 0), (40, 40)]
    clouds = [car_side(n, n) + [100.0 * n, 0.0, 0.0] for n, _ in sizes]
    queries = [car_side(m, m + 1) + [100.0 * n, 0.0, 0.0] for n, m in sizes]
    grids = [build_grid(cloud, 0.2) for cloud in clouds]
    together = nearest_many(grids, queries, 0.3, threads)
    for grid, query, (rows, distances) in zip(grids, queries, together, strict=True):
        alone = nearest(grid, query, 0.3)
        np.testing.assert_array_equal(rows, alone[0])
        np.testing.assert_array_equal(distances, alone[1])


def test_a_grid_keeps_the_cloud_and_leaves_it_as_it_was():
    cloud = car_side(100)
    before = cloud.copy()
    grid = build_grid(cloud[::-1], 0.2)
    np.testing.assert_array_equal(cloud, before)
    np.testing.assert_array_equal(grid.points, cloud[::-1][grid.order])
    assert grid.first[-1] == 100


def test_grids_of_many_clouds_are_those_of_each():
    clouds, cells = [car_side(40), np.empty((0, 3)), car_side(7) + [1e6, -1e6, 0.0], car_side(1)], [0.2, 0.1, 0.5, 0.3]
    found, order = build_grids(*pack_arrays(clouds), np.array(cells))
    grids = [build_grid(cloud, cell) for cloud, cell in zip(clouds, cells, strict=True)]
    for one, other in zip(found, pack(grids), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(order, np.concatenate([grid.order for grid in grids]))


def test_many_clouds_are_turned_about_their_own_places_and_centred():
    clouds = [car_side(40) + [5.0, 2.0, 0.0], np.empty((0, 3)), car_side(3) + [1e6, -1e6, 0.0]]
    points, begin = pack_arrays(clouds)
    turns, places, shifts = np.array([0.3, 1.0, -2.0]), np.array([[4.0, 1.0], [0, 0], [1e6, -1e6]]), np.eye(3)[:, :2]
    icp_kernels.move_all(points, begin, turns, places, shifts)
    found = iterative.centered(points, begin)
    assert found.sizes.tolist() == [40, 0, 3]
    for k, cloud in enumerate(clouds):
        moved = cloud.copy()
        moved[:, :2] = (cloud[:, :2] - places[k]) @ planar.rotation(turns[k]).T + places[k] + shifts[k]
        mean = moved.mean(axis=0) if len(cloud) else np.zeros(3)
        np.testing.assert_allclose(found.centroids[k], mean, atol=1e-8)
        np.testing.assert_allclose(found.points[begin[k] : begin[k + 1]], moved - mean, atol=1e-8)
