"""Losses are what the paper says, and errors what the evaluation counts."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from evaluation.registration_error import pair_error
from registration import planar
from registration.alignnet import loss
from registration.alignnet.loss import LossSettings, Truth
from registration.alignnet.network import Motion
from tests import learned

N_BINS = 50


def outputs(bins, residual=0.0, sureness=20.0):
    made = torch.zeros(len(bins), 2 * N_BINS)
    made[torch.arange(len(bins)), bins] = sureness
    made[torch.arange(len(bins)), N_BINS + torch.as_tensor(bins)] = residual
    return made


def motion(n=6, seed=0):
    rng = torch.Generator().manual_seed(seed)
    shift = torch.rand(n, 3, generator=rng) * torch.tensor([1.0, 1.0, 0.0])
    center = torch.rand(n, 3, generator=rng) - 0.5
    turn = 6.0 * torch.rand(n, generator=rng) - 3.0
    heading = torch.rand(n, generator=rng)
    return Motion(center, center + shift, turn, turn, torch.zeros(n, 2 * N_BINS), heading, torch.zeros(n, 6))


def truths(n=6, seed=1):
    rng = torch.Generator().manual_seed(seed)
    return tuple(Truth(torch.rand(n, 3, generator=rng), 6.0 * torch.rand(n, generator=rng) - 3.0) for _ in range(2))


@pytest.mark.parametrize("heading_axis", [False, True])
def test_errors_are_those_of_the_evaluation(heading_axis):
    found, (source, target) = motion(), truths()
    shift = loss.displacement_error(found, source, target, heading_axis)[:, :2].norm(dim=1)
    turn = loss.motion_error(found, source, target, heading_axis)[:, 2].abs()
    for k in range(6):
        flat = np.array([1.0, 1.0, 0.0])
        center, moved = (field[k].double().numpy() * flat for field in (found.center, found.moved_center))
        start, end = source.center[k].double().numpy() * flat, target.center[k].double().numpy() * flat
        turned = float(found.turn[k])
        true_turn = planar.wrap(float(target.heading[k] - source.heading[k]))
        if heading_axis:  # the evaluation forgives the turn, not what it does to the shift
            turned = true_turn + (planar.wrap(turned - true_turn) + np.pi / 2) % np.pi - np.pi / 2
        estimated = planar.to_transform(np.array([*(moved - center)[:2], turned]), center)
        true = planar.to_transform(np.array([*(end - start)[:2], true_turn]), start)
        expected = pair_error(estimated, true, start, heading_axis=heading_axis)
        np.testing.assert_allclose([float(shift[k]), float(turn[k])], expected, atol=1e-5)


def test_a_perfect_answer_costs_next_to_nothing():
    settings = LossSettings(heading="full")
    assert loss.angle_loss(outputs([3, 7]), torch.tensor([3.0, 7.0]) * 2 * math.pi / N_BINS, settings) < 1e-4


def test_an_axis_has_two_headings_and_a_heading_one():
    angle = torch.tensor([3.0, 7.0]) * 2 * math.pi / N_BINS
    flipped = outputs([28, 32])
    assert loss.angle_loss(flipped, angle, LossSettings(heading="sample_min")) < 1e-4
    assert loss.angle_loss(flipped, angle, LossSettings(heading="full")) > 10.0


def test_the_smaller_of_each_sample_is_less_than_that_of_the_batch_and_than_the_larger():
    angle = torch.tensor([3.0, 7.0]) * 2 * math.pi / N_BINS
    one_flipped = outputs([3, 32])
    by_rule = [
        float(loss.angle_loss(one_flipped, angle, LossSettings(heading=rule)))
        for rule in ("sample_min", "batch_min", "batch_max")
    ]
    assert by_rule[0] < 1e-4
    assert by_rule[1] == pytest.approx(10.0, rel=1e-3)  # of two samples one is off by a sureness of 20
    assert by_rule[2] == pytest.approx(10.0, rel=1e-3)
    both_right = [
        float(loss.angle_loss(outputs([3, 7]), angle, LossSettings(heading=rule)))
        for rule in ("batch_min", "batch_max")
    ]
    assert both_right == pytest.approx([0.0, 20.0], abs=1e-3)


def test_residuals_weigh_twenty_times_their_huber_distance():
    angle = torch.zeros(1) + 0.5 * math.pi / N_BINS  # half of half a bin: the true residual is 0.5
    expected = 20.0 * 0.5 * 0.5**2
    off = loss.angle_loss(outputs([0], residual=0.0), angle, LossSettings(heading="full"))
    assert float(off) == pytest.approx(expected, rel=1e-4)


def test_the_likelihood_is_best_where_the_precision_is_right():
    torch.manual_seed(0)
    found = motion(4000)
    error = 0.2 * torch.randn(4000, 3)
    source = Truth(found.center, torch.zeros(4000))
    moved = found.moved_center + torch.nn.functional.pad(error[:, :2], (0, 1))
    target = Truth(moved, found.turn + error[:, 2])
    values = []
    for sigma in (0.1, 0.2, 0.4):
        numbers = torch.zeros(4000, 6)
        numbers[:, :3] = -math.log(10.0 * sigma)
        sized = found._replace(precision=numbers)
        values.append(float(loss.negative_log_likelihood(sized, source, target, False)))
    assert values[1] < min(values[0], values[2])


def test_precision_factors_are_upper_triangular_with_a_positive_diagonal():
    factor = loss.precision_factor(torch.randn(5, 6))
    assert torch.equal(factor, factor.triu())
    assert (torch.diagonal(factor, dim1=1, dim2=2) > 0).all()


def test_the_parts_are_weighted_as_published():
    network = learned.network()
    *encodings, found = network(learned.clouds(seed=1), learned.clouds(seed=2))
    settings = LossSettings(covariance=0.0, angle=0.5)
    value, parts = loss.total(tuple(encodings), found, truths(4), settings)
    translation = 0.5 * (parts["coarse"] + parts["fine"]) + parts["final"]
    angle = 0.5 * parts["heading"] + parts["turn"]
    torch.testing.assert_close(value.detach(), translation + 0.5 * angle)
    silent = loss.total(tuple(encodings), found, truths(4), replace(settings, covariance=0.3))[0]
    torch.testing.assert_close((silent - value).detach(), 0.3 * parts["covariance"], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("setting", "message"), [({"heading": "min"}, "sample_min"), ({"unit": 0.0}, "positive")])
def test_impossible_settings_are_refused(setting, message):
    with pytest.raises(ValueError, match=message):
        LossSettings(**setting)
