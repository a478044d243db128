"""What is folded, packed and sparse gives what the plain way gives, and its gradients."""

from unittest.mock import Mock

import pytest
import torch
from torch import nn

from registration.alignnet import products, ragged
from registration.alignnet.layers import Head, NormalisedLinear, PointEncoder
from registration.alignnet.products import FoldedLinear
from tests import learned


def test_the_maximum_is_taken_over_each_cloud():
    features = torch.tensor([[1.0, -5.0], [0.0, -3.0], [7.0, 7.0]])
    best = ragged.maximum(features, torch.tensor([0, 0, 2]), 3)
    assert best.tolist() == [[1.0, -3.0], [-torch.inf, -torch.inf], [7.0, 7.0]]


def test_the_mean_of_an_empty_cloud_is_zero():
    means = ragged.mean(torch.tensor([[1.0], [3.0]]), torch.tensor([1, 1]), 2)
    assert means.tolist() == [[0.0], [2.0]]


@pytest.mark.parametrize("sizes", [(5,), (3, 0, 40, 1), (5000, 2, 5000)])
def test_the_sparse_maximum_and_its_gradients_are_those_of_the_dense_one(sizes):
    torch.manual_seed(0)
    cloud = torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
    results = []
    for maximum in (
        lambda x, w: ragged.linear_maximum(x, w, cloud, len(sizes)),
        lambda x, w: ragged.maximum(x @ w.T, cloud, len(sizes)),
    ):
        x = torch.linspace(-1.0, 1.0, len(cloud) * 4).reshape(-1, 4).sin().requires_grad_()
        weight = torch.linspace(-2.0, 3.0, 24).reshape(6, 4).cos().requires_grad_()
        best = torch.relu(maximum(x, weight))
        (best * torch.arange(1.0, 7.0)).sum().backward()
        results.append((best, x.grad, weight.grad))
    for sparse, dense in zip(*results, strict=True):
        torch.testing.assert_close(sparse, dense, rtol=1e-4, atol=1e-5)


def test_bfloat16_has_the_maximum_of_its_own_products():
    x, weight = torch.randn(300, 8).bfloat16(), torch.randn(20, 8).bfloat16()
    cloud = torch.repeat_interleave(torch.arange(3), 100)
    assert torch.equal(ragged.linear_maximum(x, weight, cloud, 3), ragged.maximum(x @ weight.T, cloud, 3))


def test_points_are_said_in_axes_of_their_own_cloud():
    points, cloud = torch.tensor([[3.0, 1.0, 5.0], [3.0, 1.0, 5.0]]), torch.tensor([0, 1])
    origin, heading = torch.tensor([[3.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), torch.tensor([torch.pi / 2, torch.pi])
    expected = torch.tensor([[1.0, 0.0, 4.0], [-3.0, -1.0, 5.0]])
    torch.testing.assert_close(ragged.in_axes(points, cloud, origin, heading), expected)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.bfloat16, 0.05)])
@pytest.mark.parametrize("active", [True, False])
def test_a_folded_layer_of_inference_is_the_layer_and_its_relu(dtype, tolerance, active):
    torch.manual_seed(4)
    layer = nn.Linear(7, 5)
    folded, x = FoldedLinear(layer, dtype, active=active), torch.randn(9, 7)
    expected = torch.relu(layer(x)) if active else layer(x)
    with torch.no_grad():
        torch.testing.assert_close(folded(x.to(dtype)).float(), expected, rtol=0.0, atol=tolerance)
        torch.testing.assert_close(folded.product(x.to(dtype)).float(), x @ layer.weight.T, rtol=0.0, atol=tolerance)


def test_torch_without_packed_weights_gives_the_same(monkeypatch):
    layer, x = nn.Linear(70, 50), torch.randn(9, 70).bfloat16()
    packed = FoldedLinear(layer, torch.bfloat16)
    monkeypatch.setattr(products, "_multiply", Mock(side_effect=NotImplementedError))
    plain = FoldedLinear(layer, torch.bfloat16)
    assert plain.packed is None
    monkeypatch.undo()
    torch.testing.assert_close(plain(x), packed(x), rtol=0.01, atol=0.01)


@pytest.mark.parametrize("training", [False, True])
def test_a_folded_layer_is_the_layer(training):
    torch.manual_seed(1)
    one, other = NormalisedLinear(5, 7), NormalisedLinear(5, 7)
    other.load_state_dict(one.state_dict())
    x = torch.randn(200, 5) * 3.0 + 1.0
    plain = one.train(training)(x)
    weight, bias = other.train(training).folded(x)
    torch.testing.assert_close(x @ weight.T + bias, plain, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(one.mean, other.mean, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(one.variance, other.variance, rtol=1e-4, atol=1e-5)


def test_a_normalised_batch_has_mean_0_and_variance_1():
    layer = NormalisedLinear(3, 4).train()
    outputs = layer(torch.randn(500, 3) * 5.0 + 2.0)
    torch.testing.assert_close(outputs.mean(dim=0), torch.zeros(4), atol=1e-4, rtol=0.0)
    torch.testing.assert_close(outputs.var(dim=0, correction=0), torch.ones(4), atol=1e-2, rtol=0.0)


@pytest.mark.parametrize("training", [False, True])
def test_an_encoder_gives_what_it_gives_layer_by_layer(training):
    torch.manual_seed(2)
    encoder = PointEncoder((8, 12, 20)).train(training)
    batch = learned.clouds(sizes=(50, 3, 200))
    packed = encoder(batch.points, batch.cloud, 3)
    torch.testing.assert_close(packed, encoder.plain(batch.points, batch.cloud, 3), rtol=1e-3, atol=1e-4)


def test_an_empty_cloud_is_encoded_as_zeros():
    encoder = PointEncoder((4, 4, 4)).eval()
    features = encoder(torch.ones(2, 3), torch.tensor([0, 0]), 2)
    assert torch.equal(features[1], torch.zeros(4))


def test_dropout_leaves_out_30_percent_before_the_last_layer():
    torch.manual_seed(3)
    head = Head(4, (512, 256), 2, dropout=0.3).train()
    kept = (head.dropout(torch.ones(100, 256)) > 0).float().mean()
    assert kept == pytest.approx(0.7, abs=0.02)
