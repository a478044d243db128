"""The fused estimator: where its evidence comes from, parked objects, hindsight, and what upsets it."""

from dataclasses import replace

import numpy as np
import pytest

from registration import planar, se3
from tests.looks import encoded, kept, laid_on, seen
from tests.segments import car_cloud, moving_tracklet, segment, steps
from tests.windows import Window
from tracker.estimators import create_estimator, create_smoothing
from tracker.estimators.contract import look
from tracker.estimators.fused import FusedEstimator, FusedSettings, claims, parked, scene, source_kernels, speed_kernels
from tracker.estimators.fused.sources import Learned, Shape
from tracker.types import EstimateStatus


def believed(information, doubt, scale):
    found = np.empty((2, 2))
    share = claims.believe(information[None], doubt[None], 0, scale, 2, found)
    return found, share


def test_claims_are_scaled_and_doubt_adds_to_them():
    covariance, doubt, scale = np.array([[0.04, 0.01], [0.01, 0.02]]), np.array([[0.09, -0.02], [-0.02, 0.01]]), 0.5
    found, share = believed(np.linalg.inv(covariance), doubt, scale)
    np.testing.assert_allclose(np.linalg.inv(found), scale * covariance + doubt)
    own = scale * covariance
    assert share == pytest.approx(0.5 * np.trace(own @ np.linalg.inv(own + doubt)))
    half_known, _ = believed(np.diag([4.0, 0.0]), 0.25 * np.eye(2), 1.0)
    np.testing.assert_allclose(half_known, np.diag([2.0, 0.0]))
    assert believed(np.zeros((2, 2)), 0.25 * np.eye(2), 1.0)[1] == 0.0


def test_shapes_tell_how_far_and_how_much_an_object_has_moved():
    cloud = car_cloud(400) + [15.0, 4.0, 0.0]
    place = cloud.mean(axis=0)[:2]
    moved = se3.transform(planar.to_transform(np.array([0.8, 0.1, 0.02]), np.array([*place, 0.0])), cloud)
    earlier, newer = kept(cloud, encoded(cloud)), kept(moved, encoded(moved))
    found = Shape().compare(laid_on(earlier, newer, place, [0.7, 0.1], 0.3, 0.05), [newer])
    np.testing.assert_allclose(found.steps, [[0.8, 0.1]], atol=0.02)
    assert found.turns[0] == pytest.approx(0.02, abs=0.01)
    assert np.linalg.eigvalsh(found.informations[0]).min() >= 0.0


def test_dense_clouds_tell_more_but_not_without_end():
    cloud = car_cloud(600) + [10.0, 3.0, 0.0]
    look_of_all, place = kept(cloud, encoded(cloud)), cloud.mean(axis=0)[:2]
    told = []
    for n in (300, 1000, 3000, 30000):
        look_of_n = look_of_all._replace(n_points=n)
        found = Shape().compare(laid_on(look_of_n, look_of_n, place, [0.0, 0.0], 0.1, 0.02), [look_of_n])
        told.append(np.linalg.eigvalsh(found.informations[0]).min())
    assert told[0] < 0.7 * told[1] < 0.49 * told[2]
    assert told[3] == pytest.approx(told[2])


def test_where_histograms_only_choose_between_two_places_the_outline_of_a_gap_is_no_evidence():
    """A car passes behind a gap; the network contradicts, and what is seen of its side fits itself best unmoved."""
    rng = np.random.default_rng(4)
    looks = [
        np.column_stack([rng.uniform(-1.0, 1.0, 150), np.zeros(150), rng.uniform(0.0, 1.4, 150)]) for _ in range(2)
    ]
    earlier, later = (cloud + rng.normal(0.0, 0.015, cloud.shape) + [30.0, 5.0, -1.5] for cloud in looks)
    before, now, place = kept(earlier, encoded(earlier)), kept(later, encoded(later)), earlier.mean(axis=0)[:2]
    for contrary in (np.zeros((2, 2)), np.diag([0.4**2, 0.0])):
        (information,) = (
            Shape().compare(laid_on(before, now, place, [0.4, 0.0], 0.1, 0.01, contrary), [now]).informations
        )
        assert information[0, 0] < 0.09**-2
        assert information[1, 1] > 0.05**-2


