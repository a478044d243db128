"""The global methods, by features and RANSAC and by FGR: motions without a start, and answers that are doubted."""

import sys

import numpy as np
import pytest

import registration
from registration import planar, se3
from registration.belief import believe
from registration.errors import MissingLibraryError
from registration.features import Doubt, FeatureSettings, most_common
from registration.libraries import load_open3d
from registration.methods import global_icp
from registration.types import MotionPrior, Status

try:
    load_open3d("a test")
except MissingLibraryError as error:
    pytest.skip(str(error), allow_module_level=True)
METHODS = ("fgr", "global-icp")


def car(n=3000, seed=0, noise=0.003):
    """Sample two dented sides of a car densely: something for features to see."""
    rng = np.random.default_rng(seed)
    x, y, z = rng.uniform(-2.0, 2.0, n), rng.uniform(-0.9, 0.9, n), rng.uniform(0.2, 1.4, n)
    on_side = (rng.random(n) < 0.7)[:, None]
    dent = 0.2 * np.sin(3.0 * x + 1.0) * np.cos(4.0 * z) + 0.1 * np.sin(7.0 * x)
    long_side = np.column_stack([x, -0.9 + dent, z])
    rear = np.column_stack([-2.0 + 0.2 * np.cos(3.0 * y) * np.sin(5.0 * z), y, z])
    return np.where(on_side, long_side, rear) + rng.normal(0.0, noise, (n, 3)) + [12.0, 5.0, 0.0]


@pytest.fixture(scope="module", params=METHODS)
def method(request):
    return registration.create(request.param)


@pytest.mark.parametrize("turn", [0.1, 1.2, -2.5])
def test_a_large_turn_is_found_without_a_start(method, turn):
    source = car()
    T = planar.to_transform(np.array([1.5, -0.8, turn]), source.mean(axis=0), z=0.1)
    result = method.register(source, se3.transform(T, car(seed=1)))
    assert result.status is Status.CONVERGED
    error = result.motion_about(source.mean(axis=0)) - [1.5, -0.8, turn]
    assert np.hypot(*error[:2]) < 0.1
    assert abs(planar.wrap(error[2])) < 0.05
    assert result.T_target_source[2, 2] == 1.0
    assert result.T_target_source[2, 3] == pytest.approx(0.1, abs=0.05)


def test_a_pairs_result_does_not_depend_on_the_pairs_before_it(method):
    clouds = method.prepare([car(600, seed) for seed in range(4)])
    pairs = [(clouds[0], clouds[1]), (clouds[2], clouds[3]), (clouds[1], clouds[3])]
    forth, back = method.align(pairs), method.align(pairs[::-1])[::-1]
    for a, b in zip(forth, back, strict=True):
        np.testing.assert_array_equal(a.T_target_source, b.T_target_source)


def test_poor_clouds_give_the_centroids_shift_or_something_near_it_never_a_leap(method):
    rng = np.random.default_rng(0)
    for n in (1, 2, 3, 4, 5, 8, 12, 20, 30):
        whole = car(200, seed=n)
        few = whole[rng.choice(len(whole), n, replace=False)] + [0.5, 0.0, 0.0]
        one_ring = few * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.7]
        for source, target in ((whole, few), (few, whole), (few, few), (one_ring, few), (one_ring, one_ring)):
            result = method.register(source, target)
            shift = target.mean(axis=0) - source.mean(axis=0)
            assert np.hypot(*(result.motion_about(result.source_centroid)[:2] - shift[:2])) < 3.0
            assert result.covariance[0, 0] > 0.01**2


def test_an_answer_that_does_not_explain_the_clouds_is_dropped_with_a_status(method):
    everything = registration.create(method.name, doubt=Doubt(near=1e9, far=1e9))
    nothing = registration.create(method.name, doubt=Doubt(near=1e-9, far=1e-9))
    source, target = car(), car(seed=1) + [0.5, 0.0, 0.0]
    believed, doubted = everything.register(source, target), nothing.register(source, target)
    assert believed.status is Status.CONVERGED
    assert doubted.status is Status.NO_OVERLAP
    shift = target.mean(axis=0) - source.mean(axis=0)
    np.testing.assert_allclose(doubted.T_target_source, se3.pose(np.eye(3), shift))
    assert np.trace(doubted.covariance[:2, :2]) > np.trace(believed.covariance[:2, :2])


