"""Generalised ICP: what it finds, what it leaves to the belief, and that its equations are small_gicp's."""

import sys

import numpy as np
import pytest

import registration
from registration import planar, se3
from registration.belief import believe
from registration.errors import MissingLibraryError
from registration.methods import gicp
from registration.types import MotionPrior, Status
from tests.segments import car_cloud

small_gicp = pytest.importorskip("small_gicp")
PLACE = np.array([12.0, 5.0, 0.0])


def ring(n=25, seed=0, z=0.6):
    """Sample one scan ring on the long side of a car."""
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-2.0, 2.0, n))
    return np.column_stack([x, np.full(n, -0.9), np.full(n, z)]) + rng.normal(0.0, 0.005, (n, 3)) + PLACE


def test_the_same_cloud_moved_and_turned_is_found():
    source = car_cloud(400) + PLACE
    T = planar.to_transform(np.array([0.4, -0.2, 0.05]), source.mean(axis=0), z=0.1)
    result = registration.create("gicp", tolerance=1e-6).register(source, se3.transform(T, source))
    np.testing.assert_allclose(result.T_target_source, T, atol=2e-3)
    assert result.status is Status.CONVERGED
    assert result.n_pairs == 400


def test_two_samples_of_one_surface_agree_within_the_covariance():
    errors = []
    for seed in range(20):
        source, target = car_cloud(400, seed) + PLACE, car_cloud(400, seed + 100) + PLACE + [0.3, 0.1, 0.0]
        result = registration.create("gicp").register(source, target)
        error = result.motion_about(result.source_centroid)[:2] - [0.3, 0.1]
        errors.append(error @ np.linalg.solve(result.covariance[:2, :2], error))
    assert np.mean(errors) < 3.0  # 2 is honest; clean clouds leave it below


def test_a_second_look_at_the_upper_half_is_no_lift_of_the_object():
    source = car_cloud(500) + PLACE
    target = source[source[:, 2] > 0.4] + [0.2, 0.0, 0.0]
    result = registration.create("gicp").register(source, target)
    assert abs(result.T_target_source[2, 3]) < 0.6 * (target - source.mean(axis=0))[:, 2].mean()
    assert np.hypot(*(result.motion_about(result.source_centroid)[:2] - [0.2, 0.0])) < 0.05


def test_one_scan_ring_neither_tilts_nor_runs_away_and_may_have_slid_along():
    for seed in range(10):
        source, target = ring(seed=seed), ring(seed=seed + 50, z=0.9) + [0.3, 0.02, 0.0]
        result = registration.create("gicp").register(source, target)
        assert result.T_target_source[2, 2] == 1.0
        assert np.hypot(*(result.motion_about(result.source_centroid)[:2] - [0.3, 0.02])) < 1.0
        along, across = np.sqrt(np.diag(result.covariance)[:2])
        assert along > 1.5 * across
        assert along > 0.05


def test_a_prior_decides_where_a_side_leaves_its_own_direction_open():
    source, target = ring(), ring(seed=1)[:15] + [0.3, 0.0, 0.0]  # the front is hidden in the second look
    prior = MotionPrior(np.array([0.3, 0.0, 0.0]), np.diag([0.02, 0.5, 0.1]) ** 2)
    result = registration.create("gicp").register(source, target, prior)
    x, y, _ = result.motion_about(result.source_centroid)
    assert x == pytest.approx(0.3, abs=0.05)
    assert y == pytest.approx(0.0, abs=0.05)
    assert registration.create("gicp").register(source, target).motion_about(source.mean(axis=0))[0] < 0.0


def test_a_prior_that_claims_certainty_is_believed():
    source = car_cloud(200) + PLACE
    prior = MotionPrior(np.array([0.2, 0.1, 0.0]), np.zeros((3, 3)))
    result = registration.create("gicp").register(source, source, prior)
    np.testing.assert_allclose(result.motion_about(result.source_centroid), [0.2, 0.1, 0.0], atol=1e-2)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_points_give_the_centroids_shift_and_say_so(n):
    source = car_cloud(50)
    result = registration.create("gicp").register(source, source[:n])
    assert result.status is Status.TOO_FEW_POINTS
    np.testing.assert_allclose(result.T_target_source[:3, 3], source[:n].mean(axis=0) - source.mean(axis=0))
    assert result.covariance[0, 0] > 0.2**2


def test_clouds_that_nowhere_touch_have_no_overlap_and_a_wider_covariance():
    corners = np.array([[3.0, 0, 0], [-3.0, 0, 0], [0, 3.0, 0], [0, -3.0, 0], [3.0, 3.0, 0], [-3.0, -3.0, 0]])
    result = registration.create("gicp").register(corners, 0.4 * corners)
    assert result.status is Status.NO_OVERLAP
    belief = believe(corners, 0.4 * corners, None, 0.1)
    np.testing.assert_allclose(result.covariance, gicp.UNLIKE * belief.covariance)


def test_the_normal_equations_are_those_of_small_gicp_whose_order_is_rotation_first():
    """small_gicp perturbs on the right, (rotation, translation) about the source's origin; ours on the left."""
    rng = np.random.default_rng(3)
    source = car_cloud(120)
    source -= source.mean(axis=0)  # the centroid is the origin: both then turn about the same point
    target = source + rng.normal(0.0, 0.01, source.shape) + [0.02, 0.01, 0.0]
    middle = target.mean(axis=0)
    method = registration.create("gicp", robust_scale=1e9)
    a, b = method.prepare([source, target])
    H, gradient = method._normal_equations(np.eye(4), a, b, method._pair(np.eye(4), a, b))
    factor, rejector = small_gicp.GICPFactor(), small_gicp.DistanceRejector()
    rejector.set_max_distance(0.5)
    clouds = _cloud(target - middle), _cloud(source)
    terms = [factor.linearize(*clouds, b.tree, se3.pose(np.eye(3), -middle), i, rejector) for i in range(120)]
    H6, b6 = sum(term[1] for term in terms), sum(term[2] for term in terms).ravel()
    ours = [3, 4, 2, 5]  # (x, y, yaw, z) among (rx, ry, rz, x, y, z)
    np.testing.assert_allclose(H, H6[np.ix_(ours, ours)], rtol=1e-6, atol=1e-6 * H6.max())
    np.testing.assert_allclose(gradient, -b6[ours], rtol=1e-6, atol=1e-6 * np.abs(b6).max())


def _cloud(points):
    cloud = small_gicp.PointCloud(points)
    small_gicp.estimate_covariances(cloud, small_gicp.KdTree(cloud), 10)
    return cloud


@pytest.mark.parametrize(
    ("setting", "value"),
    [("max_distance", 0.0), ("max_iterations", 0), ("n_neighbours", 4), ("min_points", 4), ("robust_scale", -1.0)],
)
def test_settings_that_cannot_work_are_refused(setting, value):
    with pytest.raises(ValueError, match=setting):
        registration.create("gicp", **{setting: value})


def test_without_small_gicp_creation_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(MissingLibraryError, match=r"gicp needs small_gicp.*pip install 'regmot\[gicp\]'"):
        registration.create("gicp")


def test_a_world_far_from_its_origin_changes_nothing():
    source = car_cloud(300) + PLACE
    target = car_cloud(300, 1) + PLACE + [0.3, 0.0, 0.0]
    far = np.array([4.5e5, 5.4e6, 100.0])  # UTM
    here, there = (registration.create("gicp").register(source + o, target + o) for o in (np.zeros(3), far))
    moved = there.motion_about(there.source_centroid)
    np.testing.assert_allclose(moved, here.motion_about(here.source_centroid), atol=1e-5)