def test_many_comparisons_with_a_look_of_few_points_are_hardly_worth_more_than_one():
    estimator, told = FusedEstimator(), {}
    for k in range(6):
        cloud = car_cloud(300, seed=k) + [14.0 + 0.4 * k, 4.0, -1.7]
        estimator.step({7: segment(cloud[:3] if k == 0 else cloud, k)}, 0.1 * k, np.eye(4))
        for comparison in Window(estimator._known.places, estimator._tracks[7].row).comparisons:
            if comparison.older == 0:
                row = comparison.measured
                information, doubt = row[4:].reshape(2, 2, 2)
                told[comparison.newer, row.tobytes()], _ = believed(information, doubt, 1.0)
    information = [np.linalg.eigvalsh(told[key])[-1] for key in told]
    assert len(information) >= 4  # by histograms; the network does not know what three points are
    assert sum(information) < 3.0 * max(information)


def test_shapes_are_believed_less_the_farther_an_object_moved():
    """Standing beside the sensor, a car is known as well with that doubt as without; driving, it is not."""
    found = {}
    for speed in (0.0, 15.0):
        for share in (0.0, 0.002):
            settings = FusedSettings(shape_moved=share, shape_turned=0.0, learned_turned=0.0)
            estimator = FusedEstimator(settings=settings)
            for k in range(8):
                one = segment(car_cloud(800, seed=k) + [10.0 - 0.1 * speed * k, 4.0, 0.0], k)
                answer = estimator.step({one.track_id: one}, one.timestamp, None)[one.track_id]
            found[speed, share] = np.trace(answer.covariance)
    np.testing.assert_allclose(found[0.0, 0.002], found[0.0, 0.0], rtol=0.05)
    assert found[15.0, 0.002] > 1.3 * found[15.0, 0.0]


def test_comparisons_are_believed_less_where_other_sides_are_seen():
    """Along the way of a car that passes at 4 m; one that comes from afar at the same speed shows the same side."""
    ratios = []
    for x in (10.0, 40.0):
        found = []
        for turned in (0.0, 1.0):
            settings = FusedSettings(shape_moved=0.0, shape_turned=0.01 * turned, learned_turned=0.2 * turned)
            estimator = FusedEstimator(settings=settings)
            for k in range(8):
                one = segment(car_cloud(800, seed=k) + [x - 1.5 * k, 4.0, 0.0], k)
                answer = estimator.step({one.track_id: one}, one.timestamp, None)[one.track_id]
            found.append(np.trace(answer.covariance))
        ratios.append(found[1] / found[0])
    assert ratios[0] > 1.3
    assert ratios[1] < 1.1


def test_persons_are_shown_to_the_network_for_persons():
    person = np.random.default_rng(0).uniform([9.8, -0.2, -1.6], [10.2, 0.2, 0.1], (60, 3))
    learned = Learned()
    looks = [look(replace(segment(person, 1), class_name=name), None) for name in ("Car", "Cyclist", "Pedestrian")]
    car, cyclist, pedestrian = learned.encode(looks)
    assert car.network.name == "alignnet"
    assert cyclist.network is pedestrian.network
    assert pedestrian.network.name == "alignnet-persons"
    a, b, c = (kept(person, encoding) for encoding in (car, cyclist, pedestrian))
    found = learned.ask([(a, b), (b, c)], np.tile(person.mean(axis=0)[:2], (2, 1)))
    assert np.isinf(found.turn_variances[0])
    assert not found.informations[0].any()
    np.testing.assert_allclose(found.steps[1], 0.0, atol=0.1)
    assert np.linalg.eigvalsh(found.informations[1]).min() > 0.0


def test_an_object_that_nobody_is_sure_of_moves_as_those_that_stand():
    places = np.array([[10.0, 5.0], [20.0, -8.0], [30.0, 12.0], [40.0, 0.0], [25.0, 3.0]])
    standing = np.array([-8.0, 0.5]) + 0.2 * np.column_stack([-places[:, 1], places[:, 0]])  # the ego drives and turns
    velocities = standing.copy()
    velocities[3] += [1.5, -1.0]  # an error, of a cloud that nobody is sure of
    velocities[4] += [6.0, 0.0]  # a car that drives
    sds = [0.05, 0.05, 0.05, 1.5, 0.05]
    settled, _ = scene.settle(seen(list(zip(places, velocities, sds, strict=True)), n=4), scene.UNKNOWN)
    found, covariances = settled.velocities.reshape(5, 4, 2), settled.covariances.reshape(5, 4, 2, 2)
    for k in range(4):
        np.testing.assert_allclose(found[k], np.tile(standing[k], (4, 1)), atol=0.3 if k == 3 else 0.05)
    np.testing.assert_allclose(found[4, -1], velocities[4], atol=0.02)
    assert np.trace(covariances[3, -1]) < 0.5 * 2 * 1.5**2


