"""The fast path gives what the plain path gives, and keeps the plug-in contract."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch

import registration
from registration import planar, se3
from registration.alignnet import answers, checkpoint, folding, inference, inference_kernels, loss, timing
from registration.alignnet.errors import WeightsError
from registration.alignnet.method import AlignNetCars
from registration.alignnet.packing import pack, padded, thinned
from registration.alignnet.products import FoldedLinear
from registration.alignnet.recipe import Recipe
from registration.alignnet.timing import PlainWay
from registration.method import prepare_seen_from
from registration.types import MotionPrior, Status
from tests import learned
from tests.segments import car_cloud, moving_tracklet, steps
from tracker.estimators.registration import RegistrationEstimator

CAR = car_cloud(300) + [12.0, 5.0, -1.0]
T_TRUE = se3.from_yaw(0.0, np.array([0.4, 0.1, 0.0]))


def _as_float(numbers):
    return _features(numbers).float().numpy()


def _features(numbers):
    features = torch.from_numpy(numbers)
    return features.view(torch.bfloat16) if numbers.dtype == np.int16 else features


@pytest.fixture
def weights(tmp_path):
    return str(learned.quiet_weights(tmp_path / "quiet.safetensors"))


@pytest.fixture
def make(weights):
    return partial(AlignNetCars, weights=weights)


@pytest.mark.parametrize("precision", ["float32", "bfloat16", "auto"])
@pytest.mark.parametrize("settings", [{}, {"covariance": False}, {"branch_norms": True, "composition": "additive"}])
def test_it_keeps_the_contract(tmp_path, precision, settings):
    path = learned.quiet_weights(tmp_path / "quiet.safetensors", **settings)
    registration.check_method(AlignNetCars(weights=str(path), precision=precision))


@torch.no_grad()
def test_the_folded_network_gives_what_the_plain_one_gives():
    network = learned.network()
    folded, plain = folding.fold(network), timing.unfolded(network)
    clouds = learned.clouds(sizes=(30, 5, 200))
    fast, slow = folded.encode(clouds), plain.encode(clouds)
    for found, expected in zip(fast, slow, strict=True):
        torch.testing.assert_close(found, expected, rtol=0.0, atol=1e-4)
    for rows in (slice(0, 2), slice(1, 3)):
        motions = [made.align(slow.rows(rows), slow.rows(slice(0, 2))) for made in (folded, plain)]
        for found, expected in zip(*motions, strict=True):
            torch.testing.assert_close(found, expected, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.bfloat16, 0.05)])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"covariance": False, "view_axes": False},
        {"sensor_context": False, "translation_dims": 3},
        {"composition": "additive", "coarse": (8, 16), "head": (16,)},
    ],
)
@torch.no_grad()
def test_the_network_for_arrays_gives_what_the_plain_one_gives(dtype, tolerance, settings):
    network = learned.network(**settings)
    if network.precision is not None:
        torch.nn.init.normal_(network.precision.weight, std=0.1)
    rng = np.random.default_rng(0)
    clouds = [rng.uniform([-2, -1, -0.7], [2, 1, 0.7], (n, 3)) + [900.0, 40.0, -1.0] for n in (30, 5, 200, 1)]
    origins, sensors = np.array([cloud[0] for cloud in clouds]), rng.uniform(880.0, 890.0, (4, 2))
    fast = inference.Inference(network, dtype)
    plain = timing.unfolded(network)
    found = fast.encode(clouds, origins, sensors, 100)
    expected = plain.encode(pack(clouds, list(origins), sensors - origins[:, :2], 100))
    poses = torch.cat([expected.center, expected.heading[:, None]], dim=1).double().numpy()
    np.testing.assert_allclose([each.pose for each in found], poses, atol=tolerance)
    embeddings = [_as_float(each.embedding) for each in found]
    np.testing.assert_allclose(embeddings, expected.embedding.numpy(), atol=tolerance, rtol=tolerance)
    answers_ = fast.align(found[:3], found[1:], 2.0)
    motion = plain.align(expected.rows(slice(0, 3)), expected.rows(slice(1, 4)))
    np.testing.assert_allclose(answers_.moved_center, motion.moved_center.numpy(), atol=tolerance)
    np.testing.assert_allclose(answers_.turn, motion.turn.numpy(), atol=tolerance)
    covariance = np.full((3, 3, 3), np.nan)
    if network.precision is not None:
        turned = np.stack([se3.from_yaw(heading, np.zeros(3))[:3, :3] for heading in motion.heading.tolist()])
        root = turned @ np.linalg.inv(loss.precision_factor(motion.precision.double()).numpy())
        covariance = 2.0 * root @ root.transpose(0, 2, 1)
    np.testing.assert_allclose(answers_.covariance, covariance, rtol=max(2.0 * tolerance, 1e-4), atol=1e-3 * tolerance)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_the_compiled_maximum_is_the_maximum(dtype):
    rng = np.random.default_rng(0)
    product = torch.from_numpy(rng.normal(size=(45, 6)).astype(np.float32) - [0, 9, 0, -9, 0, 0]).to(dtype)
    begin, bias, context = np.array([0, 3, 43, 44]), np.array([0, 8.0, 0.5, 0, -1, 0], np.float32), np.ones((3, 4))
    found = torch.empty((3, 8), dtype=dtype)
    inference_kernels.pool(inference._numbers(product), begin, bias, context, 2, inference._numbers(found))
    best = torch.stack([product[a:b].float().max(dim=0).values for a, b in pairwise(begin)])
    expected = torch.relu(best + torch.from_numpy(bias)).to(dtype)
    assert torch.equal(found, torch.cat([expected, torch.ones((3, 2), dtype=dtype)], dim=1))


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@torch.no_grad()
def test_a_layer_of_few_rows_is_the_layer(dtype):
    layer = learned.network().fine_head.normalised()[0]
    x = torch.randn(3, layer.weight.shape[1]).to(dtype)
    found = _features(inference.Dense(layer, dtype).forward(inference._numbers(x))).float()
    expected = FoldedLinear(layer, dtype).forward(x).float()
    torch.testing.assert_close(found, expected, rtol=0.01, atol=1e-2 if dtype is torch.bfloat16 else 1e-5)


def test_a_room_is_the_same_again_but_where_it_is_too_small_or_another_threads():
    room = inference.Room(2, torch.bfloat16, 4)
    numbers, same = room.rows(3)
    numbers[:] = inference._numbers(torch.full((3, 2), 1.5, dtype=torch.bfloat16))
    assert torch.equal(same, torch.full((3, 2), 1.5, dtype=torch.bfloat16))
    assert room.rows(3)[1] is same
    assert room.rows(2)[1].data_ptr() == same.data_ptr()
    (larger, as_tensor), (again, _) = room.rows(5), room.rows(5)
    larger[:] = inference._numbers(torch.ones((5, 2), dtype=torch.bfloat16))
    assert as_tensor.sum() == 10.0
    assert not again.any()
    with ThreadPoolExecutor(1) as pool:
        assert not pool.submit(lambda: room.rows(3)[0].any()).result()


def test_threads_that_share_a_network_do_not_disturb_each_other(make):
    method = make()
    clouds = [car_cloud(n, seed=n) + [9.0, 0.1 * n, -1.0] for n in range(20, 60)]
    alone = [method.prepare_cloud(cloud).encodings[0] for cloud in clouds]
    with ThreadPoolExecutor(4) as pool:
        together = [found.encodings[0] for found in pool.map(method.prepare_cloud, clouds)]
    for own, found in zip(alone, together, strict=True):
        np.testing.assert_array_equal(own.pose, found.pose)
        np.testing.assert_array_equal(own.embedding, found.embedding)


def test_batches_have_few_numbers_of_rows():
    sizes = [inference.like_sized(n) for n in range(1, 200)]
    assert all(n <= size <= 1.25 * n for n, size in enumerate(sizes, start=1))
    assert set(sizes[64:128]) == {80, 96, 112, 128}


def test_unpadded_clouds_give_what_clouds_with_repeated_points_give():
    network = inference.Inference(learned.network())
    offsets = CAR - CAR.mean(axis=0)
    repeated = np.concatenate([offsets, offsets[:212]])
    assert len(padded(offsets, 512, np.random.default_rng(0))) == 512
    frames, context = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0]]), np.zeros((1, 4))
    features = [
        network.coarse.pooled(points, np.array([0, len(points)]), frames, context, 4) for points in (offsets, repeated)
    ]
    torch.testing.assert_close(*features)


def test_each_cloud_is_encoded_once(make, monkeypatch):
    method, calls = make(), []
    encode = inference.Inference.encode
    monkeypatch.setattr(
        inference.Inference, "encode", lambda self, clouds, *a: calls.append(len(clouds)) or encode(self, clouds, *a)
    )
    a, b, c = method.prepare([CAR, CAR + [0.1, 0, 0], CAR + [0.2, 0, 0]])
    method.align([(a, b), (b, c)])
    method.align([(a, c)])
    assert calls == [3]


def test_clouds_that_were_not_encoded_cannot_be_compared(make):
    method = make()
    few, many = method.prepare([CAR[:1], CAR])
    with pytest.raises(ValueError, match="got 1 smaller"):
        method.compare([(many, many), (few, many)])


def test_a_quiet_network_answers_with_the_shift_of_the_centroids(make):
    result = make().register(CAR, se3.transform(T_TRUE, CAR))
    motion = result.motion_about(CAR.mean(axis=0))
    np.testing.assert_allclose(motion[:2], [0.4, 0.1], atol=0.02)
    assert result.status is Status.CONVERGED


def test_where_the_sensor_is_matters_and_the_axes_do_not(tmp_path):
    made = learned.network()
    path = tmp_path / "w.safetensors"
    checkpoint.write_weights(path, made, checkpoint.About(Recipe(network=made.architecture)))
    method = AlignNetCars(weights=str(path), precision="float32")
    T_world_lidar = se3.from_yaw(1.0, np.array([300.0, -200.0, 0.0]))
    target = CAR + [0.4, 0.1, 0.0]
    here = method.register(CAR, target)
    sensors = [T_world_lidar[:2, 3]] * 2
    a, b = method.prepare([se3.transform(T_world_lidar, cloud) for cloud in (CAR, target)], sensors)
    there = method.align([(a, b)])[0]
    expected = T_world_lidar @ here.T_target_source @ se3.invert(T_world_lidar)
    center = a.centroid
    np.testing.assert_allclose(there.motion_about(center), planar.motion_about(expected, center), atol=1e-4)
    R = np.pad(planar.rotation(1.0), (0, 1))
    R[2, 2] = 1.0
    np.testing.assert_allclose(there.covariance, R @ here.covariance @ R.T, atol=1e-4)


def test_a_tracker_in_world_axes_says_where_the_sensor_was(tmp_path):
    path, made = tmp_path / "w.safetensors", learned.network()
    checkpoint.write_weights(path, made, checkpoint.About(Recipe(network=made.architecture)))
    method = registration.refined(AlignNetCars(weights=str(path), precision="float32"), "centroid")
    still = moving_tracklet((3.0, 1.0), n_frames=3)
    poses = tuple(se3.from_yaw(np.pi / 2, np.array([300.0, -200.0, 0.0])) for _ in still.segments)
    by_sensor, by_world = (
        steps(RegistrationEstimator(made_method), tracklet)[-1]
        for made_method, tracklet in (
            (method.first, still),
            (method.first, replace(still, T_world_lidar=poses)),
        )
    )
    turned = planar.rotation(np.pi / 2) @ by_sensor.velocity
    np.testing.assert_allclose(by_world.velocity, turned, atol=2e-3)
    (here, _), (there, _) = (prepare_seen_from(method, [CAR], sensors)[0] for sensors in (None, [[3.0, 40.0]]))
    assert not np.allclose(*(_as_float(each.encodings[0].embedding) for each in (here, there)))


def test_a_prior_is_fused_by_the_covariances(make):
    method, target = make(), CAR + [0.4, 0.1, 0.0]
    free = method.register(CAR, target)
    mean = free.motion_about(CAR.mean(axis=0)) + [0.2, -0.1, 0.02]
    sure, unsure = (
        method.register(CAR, target, MotionPrior(mean, scale * np.eye(3))).motion_about(CAR.mean(axis=0))
        for scale in (1e-9, 1e6)
    )
    np.testing.assert_allclose(sure, mean, atol=1e-5)
    np.testing.assert_allclose(unsure, free.motion_about(CAR.mean(axis=0)), atol=1e-5)
    middle = method.register(CAR, target, MotionPrior(mean, free.covariance))
    np.testing.assert_allclose(middle.motion_about(CAR.mean(axis=0)), mean - [0.1, -0.05, 0.01], atol=1e-5)
    np.testing.assert_allclose(middle.covariance, 0.5 * free.covariance, atol=1e-6)


def test_too_few_points_are_no_success_and_the_shift_of_their_means(make):
    result = make().register(CAR[:2], CAR[:2] + [0.3, 0.0, 0.0])
    assert result.status is Status.TOO_FEW_POINTS
    np.testing.assert_allclose(result.T_target_source[:3, 3], [0.3, 0.0, 0.0], atol=1e-12)


def test_what_the_network_is_not_sure_of_is_no_success(make):
    result = make(max_spread=1e-6).register(CAR, CAR + [0.3, 0.0, 0.0])
    assert result.status is Status.NOT_CONVERGED
    np.testing.assert_allclose(result.T_target_source[:3, 3], [0.3, 0.0, 0.0], atol=1e-12)


def test_front_and_back_are_told_apart_by_how_far_objects_turn():
    motions, covariances = np.zeros((4, 7)), np.zeros((4, 3, 3))
    motions[:, 6] = told = [3.0, 0.2, 0.2, 3.0]
    inference_kernels.judge(motions, covariances, np.array([0.0, 0.0, 3.0, -3.0]), False, 8.0, 1.5)
    np.testing.assert_array_equal(motions[:, 6], told)
    inference_kernels.judge(motions, covariances, np.array([0.0, 0.0, 3.0, -3.0]), True, 8.0, 1.5)
    np.testing.assert_allclose(motions[:, 6], [3.0 - np.pi, 0.2, 0.2 - np.pi, 3.0])


def test_an_answer_is_doubted_where_it_is_wide_or_far_from_the_cloud():
    motions, root = np.zeros((5, 7)), np.random.default_rng(0).normal(size=(3, 3))
    covariances = np.tile(root @ root.T, (5, 1, 1))
    motions[2, 1], motions[3, 3] = -8.1, 8.1
    covariances[4] = np.nan
    widest = np.sqrt(np.linalg.eigvalsh(covariances[0, :2, :2]).max())
    nothing = np.zeros(5)
    sure = inference_kernels.judge(motions, covariances, nothing, True, 8.0, 1.001 * widest)
    np.testing.assert_array_equal(sure, [False, False, True, True, False])
    assert inference_kernels.judge(motions, covariances, nothing, True, 8.0, 0.999 * widest)[:4].all()


def test_large_clouds_are_thinned_evenly_and_always_alike():
    cloud = np.arange(30.0).reshape(10, 3)
    np.testing.assert_array_equal(thinned(cloud, 5), cloud[::2])
    assert thinned(cloud, 10) is cloud


def test_weights_that_do_not_ship_say_how_to_get_them(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "WEIGHTS_FOLDER", tmp_path)
    with pytest.raises(WeightsError, match=r"no weights for 'alignnet'; train some .*regmot train"):
        registration.create("alignnet")
    with pytest.raises(WeightsError, match=r"none.safetensors: no such file"):
        registration.create("alignnet", weights=str(tmp_path / "none.safetensors"))


def test_weights_of_the_package_are_found_by_the_methods_name(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "WEIGHTS_FOLDER", tmp_path)
    learned.quiet_weights(tmp_path / "alignnet.safetensors")
    method = registration.create("alignnet+icp")
    result = method.register(CAR, se3.transform(T_TRUE, CAR))
    assert method.name == "alignnet+icp"
    np.testing.assert_allclose(result.T_target_source, T_TRUE, atol=1e-6)


def test_a_method_can_be_sent_to_another_process(make):
    method = make()
    for copy in (pickle.loads(pickle.dumps(method)), deepcopy(method)):
        assert copy == method
        found, expected = (each.register(CAR, CAR + [0.3, 0.0, 0.0]) for each in (copy, method))
        np.testing.assert_array_equal(found.T_target_source, expected.T_target_source)


@pytest.mark.parametrize("setting", [{"min_points": 0}, {"max_points": 2}, {"precision": "half"}])
def test_impossible_settings_are_refused(make, setting):
    with pytest.raises(ValueError, match="expected 1 <= min_points|precision must be one of"):
        make(**setting)


def test_a_sensor_is_wanted_for_each_cloud_or_for_none(make):
    with pytest.raises(ValueError, match=r"sensor's \(x, y\) for each of 2 clouds"):
        make().prepare([CAR, CAR], [[0.0, 0.0]])


def test_a_frame_without_objects_has_no_clouds_and_no_sensors(make):
    assert make().prepare([], []) == []
    with pytest.raises(ValueError, match=r"for each of 1 clouds"):
        make().prepare([CAR], [])


def test_the_plain_way_gives_the_same_motions_but_for_the_points_it_draws(tmp_path):
    path = learned.quiet_weights(tmp_path / "w.safetensors")
    method = AlignNetCars(weights=str(path), precision="float32", max_points=300)
    plain = PlainWay(checkpoint.read_weights(path)[0], n_points=4000)  # so many that no point is left out
    target = se3.transform(T_TRUE, CAR)
    (motion,) = plain.align([(CAR, target)] * 2)
    assert plain.align([]) == []
    a, b = method.prepare([CAR, target])
    found = method.align([(a, b)])[0]
    shift = (motion.moved_center - motion.center)[0].numpy() + target.mean(axis=0) - CAR.mean(axis=0)
    center = CAR.mean(axis=0) + motion.center[0].numpy()
    np.testing.assert_allclose(found.motion_about(center)[:2], shift[:2], atol=0.06)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_cloud_is_encoded_alike_whatever_is_beside_it(make, precision):
    method = make(precision=precision)
    clouds = [car_cloud(n, seed=n) + [9.0, 0.1 * n, -1.0] for n in (3, 40, 127, 128, 129, 256, 300, 900)]
    alone = [method.prepare([cloud])[0].encodings[0] for cloud in clouds]
    for begin, end in ((0, 8), (1, 3), (2, 7)):
        for own, prepared in zip(alone[begin:end], method.prepare(clouds[begin:end]), strict=True):
            np.testing.assert_allclose(own.pose, prepared.encodings[0].pose, rtol=0.0, atol=1e-6)
            embeddings = (_as_float(each.embedding) for each in (own, prepared.encodings[0]))
            np.testing.assert_allclose(*embeddings, rtol=0.0, atol=1e-6)


def test_results_of_a_batch_are_those_of_the_formulas_pair_by_pair():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 3, 3))
    found = answers.Answers(
        motions=rng.uniform(-1.0, 1.0, (5, 7)) * [1, 1, 0, 1, 1, 0, 1],
        covariance=0.01 * root @ root.transpose(0, 2, 1),
    )
    sources, targets = rng.normal(size=(2, 5, 3)) + [10.0, 5.0, -1.0]
    results = answers.results(found, [(CAR, CAR)] * 5, sources, targets)
    for k, result in enumerate(results):
        center = sources[k] + found.center[k]
        shift = targets[k] + found.moved_center[k] - center
        np.testing.assert_allclose(result.motion_about(center), [*shift[:2], found.turn[k]], atol=1e-12)
        expected = planar.transport_covariance(found.covariance[k], found.turn[k], center[:2], sources[k, :2])
        np.testing.assert_allclose(result.covariance, expected, atol=1e-7)
        assert result.T_target_source[2, 3] == pytest.approx(targets[k, 2] - sources[k, 2])


def test_the_plain_way_of_a_method_runs_its_own_weights(make):
    expected, plain = learned.network().state_dict(), make().plain_way().network.state_dict()
    assert set(plain) == set(expected)
    assert torch.equal(plain["fine.layers.0.weight"], expected["fine.layers.0.weight"])
