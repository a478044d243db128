"""Annealed dynamic histograms: what the search finds, how sure it is, and the filter around it."""

import numpy as np
import pytest

import registration
from registration import se3
from registration.methods.adh import AnnealedHistograms2D, AnnealedHistograms3D, TunedHistograms3D
from registration.types import MotionPrior, Status
from tests.segments import car_cloud, estimate, moving_tracklet, segment, steps
from tracker.estimators import create_estimator
from tracker.estimators.adh import AdhEstimator, Motion
from tracker.smoothing import WindowMean
from tracker.types import EstimateStatus

NAMES = ("adh-2d", "adh-3d", "adh-3d-tuned")
FINEST = 1 / 27  # the cells of the last of four resolutions [m]


def car_at(range_m, n=450, seed=0, noise=0.02):
    return car_cloud(n, seed, noise) + [range_m, 3.0, 0.0]


def prior(x, y, sd):
    return MotionPrior(np.array([x, y, 0.0]), np.diag([sd, sd, 0.1]) ** 2)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_cloud_moved_is_found_to_one_of_the_finest_cells(name):
    cloud = car_at(15.0)
    for shift in ([0.4, -0.15, 0.0], [1.2, 0.15, 0.0], [-2.3, 1.1, 0.0]):
        result = registration.create(name).register(cloud, cloud + shift)
        assert np.hypot(*(result.T_target_source[:3, 3] - shift)[:2]) < FINEST
        assert result.status is Status.CONVERGED


@pytest.mark.parametrize("name", NAMES)
def test_a_fast_car_with_three_points_in_ten_missing_is_measured_to_a_tenth_of_a_metre_per_second(name):
    rng = np.random.default_rng(1)
    cloud = car_cloud(450, noise=0.0) + [15.0, 0.0, 0.0]
    for _ in range(5):
        looks = [cloud[rng.random(450) < 0.7], cloud[rng.random(450) < 0.7] + [1.2, 0.15, 0.0]]
        source, target = (look + rng.normal(0.0, 0.02, look.shape) for look in looks)
        velocity = registration.create(name).register(source, target).T_target_source[:2, 3] / 0.1
        assert velocity[0] == pytest.approx(12.0, abs=0.15)
        assert velocity[1] == pytest.approx(1.5, abs=0.15)


def test_the_answer_is_a_pure_horizontal_shift():
    cloud = car_at(12.0)
    T = registration.create("adh-3d").register(cloud, cloud + [0.3, 0.1, 0.0]).T_target_source
    np.testing.assert_array_equal(T[:3, :3], np.eye(3))
    assert T[2, 3] == 0.0


def test_source_and_target_may_change_places_and_only_the_sign_changes():
    method = AnnealedHistograms3D()
    whole = car_at(15.0)
    part = whole[whole[:, 0] > 14.0] + [0.5, 0.2, 0.0]
    assert len(part) < len(whole)
    same_range = [cloud.mean(axis=0)[:2] - [15.0, 0.0] for cloud in (whole, part)]
    a, b = method.prepare([whole, part], sensors=same_range)
    there, back = method.posteriors([(a, b), (b, a)])
    np.testing.assert_array_equal(there.mean, -back.mean)
    np.testing.assert_array_equal(there.covariance, back.covariance)
    np.testing.assert_allclose(there.mean, [0.5, 0.2], atol=FINEST)


@pytest.mark.parametrize(
    ("range_m", "n_levels"),
    # Rays are 2 tan(0.09 deg) = 0.00314 of the range apart; cells of 1, 1/3, 1/9, 1/27 m are divided while coarser.
    [(15.0, 4), (35.3, 4), (35.5, 3), (106.0, 3), (106.2, 2), (318.0, 2), (318.4, 1)],
)
def test_cells_get_as_fine_as_the_rays_are_dense(range_m, n_levels):
    method = AnnealedHistograms2D()
    near, far = car_at(15.0), car_at(15.0, seed=1)
    a, b = method.prepare([near, far], sensors=[np.zeros(2), far.mean(axis=0)[:2] - [range_m, 0.0]])
    assert method.align([(a, b)])[0].n_iterations == n_levels