def test_an_object_alone_stays_nearly_as_it_is_and_two_that_differ_nearly_so():
    alone, _ = scene.settle(seen([([10.0, 0.0], [3.0, 1.0], 0.2)], n=4), scene.UNKNOWN)
    np.testing.assert_allclose(alone.velocities[-1], [3.0, 1.0], atol=1e-3)
    both = [([10.0, 0.0], [3.0, 1.0], 0.1), ([12.0, 1.0], [-9.0, 2.0], 0.1)]
    two, _ = scene.settle(seen(both, n=4), scene.UNKNOWN)
    np.testing.assert_allclose(two.velocities[3], [3.0, 1.0], atol=0.1)


def test_steps_over_a_frame_without_points_are_not_weighed():
    both = seen([([10.0, 0.0], [3.0, 1.0], 0.2), ([12.0, 1.0], [3.1, 1.0], 0.2)], n=4)
    numbers, lengths = np.array([0, 1, 3, 4, *both.numbers[4:]]), np.array([1, 1, 2, 1, *both.lengths[4:]])
    settled, _ = scene.settle(both._replace(numbers=numbers, lengths=lengths), scene.UNKNOWN)
    np.testing.assert_array_equal(settled.velocities[2], both.velocities[2])
    assert settled.velocities[3, 0] > both.velocities[3, 0]


def test_a_mixture_is_as_unsure_as_its_parts_differ():
    own, share = seen([([10.0, 0.0], [2.0, 0.0], 0.1)], n=1), np.array([0.5])
    steps_ = own.velocities, own.covariances, own.doubts
    (velocity,), (covariance,), _ = speed_kernels.halted(own.owners, share, parked.STANDING_SD**2, *steps_)
    np.testing.assert_allclose(velocity, [1.0, 0.0])
    assert covariance[0, 0] > 1.0
    assert covariance[1, 1] < 0.01


@pytest.mark.parametrize("velocity", [(-3.0, 1.0), (0.0, 0.0)])
def test_a_car_is_followed_and_its_velocity_gets_precise(velocity):
    """One that comes nearer, or stands: poses shake what is far more, so that one that leaves gets less sure."""
    estimates = steps(create_estimator("fused"), moving_tracklet(velocity, n_frames=12, ego_velocity=(0.0, 0.0)))
    assert estimates[0].status is EstimateStatus.NEW_TRACK
    assert all(estimate.status is EstimateStatus.CONVERGED for estimate in estimates[1:])
    np.testing.assert_allclose(estimates[-1].velocity, velocity, atol=0.05)
    assert np.trace(estimates[-1].covariance) < np.trace(estimates[1].covariance)


def test_a_turning_ego_is_seen_through_in_its_own_axes():
    tracklet = moving_tracklet((0.0, 0.0), n_frames=14, start=(25.0, 8.0), ego_velocity=(8.0, 0.0))  # 0.5 rad/s
    estimator = create_estimator("fused")
    last = [estimator.step({7: s}, s.timestamp, None)[7] for s in tracklet.segments][-1]
    before, after = (se3.transform(se3.invert(T), np.array([[25.0, 8.0, 0.0]]))[0] for T in tracklet.T_world_lidar[-2:])
    np.testing.assert_allclose(last.velocity, (after - before)[:2] / 0.1, atol=0.25)
    assert np.hypot(*last.velocity) > 8.0


def test_hindsight_is_what_fixed_lag_and_rts_read():
    tracklet = moving_tracklet((4.0, 0.0), n_frames=6)
    estimates = steps(create_estimator("fused"), tracklet)
    assert [word.frame for word in estimates[-1].hindsight] == [4, 3, 2, 1]
    lag1 = create_estimator("fused", create_smoothing("lag1")).smoothed(estimates)
    rts = create_estimator("fused", create_smoothing("rts")).smoothed(estimates)
    np.testing.assert_array_equal(lag1[2].velocity, estimates[3].hindsight[0].velocity)
    np.testing.assert_array_equal(rts[2].velocity, estimates[5].hindsight[2].velocity)
    np.testing.assert_array_equal(lag1[-1].velocity, estimates[-1].velocity)


def test_a_frame_without_points_is_bridged():
    tracklet = moving_tracklet((5.0, 0.0), n_frames=8)
    gone = replace(tracklet.segments[5], points_lidar=np.empty((0, 3)))
    segments = [*tracklet.segments[:5], gone, *tracklet.segments[6:]]
    estimator = create_estimator("fused")
    estimates = [estimator.step({7: s}, s.timestamp, None)[7] for s in segments]
    assert estimates[5].status is EstimateStatus.NO_POINTS
    np.testing.assert_allclose(estimates[-1].velocity, [5.0, 0.0], atol=0.2)


