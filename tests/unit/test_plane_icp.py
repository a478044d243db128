"""Point-to-plane ICP: what it finds, what it leaves to the start, and how it says that it knows little."""

import math

import numpy as np
import pytest

import registration
from registration import icp_kernels, planar, se3
from registration.neighbours import build_grid
from registration.types import MotionPrior, Status

PLACE = np.array([12.0, 5.0, 0.0])


def l_shape(n, seed=0, noise=0.01):
    """Sample the long side and the rear of a car."""
    rng = np.random.default_rng(seed)
    on_side = rng.random(n) < 0.7
    x = np.where(on_side, rng.uniform(-2.0, 2.0, n), -2.0)
    y = np.where(on_side, -0.9, rng.uniform(-0.9, 0.9, n))
    return np.column_stack([x, y, rng.uniform(0.0, 1.4, n)]) + rng.normal(0.0, noise, (n, 3)) + PLACE


def side(n, low=-2.0, high=2.0, seed=0, noise=0.01):
    """Sample a stretch of the long side alone."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(low, high, n), np.full(n, -0.9), rng.uniform(0.0, 1.4, n)])
    return points + rng.normal(0.0, noise, (n, 3)) + PLACE


def ring(n, seed=0, noise=0.005):
    """Sample one scan ring about the long side and the rear: an L at one height."""
    cloud = l_shape(n, seed, noise=0.0) * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.7]
    return cloud + np.random.default_rng(seed).normal(0.0, noise, (n, 3))


def planes_of(points, radius=0.5, n_neighbours=20, n_line=20):
    grid = build_grid(points, radius)
    planes, near = np.full((len(points), 5), np.nan), np.full(n_neighbours, -1)
    around = radius, n_neighbours, n_line
    icp_kernels.fit_planes(grid.points, grid.first, grid.frame, np.arange(len(points)), around, near, planes)
    return planes[np.argsort(grid.order)]


def normals_of(points):
    return planes_of(points)[:, :3]


def plane_icp(**settings):
    return registration.create("plane-icp", **settings)


def test_the_same_cloud_moved_is_found():
    source = l_shape(300)
    motion = np.array([0.25, -0.15, np.deg2rad(2.0)])
    result = plane_icp().register(source, se3.transform(planar.to_transform(motion, source.mean(axis=0)), source))
    np.testing.assert_allclose(result.motion_about(source.mean(axis=0)), motion, atol=1e-3)
    assert result.status is Status.CONVERGED
    assert result.n_pairs == 300


def test_two_samples_of_one_surface_agree_better_than_point_to_point_and_within_the_covariance():
    truth, errors, of_points, normalised = np.array([0.3, 0.1, 0.0]), [], [], []
    for seed in range(20):
        source, target = l_shape(400, seed), l_shape(400, seed + 100) + truth
        result = plane_icp().register(source, target)
        error = (result.motion_about(result.source_centroid) - truth)[:2]
        normalised.append(error @ np.linalg.solve(result.covariance[:2, :2], error))
        errors.append(np.hypot(*error))
        points = registration.create("icp", max_distance=0.5).register(source, target)
        of_points.append(np.hypot(*(points.motion_about(source.mean(axis=0)) - truth)[:2]))
        assert result.status is Status.CONVERGED
    assert np.median(errors) < 0.5 * np.median(of_points)
    assert np.median(errors) < 0.01
    assert np.mean(normalised) < 2.0


def test_planes_are_upright_walls_and_flat_floors_and_have_unit_length():
    wall = normals_of(side(300, noise=0.0))
    np.testing.assert_allclose(np.abs(wall), np.tile([0.0, 1.0, 0.0], (300, 1)), atol=1e-9)
    rng = np.random.default_rng(1)
    floor = normals_of(np.column_stack([rng.uniform(0, 2, (200, 2)), np.zeros(200)]))
    np.testing.assert_allclose(np.abs(floor), np.tile([0.0, 0.0, 1.0], (200, 1)), atol=1e-9)
    slope = normals_of(np.column_stack([rng.uniform(0, 2, (200, 2)), np.zeros(200)]) @ _tilt(0.5).T)
    np.testing.assert_allclose(np.abs(slope @ _tilt(0.5)), np.tile([0.0, 0.0, 1.0], (200, 1)), atol=1e-6)


def test_a_single_ring_is_taken_for_an_upright_surface():
    angle = 0.3
    line = np.linspace(-1.0, 1.0, 30)[:, None] * [np.cos(angle), np.sin(angle), 0.0]
    normals = normals_of(line)
    np.testing.assert_allclose(np.abs(normals), np.tile([np.sin(angle), np.cos(angle), 0.0], (30, 1)), atol=1e-9)


def test_rings_on_a_hood_are_no_walls_where_neighbouring_rings_tell():
    rings = [[x, y, 0.0] for x in (0.0, 0.25, 0.5) for y in np.arange(-0.8, 0.81, 0.04)]
    inside = slice(41 + 6, 82 - 6)
    alone, together = (planes_of(np.array(rings), n_neighbours=10, n_line=n)[inside, :3] for n in (10, 30))
    np.testing.assert_allclose(np.abs(alone), np.tile([1.0, 0.0, 0.0], (29, 1)), atol=1e-9)
    np.testing.assert_allclose(np.abs(together), np.tile([0.0, 0.0, 1.0], (29, 1)), atol=1e-9)


def round_end(low, high, seed, noise=0.005):
    """Sample the side of a car that bends into its front (a quarter of a circle), from one angle to another [rad]."""
    rng = np.random.default_rng(seed)
    angle, height = rng.uniform(low, high, 600), rng.uniform(0.0, 1.2, 600)
    points = np.column_stack([np.sin(angle), -np.cos(angle), height])
    straight = np.column_stack([rng.uniform(-2.0, 0.0, 400), np.full(400, -1.0), rng.uniform(0.0, 1.2, 400)])
    return np.vstack([points, straight]) + rng.normal(0.0, noise, (1000, 3)) + PLACE


def test_what_only_one_cloud_shows_behind_an_edge_pulls_less_where_planes_end():
    errors = {math.inf: [], 0.7: []}
    for patch_share, found in errors.items():
        method = plane_icp(patch_share=patch_share, robust_scale=0.05, normal_neighbours=10)
        for seed in range(6):
            source, target = round_end(0.0, 1.4, seed), round_end(0.0, 0.8, seed + 50)
            prior = MotionPrior(np.zeros(3), np.diag([0.3, 0.3, 0.02]) ** 2)
            result = method.align([tuple(method.prepare([source, target]))], [prior])[0]
            found.append(result.motion_about(PLACE)[0])
    assert abs(np.mean(errors[math.inf])) > 0.004
    assert abs(np.mean(errors[0.7])) < 0.6 * abs(np.mean(errors[math.inf]))


def test_two_points_one_place_and_a_pole_have_no_plane():
    assert not normals_of(PLACE + [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]).any()
    assert not normals_of(np.tile(PLACE, (10, 1))).any()
    assert not normals_of(np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 1.5], 20)).any()


def test_how_far_normals_lean_is_known():
    rng, leans, expected = np.random.default_rng(0), [], []
    for _ in range(40):
        wall = np.column_stack([rng.uniform(-0.2, 0.2, 12), np.zeros(12), rng.uniform(-0.2, 0.2, 12)])
        planes = planes_of(wall + rng.normal(0.0, [0.0, 0.02, 0.0], (12, 3)))
        leans.append(planes[0, 0] / planes[0, 1])
        expected.append(planes[0, 3])
    assert np.mean(np.square(leans)) == pytest.approx(np.mean(expected), rel=0.5)


def test_a_flat_side_tells_nothing_of_a_motion_along_it():
    # as where a car passes behind a gap: what is seen of its side slides along it, and stays
    source, target = side(150, seed=1, noise=0.015), side(150, seed=2, noise=0.015)
    prior = MotionPrior(np.array([0.3, 0.0, 0.0]), np.diag([0.5, 0.5, 0.02]) ** 2)
    method = plane_icp(independent_pairs=200.0, normal_neighbours=10)
    result = method.align([tuple(method.prepare([source, target]))], [prior])[0]
    along, across = np.sqrt(result.covariance.diagonal()[:2])
    assert along > 0.4
    assert across < 0.05


def test_a_roof_that_comes_into_view_does_not_slide_sloping_planes():
    rng = np.random.default_rng(3)

    def car(n, has_roof):
        side = np.column_stack([rng.uniform(-2.0, 2.0, n), np.full(n, -0.9), rng.uniform(0.0, 0.8, n)])
        along = rng.uniform(0.8, 2.0, n)
        slope = np.column_stack([along, rng.uniform(-0.9, 0.9, n), 1.4 - 0.6 * (along - 0.8)])
        roof = np.column_stack([rng.uniform(-1.5, 0.8, n // 3), rng.uniform(-0.9, 0.9, n // 3), np.full(n // 3, 1.4)])
        hood = np.column_stack([rng.uniform(2.0, 3.0, n), rng.uniform(-0.9, 0.9, n), np.full(n, 0.68)])
        return np.concatenate([side, slope, hood, roof] if has_roof else [side, slope, hood]) + PLACE

    source, target = car(300, has_roof=False), car(300, has_roof=True) + [0.1, 0.0, 0.0]
    prior = MotionPrior(np.zeros(3), np.diag([0.2, 0.2, 0.02]) ** 2)
    result = plane_icp().register(source, target, prior)
    np.testing.assert_allclose(result.T_target_source[:3, 3], [0.1, 0.0, 0.0], atol=0.015)


def test_a_floor_tells_nothing_of_a_horizontal_motion_and_is_said_not_to():
    rng = np.random.default_rng(2)
    floor = np.column_stack([rng.uniform(-2, 2, (800, 2)), rng.normal(0, 0.01, 800)]) + PLACE
    result = plane_icp().register(floor, floor + [0.2, 0.1, 0.0])
    assert result.status is Status.NOT_CONVERGED
    np.testing.assert_allclose(result.T_target_source[:2, 3], [0.2, 0.1], atol=1e-9)  # the start: between the centroids


def test_along_a_side_the_start_decides_and_the_covariance_and_the_status_say_so():
    source, target = side(200), side(200, seed=1) + [0.3, 0.1, 0.0]
    result = plane_icp().register(source, target)
    shift = target.mean(axis=0) - source.mean(axis=0)
    x, y, _ = result.motion_about(source.mean(axis=0))
    assert result.status is Status.NOT_CONVERGED
    assert x == pytest.approx(shift[0], abs=0.05)
    assert y == pytest.approx(0.1, abs=0.01)  # across the side the planes know better than the centroids
    along, across = np.sqrt(np.diag(result.covariance)[:2])
    assert along > 0.1 > 5.0 * across


def test_a_prior_decides_along_a_side():
    source, target = side(200), side(200, low=-2.0, high=1.0, seed=1) + [0.3, 0.1, 0.0]
    prior = MotionPrior(np.array([0.3, 0.0, 0.0]), np.diag([0.05, 0.5, 0.05]) ** 2)
    x, y, _ = plane_icp().register(source, target, prior).motion_about(source.mean(axis=0))
    assert x == pytest.approx(0.3, abs=0.03)
    assert y == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 15, 30])
def test_sparse_rings_never_run_away_and_are_less_sure_the_fewer_their_points(n):
    truth = np.array([0.4, 0.1, 0.0])
    for seed in range(10):
        source, target = ring(n, seed), ring(n, seed + 50) + truth
        result = plane_icp().register(source, target)
        start = target.mean(axis=0) - source.mean(axis=0)
        assert np.hypot(*(result.motion_about(source.mean(axis=0)) - start)[:2]) < 1.5
        assert np.sqrt(np.linalg.eigvalsh(result.covariance[:2, :2])[1]) > 0.25 / np.sqrt(n)
        if n >= 3:
            error = (result.motion_about(source.mean(axis=0)) - truth)[:2]
            assert error @ np.linalg.solve(result.covariance[:2, :2], error) < 20.0


def test_clouds_that_nowhere_touch_have_no_overlap():
    apart = np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, -3.0, 0.0]])
    assert plane_icp().register(apart, 0.5 * apart).status is Status.NO_OVERLAP


def test_few_points_give_the_centroids_shift_and_an_empty_cloud_leaves_everything_open():
    few = plane_icp().register(l_shape(50), l_shape(2))
    assert few.status is Status.TOO_FEW_POINTS
    np.testing.assert_allclose(few.T_target_source[:3, 3], l_shape(2).mean(axis=0) - l_shape(50).mean(axis=0))
    nothing = plane_icp().register(l_shape(30), np.empty((0, 3)))
    assert nothing.status is Status.TOO_FEW_POINTS
    assert nothing.covariance[0, 0] >= 3.0**2


def test_less_overlap_is_less_sure():
    source = l_shape(400)
    whole = plane_icp().register(source, source + [0.1, 0.0, 0.0])
    part = plane_icp().register(source, source[source[:, 0] < 12.0] + [0.1, 0.0, 0.0])
    assert np.trace(part.covariance[:2, :2]) > 2.0 * np.trace(whole.covariance[:2, :2])


def test_iterations_that_run_out_are_no_convergence():
    source = l_shape(300)
    turned = se3.transform(planar.to_transform(np.array([0.0, 0.0, 0.1]), source.mean(axis=0)), source)
    assert plane_icp(max_iterations=1).register(source, turned).status is Status.NOT_CONVERGED


@pytest.mark.parametrize(
    "settings",
    [
        {"max_distance": 0.0},
        {"noise": -0.1},
        {"robust_scale": float("nan")},
        {"unsure": 0.0},
        {"max_iterations": 0},
        {"normal_neighbours": 2},
    ],
)
def test_settings_that_cannot_work_are_refused(settings):
    (name,) = settings
    with pytest.raises(ValueError, match=f"{name} must be"):
        plane_icp(**settings)


def _tilt(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def test_covariances_of_all_sizes_are_inverted():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(22, 3, 3)) * 10.0 ** rng.uniform(-4.0, 4.0, (22, 1, 1))
    matrices = roots @ roots.transpose(0, 2, 1)
    np.testing.assert_allclose(icp_kernels.inverses(matrices) @ matrices, np.tile(np.eye(3), (22, 1, 1)), atol=1e-8)