def test_a_prior_stands_in_for_a_doubted_answer(method):
    nothing = registration.create(method.name, doubt=Doubt(near=1e-9, far=1e-9))
    prior = MotionPrior(np.array([0.5, 0.1, 0.2]), np.diag([0.1, 0.1, 0.1]) ** 2)
    result = nothing.register(car(), car(seed=1), prior)
    np.testing.assert_allclose(result.motion_about(result.source_centroid), prior.mean)
    np.testing.assert_allclose(result.covariance, prior.covariance, atol=1e-6)


def test_features_are_computed_once_per_cloud(method, monkeypatch):
    import open3d

    a, b, c = method.prepare([car(400, seed) for seed in range(3)])
    monkeypatch.setattr(open3d.pipelines.registration, "compute_fpfh_feature", None)  # whoever calls it fails
    assert len(method.align([(a, b), (b, c)])) == 2


@pytest.mark.parametrize("name", METHODS)
def test_without_open3d_creation_says_how_to_install_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingLibraryError, match=rf"{name} needs Open3D.*pip install 'regmot\[open3d\]'"):
        registration.create(name)


@pytest.mark.parametrize(
    ("name", "setting", "value"),
    [
        ("fgr", "division", 1.0),
        ("fgr", "max_tuples", 0),
        ("fgr", "max_distance", 0.0),
        ("global-icp", "n_samples", 1),
        ("global-icp", "confidence", 1.0),
        ("global-icp", "max_iterations", 0),
        ("global-icp", "max_distance", -1.0),
    ],
)
def test_settings_that_cannot_work_are_refused(name, setting, value):
    with pytest.raises(ValueError, match=setting):
        registration.create(name, **{setting: value})


def test_settings_of_features_and_doubt_that_cannot_work_are_refused():
    with pytest.raises(ValueError, match=r"features\.voxel"):
        FeatureSettings(voxel=0.0)
    with pytest.raises(ValueError, match=r"features\.sparse_neighbours"):
        FeatureSettings(sparse_neighbours=-1)
    with pytest.raises(ValueError, match=r"doubt\.far"):
        Doubt(far=0.0)


def test_the_most_common_lift_is_the_middle_of_the_fullest_window():
    assert most_common(np.array([-3.0, 0.11, 0.1, 0.09, 2.0, 2.3]), 0.05) == pytest.approx(0.1)
    assert most_common(np.array([]), 0.05) == 0.0


def test_many_planar_fits_at_once_are_those_of_align_pairs():
    rng = np.random.default_rng(0)
    source, target = rng.normal(size=(5, 4, 3)), rng.normal(size=(5, 4, 3))
    for motion, a, b in zip(global_icp.fit_planar(source, target), source, target, strict=True):
        T = planar.align_pairs(a, b)
        T[2, 3] = (b - a)[:, 2].mean()
        np.testing.assert_allclose(global_icp.to_transform(motion), T, atol=1e-12)


def test_edges_of_coincident_points_never_agree():
    same = np.zeros((1, 4, 3))
    assert not global_icp.edges_agree(same, same, 0.9).any()
    sample = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]]])
    assert global_icp.edges_agree(sample, 1.05 * sample, 0.9).all()
    assert not global_icp.edges_agree(sample, 1.2 * sample, 0.9).any()


def test_the_distance_from_a_belief_is_the_mahalanobis_distance():
    prior = MotionPrior(np.array([1.0, 0.0, np.pi]), np.diag([0.5, 0.1, 0.2]) ** 2)
    belief = believe(np.ones((3, 3)), np.zeros((2, 3)), prior, turn=0.1)
    other = planar.to_transform(np.array([2.0, 0.1, -np.pi + 0.4]), np.ones(3))
    assert belief.distance_to(other) == pytest.approx(2.0**2 + 1.0**2 + 2.0**2, rel=1e-5)