def test_a_cloud_of_one_point_is_no_certainty():
    estimator = create_estimator("fused")
    for k in range(3):
        estimate = estimator.step({7: segment([[20.0 + 0.1 * k, 1.0, -1.0]], k)}, 0.1 * k, None)[7]
    assert np.isfinite(estimate.velocity).all()
    assert np.linalg.eigvalsh(estimate.covariance).min() > 0.5**2


def test_what_is_right_at_the_sensor_is_no_division_by_zero():
    """As a rod on the roof: the range of its middle is 0, so that no points would be left of it, seen from 1 m."""
    estimator = create_estimator("fused")
    cloud = car_cloud(40) * 0.2
    cloud -= 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    for k in range(5):
        estimate = estimator.step({7: segment(cloud, k)}, 0.1 * k, None)[7]
    assert estimate.range_m == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(estimate.velocity, 0.0, atol=0.1)
    assert np.linalg.eigvalsh(estimate.covariance).min() > 0.0


def test_claims_of_real_scans_are_not_those_that_simulated_ones_keep():
    """All of an object's errors are claimed where scans are real; the share of it that simulated ones show, there."""
    variances = {}
    for is_simulated in (False, True):
        estimator, settings = create_estimator("fused"), FusedSettings()
        for s in moving_tracklet((8.0, 0.0), n_frames=6, ego_velocity=(0.0, 0.0)).segments:
            estimate = estimator.step({7: replace(s, is_simulated=is_simulated)}, s.timestamp, None)[7]
        variances[is_simulated] = np.trace(estimate.covariance)
    assert settings.simulated_share < 0.8 * settings.covariance_share
    assert variances[True] < 0.8 * variances[False]


def test_many_objects_at_once_give_what_each_gives_alone_in_the_world():
    a = moving_tracklet((3.0, 1.0), n_frames=5, ego_velocity=(2.0, 0.0))
    b = moving_tracklet((-2.0, 0.0), n_frames=5, start=(18.0, -4.0), cloud=car_cloud(seed=3), ego_velocity=(2.0, 0.0))
    together, alone = create_estimator("fused"), create_estimator("fused")
    for s, t, T in zip(a.segments, b.segments, a.T_world_lidar, strict=True):
        both = together.step({7: s, 8: replace(t, track_id=8)}, s.timestamp, T)
        one = alone.step({7: s}, s.timestamp, T)
        np.testing.assert_allclose(both[7].velocity, one[7].velocity, atol=1e-3)


def test_what_was_expected_is_no_evidence_and_what_nothing_else_told_of_is_not_measured():
    """Against NumPy: informations less those expected, without directions that have next to none of it."""
    rng, n, least = np.random.default_rng(0), 40, 0.3
    roots, own = rng.normal(size=(2, n, 2, 2)), rng.uniform(0.2, 3.0, (n, 1, 1))
    covariances = roots[0] @ roots[0].transpose(0, 2, 1) + 0.01 * np.eye(2)
    priors = own * covariances + roots[1] @ roots[1].transpose(0, 2, 1)
    is_told, is_expected = np.arange(n) % 5 > 0, np.arange(n) % 3 > 0
    known = np.column_stack([covariances.reshape(n, 4)[:, [0, 1, 3]], np.ones(n)])
    shifts, steps, turns = rng.normal(size=(n, 2)), rng.normal(size=(n, 2)), rng.uniform(-3.0, 3.0, n)
    before, found = steps.copy(), np.full((n, 2, 2), np.nan)
    expected, shares = (shifts, priors, turns.copy(), is_expected), (0.3, 0.1, 400.0, 3000.0, 0.6, least)
    seen = np.full(n, 800)
    source_kernels.weigh(known, expected, is_told, np.arange(n) % 2 > 0, seen, shares, (steps, turns, found))
    n_partly = 0
    for k in range(n):
        left = np.linalg.inv(covariances[k])
        smallest = least * np.trace(left)
        if is_expected[k]:
            values, axes = np.linalg.eigh(left - np.linalg.inv(priors[k]))
            n_partly += is_told[k] and (values > smallest).sum() == 1
            left = (axes * np.where(values > smallest, values, 0.0)) @ axes.T
        share = 0.3 if k % 2 else 0.1 * 0.5**0.6
        np.testing.assert_allclose(found[k], is_told[k] * left / share, rtol=1e-9, atol=1e-9)
    assert n_partly > 3
    np.testing.assert_allclose(steps, is_told[:, None] * (before + shifts))
    np.testing.assert_allclose(np.cos(turns), np.cos(2.0 * expected[2]))
