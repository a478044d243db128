"""How fast objects may be, which all of a frame share: mixtures, shares that others tell, flows, what slips."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tests.looks import seen
from tracker.estimators.fused import scene, speeds
from tracker.estimators.fused.step_kernels import SLIP_SD, slips

SDS = np.array([0.15, *(sd for _, sd in speeds.MOVING)])


def measured(means, sds, slips=(0.0, 0.0)):
    """Put velocities of objects side by side, one step each."""
    means = np.asarray(means, dtype=np.float64)[:, None]
    covariances = np.array([[sd**2 * np.eye(2)] for sd in sds])
    return speeds.Velocities(means, covariances, np.ones((len(means), 1), np.bool_), np.tile(slips, (len(means), 1, 1)))


def nowhere(velocities):
    return np.zeros_like(velocities.means), np.zeros_like(velocities.covariances)


def test_a_mixture_is_that_of_bayes_theorem():
    """Against sums over a fine grid of velocities."""
    own = measured([[3.0, -1.0], [4.0, 0.5]], [1.2, 0.7], slips=(0.2, 9.0))
    shares = np.tile([[0.6], [0.4]], 2)
    expected = np.array([[[0.5, 0.0]], [[0.0, 0.0]]]), np.tile(0.3 * np.eye(2), (2, 1, 1, 1))
    moving = np.array([0.5, 0.8])
    means, covariances, _ = speeds.mixed(own, expected, np.array([0.5, 3.0]), shares, moving)
    x = np.linspace(-25.0, 25.0, 401)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    flow = speeds.FLOW_SHARE * moving[1]
    beside = own.covariances[1, 0] + (speeds.FLOW_SD**2 + 0.2 * 9.0) * np.eye(2)
    before = flow * multivariate_normal(own.means[1, 0], beside).pdf(grid)
    for share, sd in ((0.6, 0.5), (0.4, 3.0)):
        before += (1.0 - flow) * share * multivariate_normal([0.5, 0.0], (0.3 + sd**2) * np.eye(2)).pdf(grid)
    told = 0.8 * multivariate_normal([3.0, -1.0], 1.2**2 * np.eye(2)).pdf(grid)
    told += 0.2 * multivariate_normal([3.0, -1.0], (1.2**2 + 9.0) * np.eye(2)).pdf(grid)
    weights = before * told / np.sum(before * told)
    mean = np.einsum("ij,ijk->k", weights, grid)
    np.testing.assert_allclose(means[0, 0], mean, atol=1e-3)
    off = grid - mean
    np.testing.assert_allclose(covariances[0, 0], np.einsum("ij,ijk,ijl->kl", weights, off, off), atol=1e-2)


def test_what_is_not_known_stays_as_it_is():
    own = measured([[3.0, -1.0], [4.0, 0.5]], [1.2, 0.7])
    own.is_known[0] = False
    shares = np.tile(speeds.SHARES[:, None], 2)
    means, covariances, gains = speeds.mixed(own, nowhere(own), SDS, shares, np.array([0.0, 0.5]))
    np.testing.assert_array_equal(means[0], own.means[0])
    np.testing.assert_array_equal(covariances[0], own.covariances[0])
    assert gains[0] == 1.0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("other", [0.0, 3000.0])
def test_a_velocity_far_off_everything_is_no_division_by_zero(other):
    own = measured([[3000.0, 0.0], [other, 0.0]], [0.01, 0.01])
    means, covariances, gains = speeds.mixed(own, nowhere(own), SDS, np.tile(speeds.SHARES[:, None], 2), np.ones(2))
    np.testing.assert_allclose(means[0, 0], [3000.0, 0.0], atol=1e-3)
    assert np.isfinite(covariances).all()
    assert np.isfinite(gains).all()


def test_where_all_others_drive_a_newcomer_is_less_likely_to_stand():
    standing = np.log(np.array([[0.9], [0.025], [0.025], [0.025], [0.025]]))
    driving = np.log(np.array([[1e-9], [1e-9], [1e-3], [0.9], [0.1]]))
    shares = {
        name: speeds.learned(np.hstack([standing, *[others] * 8]))[0, 0]
        for name, others in (("drive", driving), ("stand", standing))
    }
    assert shares["drive"] < 0.5 * speeds.STANDING
    assert shares["stand"] > speeds.STANDING
    assert speeds.learned(standing)[0, 0] == pytest.approx(speeds.STANDING)  # nobody else in sight


def test_a_newcomer_moves_as_another_one_does_rather_than_in_between():
    own = measured([[18.0, 3.0], [20.0, 0.0], [20.5, 0.1]], [4.0, 0.1, 0.1])
    shares = np.tile(speeds.SHARES[:, None], 3)
    alone, _, _ = speeds.mixed(own, nowhere(own), SDS, shares, np.zeros(3))
    means, _, gains = speeds.mixed(own, nowhere(own), SDS, shares, np.ones(3))
    assert np.hypot(*(means[0, 0] - [20.0, 0.0])) < 0.5 * np.hypot(*(alone[0, 0] - [20.0, 0.0]))
    assert gains[0] > 2.0
    np.testing.assert_allclose(means[1, 0], [20.0, 0.0], atol=0.02)


def test_few_points_that_contradict_what_others_do_make_unsure():
    """A parked car of a few points, laid on the wrong part: 15 m/s, it seems."""
    places = [[10.0, 5.0], [20.0, -8.0], [30.0, 12.0], [25.0, 3.0]]
    others, slips = [(place, [-8.0, 0.5], 0.05) for place in places], ((0.0, 0.0), (0.1, 12.0**2))
    wrong = [seen([*others, ([35.0, 0.0], [7.0, 0.5], 3.0, slip)]) for slip in slips]
    (bold, unsure) = (scene.settle(steps, scene.UNKNOWN)[0] for steps in wrong)
    error = {name: steps.velocities[-1] - [-8.0, 0.5] for name, steps in (("bold", bold), ("unsure", unsure))}
    nees = {
        name: error[name] @ np.linalg.solve(steps.covariances[-1], error[name])
        for name, steps in (("bold", bold), ("unsure", unsure))
    }
    assert nees["unsure"] < 6.0 < nees["bold"]
    assert np.hypot(*error["unsure"]) < np.hypot(*error["bold"])


def test_clouds_slip_where_points_are_few_and_the_best_step_stands_for_the_others_up_to_a_gap():
    n_points, seconds = np.array([3.0, 4.0, 2.0, 100.0, 100.0]), np.array([0.1, 0.1, 1.6, 0.1, 0.1])
    found = slips(np.zeros(5, dtype=np.int64), np.array([1, 1, 16, 1, 1]), n_points, seconds)
    np.testing.assert_allclose(found[:2], [[1.0 / 5.0**2, (SLIP_SD / 0.2) ** 2]] * 2)
    np.testing.assert_allclose(found[2], [1.0 / 3.0**2, (SLIP_SD / 1.6) ** 2])
    assert (found[3:, 0] < 1e-4).all()


def test_what_stands_goes_on_as_before():
    """One vague object alone: the ego's motion a moment ago says how it moves, if it stands."""
    places = [[10.0, 5.0], [20.0, -8.0], [30.0, 12.0]]
    _, common = scene.settle(seen([(place, [-8.0, 0.5], 0.05) for place in places]), scene.UNKNOWN)
    np.testing.assert_allclose(common.mean, [-8.0, 0.5, 0.0], atol=0.05)
    vague = seen([([25.0, 0.0], [-7.0, 2.0], 2.0)])
    now, _ = scene.settle(vague, common.later(0.1))
    assert np.hypot(*(now.velocities[-1] - [-8.0, 0.5])) < 0.7
    much_later, _ = scene.settle(vague, common.later(1000.0))
    assert np.hypot(*(much_later.velocities[-1] - [-7.0, 2.0])) < 0.5


def test_what_was_taken_to_stand_is_given_up_when_more_contradict():
    """Two cars that drive side by side were all that could be seen; then what really stands comes into view."""
    platoon = [(place, [-1.0, 0.0], 0.05) for place in ([12.0, 2.0], [20.0, -2.0])]
    _, common = scene.settle(seen(platoon), scene.UNKNOWN)
    np.testing.assert_allclose(common.mean[:2], [-1.0, 0.0], atol=0.1)
    parked = [(place, [-14.0, 0.0], 0.05) for place in ([15.0, 8.0], [25.0, -8.0], [30.0, 8.0], [35.0, -8.0])]
    vague = ([40.0, 8.0], [-12.0, 1.0], 2.0)
    settled, common = scene.settle(seen([*platoon, *parked, vague]), common.later(0.1))
    latest = settled.velocities[settled.ends - 1]
    assert np.hypot(*(latest[-1] - [-14.0, 0.0])) < 0.5
    np.testing.assert_allclose(latest[0], [-1.0, 0.0], atol=0.1)