def test_a_thinned_cloud_is_as_coarse_as_one_farther_away():
    method = AnnealedHistograms2D()
    a, b = method.prepare([car_at(15.0, 4000), car_at(15.0, 9000)], sensors=[np.array([-15.0, 0.0])] * 2)
    assert len(b.as_fixed) == 1800  # every 5th: 9000 / 2000, rounded up
    assert len(a.as_moved) == 149  # every 27th: 4000 / 150, rounded up
    assert method.align([(a, b)])[0].n_iterations == 2  # as at 150 m


def test_clouds_hardly_larger_than_the_limit_stay_whole():
    clouds = AnnealedHistograms2D().prepare([car_at(15.0, 187), car_at(15.0, 188)])
    assert [len(cloud.as_moved) for cloud in clouds] == [187, 94]


def test_the_range_is_that_of_the_centroid_from_the_sensor():
    method, car = AnnealedHistograms2D(), car_at(15.0)
    x, y = car.mean(axis=0)[:2]
    at_origin, told = method.prepare([car])[0], method.prepare([car], [np.array([x, y - 40.0])])[0]
    assert at_origin.range_m == pytest.approx(np.hypot(x, y))
    assert told.range_m == pytest.approx(40.0)
    with pytest.raises(ValueError, match="1 clouds but 2 sensors"):
        method.prepare([car], [np.zeros(2)] * 2)


def test_moving_both_clouds_together_changes_nothing():
    method = AnnealedHistograms3D()
    source, target = car_at(15.0), car_at(15.0, seed=1) + [0.4, 0.1, 0.0]
    away, sensor = np.array([300.0, -200.0, 5.0]), np.zeros(2)
    here = method.prepare([source, target], [sensor, sensor])
    far = method.prepare([source + away, target + away], [sensor + away[:2], sensor + away[:2]])
    a, b = method.posteriors([tuple(here), tuple(far)])
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-6)


def test_a_prior_decides_where_the_points_cannot():
    wall = np.column_stack([np.linspace(10.0, 20.0, 200), np.full(200, 5.0), np.tile([0.3, 0.8], 100)])
    piece = wall[80:120]  # may be anywhere along the wall
    method = AnnealedHistograms3D()
    alone, led = method.register(piece, wall), method.register(piece, wall, prior(1.3, 0.0, 0.05))
    assert alone.status is Status.NOT_CONVERGED
    assert alone.covariance[0, 0] > 100.0 * alone.covariance[1, 1]
    assert led.status is Status.CONVERGED
    assert led.T_target_source[0, 3] == pytest.approx(1.3, abs=0.05)
    assert led.T_target_source[1, 3] == pytest.approx(0.0, abs=0.05)


def test_a_wrong_prior_does_not_outvote_many_points():
    cloud = car_at(15.0)
    result = registration.create("adh-3d").register(cloud, cloud + [1.5, 0.0, 0.0], prior(-1.0, 0.5, 0.02))
    np.testing.assert_allclose(result.T_target_source[:2, 3], [1.5, 0.0], atol=FINEST)


def test_a_prior_may_be_certain():
    cloud = car_at(15.0)
    result = registration.create("adh-2d").register(cloud, cloud + [0.4, 0.0, 0.0], prior(0.4, 0.0, 0.0))
    np.testing.assert_allclose(result.T_target_source[:2, 3], [0.4, 0.0], atol=FINEST)


def test_pairs_and_priors_must_be_as_many():
    method = AnnealedHistograms2D()
    a, b = method.prepare([car_at(15.0), car_at(15.0)])
    with pytest.raises(ValueError, match="1 pairs but 2 priors"):
        method.align([(a, b)], [None, None])


