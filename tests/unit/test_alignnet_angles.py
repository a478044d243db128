"""Angles survive their way through bins, and half a turn is exactly half of the bins."""

import math

import pytest
import torch

from registration.alignnet import angles


@pytest.mark.parametrize("n_bins", [2, 36, 50])
def test_what_is_encoded_is_decoded(n_bins):
    angle = torch.linspace(-9.0, 9.0, 1001)
    bins, residual = angles.encode(angle, n_bins)
    outputs = torch.zeros(len(angle), 2 * n_bins)
    outputs[torch.arange(len(angle)), bins] = 1.0
    outputs[torch.arange(len(angle)), n_bins + bins] = residual
    assert ((residual >= -1.0) & (residual <= 1.0)).all()
    assert angles.wrap(angles.decode(outputs) - angle).abs().max() < 1e-5


def test_half_a_turn_is_twenty_five_bins_and_the_same_residual():
    angle = torch.linspace(-3.0, 3.0, 101)
    bins, residual = angles.encode(angle, 50)
    opposite, same = angles.encode(angle + math.pi, 50)
    assert torch.equal((bins + 25) % 50, opposite)
    torch.testing.assert_close(residual, same, atol=2e-5, rtol=0.0)


def test_folded_turns_keep_their_axis():
    angle = torch.linspace(-7.0, 7.0, 201)
    folded = angles.fold(angle)
    assert folded.abs().max() <= math.pi / 2
    torch.testing.assert_close(torch.cos(2 * folded), torch.cos(2 * angle), atol=1e-5, rtol=0.0)


def test_points_turn_counter_clockwise_each_by_its_own_angle():
    points = torch.tensor([[1.0, 0.0, 5.0], [1.0, 0.0, 6.0]])
    turned = angles.rotate(points, torch.tensor([math.pi / 2, math.pi]))
    torch.testing.assert_close(turned, torch.tensor([[0.0, 1.0, 5.0], [-1.0, 0.0, 6.0]]), atol=1e-6, rtol=0.0)
