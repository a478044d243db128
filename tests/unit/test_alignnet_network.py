"""The network has the paper's sizes, and looks at objects, not at where they are."""

import math

import numpy as np
import pytest
import torch

from registration import planar, se3
from registration.alignnet import angles
from registration.alignnet.network import AlignNet, Architecture
from registration.alignnet.ragged import Clouds
from tests import learned

PAPER = {"view_axes": False, "sensor_context": False, "covariance": False}
POINT_BIASES = 64 + 128 + 256 + 64 + 128 + 512 + 64 + 128 + 1024  # batch norm makes a linear map's own bias idle
HEAD_BIASES = 3 * (512 + 256)


def count(network):
    return sum(p.numel() for p in network.parameters())


def test_the_released_network_has_its_number_of_parameters():
    released = {"translation_dims": 3, "composition": "additive"}
    network = AlignNet(Architecture(**PAPER, **released, branch_norms=True))
    assert count(network) == 2_165_073 - POINT_BIASES - HEAD_BIASES
    shared = AlignNet(Architecture(**PAPER, **released))
    assert count(shared) == 2_157_265 - POINT_BIASES - HEAD_BIASES


def test_weights_stay_below_ten_megabytes():
    assert 4 * count(AlignNet(Architecture())) < 10e6


def turned(clouds: Clouds, angle: float) -> Clouds:
    each = torch.full((len(clouds.points),), angle)
    sensor = angles.rotate(clouds.sensor, torch.full((len(clouds.sensor),), angle))
    return clouds._replace(points=angles.rotate(clouds.points, each), sensor=sensor)


def test_an_object_seen_at_another_bearing_is_the_same_object():
    network, clouds = learned.network(), learned.clouds()
    there, here = network.encode(turned(clouds, 1.0)), network.encode(clouds)
    torch.testing.assert_close(there.embedding, here.embedding, atol=1e-4, rtol=1e-4)
    off = angles.wrap(there.heading - here.heading - 1.0)
    torch.testing.assert_close(off, torch.zeros(4), atol=1e-4, rtol=0.0)
    center = angles.rotate(here.center, torch.ones(4))
    torch.testing.assert_close(there.center, center, atol=1e-4, rtol=1e-4)


def test_a_cloud_is_encoded_alike_alone_in_a_batch_and_with_repeated_points():
    network, clouds = learned.network(), learned.clouds(sizes=(30, 12))
    first = Clouds(clouds.points[:30], clouds.cloud[:30], clouds.n_seen[:1], clouds.sensor[:1])
    doubled = first._replace(points=first.points.repeat(2, 1), cloud=first.cloud.repeat(2))
    together = network.encode(clouds).rows(slice(0, 1))
    for other in (network.encode(first), network.encode(doubled)):
        for a, b in zip(together, other, strict=True):
            torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4)


@torch.no_grad()
def test_early_poses_and_the_rest_are_composed_as_published():
    network = learned.network()
    source, target = network.encode(learned.clouds(seed=1)), network.encode(learned.clouds(seed=2))
    motion = network.align(source, target)
    outputs = network.final_head(torch.cat([source.embedding, target.embedding], dim=1))
    k = 2
    rest = se3.from_yaw(float(angles.decode(outputs[:, 2:])[k]), np.array([*outputs[k, :2].tolist(), 0.0]))
    T1, T2 = (se3.from_yaw(float(e.heading[k]), e.center[k].double().numpy() * [1, 1, 0]) for e in (source, target))
    expected = planar.motion_about(T2 @ rest @ se3.invert(T1), source.center[k].double().numpy())
    shift = (motion.moved_center - motion.center)[k, :2].tolist()
    np.testing.assert_allclose(shift, expected[:2], atol=1e-5)
    assert planar.wrap(float(motion.turn[k]) - float(expected[2])) == pytest.approx(0.0, abs=1e-5)


def test_additive_composition_adds_in_the_axes_of_the_sensor():
    network = learned.network(composition="additive")
    source, target = network.encode(learned.clouds(seed=1)), network.encode(learned.clouds(seed=2))
    outputs = network.final_head(torch.cat([source.embedding, target.embedding], dim=1))
    moved = network.align(source, target).moved_center
    torch.testing.assert_close(moved[:, :2], target.center[:, :2] + outputs[:, :2])


def test_clouds_of_a_pair_may_have_norms_of_their_own():
    network = learned.network(branch_norms=True)
    clouds = learned.clouds()
    assert not torch.allclose(network.encode(clouds, 0).embedding, network.encode(clouds, 1).embedding)
    network.train()
    before = network.fine.layers[0].mean.clone()
    network(learned.clouds(seed=1), learned.clouds(seed=2))
    moved = (network.fine.layers[0].mean - before).abs().sum(dim=1)
    assert (moved > 0).all()


def test_heads_may_predict_z():
    motion = learned.network(translation_dims=3)(learned.clouds(seed=1), learned.clouds(seed=2))[2]
    flat = learned.network()(learned.clouds(seed=1), learned.clouds(seed=2))
    assert motion.moved_center.shape == (4, 3)
    torch.testing.assert_close(flat[0].center[:, 2], flat[0].coarse_center[:, 2])


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"composition": "both"}, "composed, additive"),
        ({"translation_dims": 1}, "2 or 3"),
        ({"n_bins": 25}, "even"),
    ],
)
def test_an_impossible_architecture_is_refused(setting, message):
    with pytest.raises(ValueError, match=message):
        Architecture(**setting)


def test_angles_are_said_relative_to_the_line_of_sight():
    clouds = learned.clouds()
    encoding = learned.network().encode(clouds)
    assert ((encoding.bearing.abs() - math.pi) <= 0).all()
    assert torch.equal(learned.network(view_axes=False).encode(clouds).bearing, torch.zeros(4))