@pytest.mark.parametrize("name", NAMES)
def test_single_points_are_laid_on_each_other_but_not_trusted_to_the_centimetre(name):
    point = np.array([[20.0, 3.0, 0.5]])
    result = registration.create(name).register(point, point + [0.7, 0.0, 0.0])
    np.testing.assert_allclose(result.T_target_source[:2, 3], [0.7, 0.0], atol=0.02)
    assert np.sqrt(result.covariance[0, 0]) > 0.02


def test_an_empty_cloud_among_others_says_so_and_harms_nobody():
    method = AnnealedHistograms2D()
    a, b, nothing = method.prepare([car_at(15.0), car_at(15.0) + [0.3, 0.0, 0.0], np.empty((0, 3))])
    results = method.align([(a, nothing), (a, b), (nothing, b), (nothing, nothing)])
    assert [r.status for r in results] == [Status.TOO_FEW_POINTS, Status.CONVERGED] + 2 * [Status.TOO_FEW_POINTS]
    assert results[1].T_target_source[0, 3] == pytest.approx(0.3, abs=FINEST)


@pytest.mark.parametrize("name", NAMES)
def test_a_stray_point_kilometres_away_costs_neither_memory_nor_the_answer(name):
    cloud = car_at(15.0)
    stray = np.vstack([cloud, [[9000.0, -7000.0, 300.0]]])
    result = registration.create(name).register(cloud, stray + [0.3, 0.0, 0.0])
    assert np.hypot(*result.T_target_source[:2, 3]) < 60.0
    assert np.isfinite(result.covariance).all()


def test_the_same_input_gives_the_same_bits():
    source, target = car_at(15.0), car_at(15.0, seed=1) + [0.4, 0.1, 0.0]
    first, second = (registration.create("adh-3d-tuned").register(source, target) for _ in range(2))
    np.testing.assert_array_equal(first.T_target_source, second.T_target_source)
    np.testing.assert_array_equal(first.covariance, second.covariance)


def test_two_samples_of_one_surface_agree_within_the_covariance():
    for name in ("adh-2d", "adh-3d"):
        errors = []
        for seed in range(20):
            result = registration.create(name).register(
                car_at(15.0, 300, seed), car_at(15.0, 300, seed + 50) + [0.3, 0.1, 0.0]
            )
            error = result.T_target_source[:2, 3] - [0.3, 0.1]
            errors.append(error @ np.linalg.solve(result.covariance[:2, :2], error))
        assert np.mean(errors) < 3.0  # 2 is honest; clean clouds leave it below


@pytest.mark.parametrize(
    ("setting", "value"), [("coarsest", 0.0), ("finest", -1.0), ("floor", 0.0), ("reduction", 1), ("max_moved", 0)]
)
def test_settings_that_cannot_work_are_refused(setting, value):
    with pytest.raises(ValueError, match=setting):
        registration.create("adh-2d", **{setting: value})


def test_the_tuned_preset_differs_in_its_settings_only():
    tuned = TunedHistograms3D()
    assert isinstance(tuned, AnnealedHistograms3D)
    assert (tuned.finest, tuned.reduction, tuned.max_moved, tuned.acceleration_variance) == (0.02, 4, 600, 1.0)
    assert AnnealedHistograms3D().acceleration_variance == 10.0


def test_the_expected_shift_carries_the_last_ones_uncertainty_too():
    motion = Motion(np.array([3.0, -1.0]), 0.25 * np.eye(2), 0.0025 * np.eye(2))
    expected = motion.expect(0.2, acceleration_variance=10.0)
    np.testing.assert_allclose(expected.mean, [3.0 * 0.2, -1.0 * 0.2, 0.0])
    # what the last shift was off by, and a velocity off by 0.25 plus what may have changed since, over 0.2 s
    np.testing.assert_allclose(expected.covariance[:2, :2], (0.0025 + (0.25 + 10.0 * 0.2**2) * 0.2**2) * np.eye(2))


@pytest.mark.parametrize("name", NAMES)
def test_the_estimator_gives_ground_velocity_whatever_the_ego_does(name):
    tracklet = moving_tracklet((8.0, 1.0), ego_velocity=(10.0, 0.0), cloud=car_cloud(300))
    estimates = steps(create_estimator(name), tracklet)
    assert estimates[0].status is EstimateStatus.NEW_TRACK
    for found in estimates[1:]:
        np.testing.assert_allclose(found.velocity, [8.0, 1.0], atol=FINEST / 0.1)
        assert found.frame_name == "world"
        assert np.isnan(found.yaw_rate)


def test_the_rays_are_as_dense_as_at_the_sensors_distance_wherever_the_world_begins():
    parked = moving_tracklet((0.0, 0.0), n_frames=2, start=(40.0, 0.0))
    found = []
    for away in (0.0, 5000.0):
        estimator = create_estimator("adh-3d")
        pose = se3.from_yaw(0.0, np.array([away, 0.0, 0.0]))
        found.append([estimator.step({7: s}, s.timestamp, pose)[7] for s in parked.segments][-1])
    np.testing.assert_allclose(found[0].covariance, found[1].covariance, rtol=1e-3)
    np.testing.assert_allclose(found[0].velocity, found[1].velocity, atol=1e-3)


def test_the_first_alignment_expects_nothing_and_the_next_what_it_found():
    seen = []

    class Listening(AnnealedHistograms2D):
        def posteriors(self, pairs, priors=None):
            seen.extend(priors)
            return super().posteriors(pairs, priors)

    steps(AdhEstimator(Listening()), moving_tracklet((3.0, 1.0), n_frames=4))
    assert seen[0] is None
    for expected in seen[1:]:
        np.testing.assert_allclose(expected.mean[:2], [0.3, 0.1], atol=FINEST)


def test_a_frame_without_points_keeps_the_motion_and_the_time():
    tracklet = moving_tracklet((3.0, 1.0), n_frames=5)
    segments = list(tracklet.segments)
    segments[2] = segment(np.empty((0, 3)), 2)
    estimator = create_estimator("adh-2d")
    found = [estimator.step({7: s}, s.timestamp, None)[7] for s in segments]
    assert found[2].status is EstimateStatus.NO_POINTS
    np.testing.assert_array_equal(found[2].velocity, found[1].velocity)
    assert found[3].status is EstimateStatus.CONVERGED
    np.testing.assert_allclose(found[3].velocity, [3.0, 1.0], atol=0.2)  # over 0.2 s


def test_no_step_is_shorter_than_a_hundredth_of_a_second():
    cloud = car_cloud() + [12.0, 0.0, 0.0]
    estimator = create_estimator("adh-2d")
    estimator.step({7: segment(cloud, 0, dt=0.0)}, 0.0, None)
    found = estimator.step({7: segment(cloud + [0.1, 0.0, 0.0], 1, dt=0.001)}, 0.001, None)[7]
    assert found.velocity[0] == pytest.approx(0.1 / 0.01, abs=FINEST / 0.01)


def test_a_track_that_is_gone_starts_afresh():
    tracklet = moving_tracklet((3.0, 1.0), n_frames=3)
    estimator = create_estimator("adh-2d")
    first = tracklet.segments[0]
    estimator.step({7: first}, 0.0, None)
    estimator.step({}, 0.1, None)
    assert estimator.step({7: tracklet.segments[2]}, 0.2, None)[7].status is EstimateStatus.NEW_TRACK


def test_its_output_is_smoothed_as_a_filters_whose_neighbours_share_their_errors():
    estimator = AdhEstimator(AnnealedHistograms2D(), WindowMean(1))
    smoothed = estimator.smoothed([estimate(k, v, variance=0.3) for k, v in enumerate([(1, 0), (2, 0), (6, 0)])])
    np.testing.assert_allclose(smoothed[1].velocity, [3.0, 0.0])
    np.testing.assert_allclose(smoothed[1].covariance, 0.3 * np.eye(2))
