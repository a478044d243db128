"""Sets of pairs like KITTI's tracklets: they follow the statistics, and their truth is the object's own."""

from dataclasses import replace

import numpy as np
import pytest

from registration import planar, se3
from registration.synthetic import traffic
from registration.synthetic.bodies import RigidBody
from registration.synthetic.kitti_like import AIR, Look, Subject, kitti_like_scenes
from registration.synthetic.lidar import HDL_64E, PlacedMesh, scan
from registration.synthetic.meshes import Material, box_mesh
from registration.synthetic.production import make_pair
from registration.synthetic.scenery import (
    Ground,
    Occluder,
    draw_hidden_shares,
    ground_patch,
    place_occluder,
)
from registration.synthetic.traffic import Motion, Sight


@pytest.fixture(scope="module")
def like():
    scenes = kitti_like_scenes("kitti-like-cars-persons")
    return [make_pair(scenes, 5, "train", index) for index in range(32)]


def test_kitti_like_pairs_keep_the_labels_ranges_and_classes(like):
    assert {p.extra["class"] for p in like} == {"Car", "Van", "Pedestrian"}
    gaps = [p.extra["gap"] for p in like]
    assert min(gaps) == 1
    assert 2 < max(gaps) <= traffic.MAX_GAP
    assert 0.3 < np.mean(np.array(gaps) == 1) < 0.7
    for p in like:
        assert p.extra["dt"] == pytest.approx(0.1 * p.extra["gap"])
        assert p.extra["range"] == pytest.approx(np.hypot(*p.start_position[:2]))
        assert max(np.hypot(*p.start_position[:2]), np.hypot(*p.end_position[:2])) <= 80.0
        assert p.start_position[0] > 0.0  # the labels are those of a camera that looks ahead
        assert min(len(p.source), len(p.target)) > 0


def test_kitti_like_clouds_lie_in_their_jittered_boxes_on_one_ground(like):
    for p in like:
        for cloud, center, yaw, jitter in (
            (p.source, p.start_position, p.start_angle, p.extra["label_jitter"][0]),
            (p.target, p.end_position, p.end_angle, p.extra["label_jitter"][1]),
        ):
            T_label_lidar = se3.invert(se3.from_yaw(yaw, center) @ se3.from_yaw(jitter[3], np.array(jitter[:3])))
            assert (np.abs(se3.transform(T_label_lidar, cloud)) <= 0.5 * np.array(p.extra["size"]) + 1e-9).all()
        assert p.start_position[2] == pytest.approx(p.end_position[2])


def test_kitti_like_truth_is_of_the_object_not_of_its_label(like):
    jitters = np.array([p.extra["label_jitter"] for p in like]).reshape(-1, 4)
    assert 0.0 < np.std(jitters[:, 0]) < 0.2
    dense = [p for p in like if p.extra["class"] != "Pedestrian" and min(len(p.source), len(p.target)) > 150]
    assert len(dense) >= 5
    for p in dense:
        moved = se3.transform(p.T_target_source, p.source)
        gap = np.linalg.norm(moved[:, None, :2] - p.target[None, :, :2], axis=2).min(axis=1)
        assert np.median(gap) < 0.08


def test_a_rolling_shutter_bends_the_cloud_but_its_middle_stays_where_the_truth_says():
    in_line = replace(HDL_64E, azimuth_offsets=None)  # all beams of the head point the same way
    scenes = replace(kitti_like_scenes("kitti-like-cars"), beam_model=in_line)
    size, sight = np.array([4.0, 1.7, 1.5]), Sight(12.0, 0.7, 0.7 + 0.5 * np.pi)  # broadside, to the left
    body = RigidBody(box_mesh(size - AIR, Material.PAINT_LIGHT))
    ground, still = Ground(-1.7, np.zeros(2)), np.zeros(4)

    def seen(speed):
        look = Look(sight, Motion(np.array([speed, 0.0]), 0.0), ground, 0.0, 0.0, still)
        points, n_occluders = scenes.see(Subject("Car", size, body, None, None), look, np.random.default_rng(0))
        assert n_occluders == 0
        along = (points[:, :2] - sight.xy) @ [np.cos(sight.yaw), np.sin(sight.yaw)]
        return along[points[:, 2] > -1.5]

    at_rest, fast = seen(0.0), seen(30.0)
    assert np.ptp(at_rest) == pytest.approx(3.9, abs=0.1)
    # the beams turn clockwise at 20 pi rad/s, 750 m/s at 12 m, against the car: it looks shorter by 30 / (30 + 754)
    assert np.ptp(fast) == pytest.approx(3.9 * 754 / 784, abs=0.06)
    assert 0.5 * (fast.min() + fast.max()) == pytest.approx(0.0, abs=0.06)


def test_hard_pairs_are_far_apart_and_turned():
    scenes = kitti_like_scenes("kitti-like-cars-hard")
    pairs = [make_pair(scenes, 0, "train", index) for index in range(10)]
    assert min(p.extra["gap"] for p in pairs) >= 10
    assert min(abs(planar.wrap(p.end_angle - p.start_angle)) for p in pairs) >= np.deg2rad(45.0)
    assert {np.sign(p.end_angle - p.start_angle) for p in pairs} == {-1.0, 1.0}


def test_places_sizes_and_speeds_follow_the_statistics():
    rng, cars = np.random.default_rng(0), traffic.kitti_traffic("vehicles")
    sights = [cars.sight(rng) for _ in range(3000)]
    counts = np.array(cars.tables["place"])
    drawn = traffic.count_places(np.array([(s.range_m, s.bearing) for s in sights]))
    expected = counts.sum(axis=1) / counts.sum()
    np.testing.assert_allclose(drawn.sum(axis=1) / 3000, expected, atol=4.0 * np.sqrt(0.25 / 3000))
    sizes = np.array([cars.size("Car", rng) for _ in range(500)])
    np.testing.assert_allclose(np.log(sizes).mean(axis=0), cars.tables["classes"]["Car"]["log_size"], atol=0.02)
    ahead = [cars.motion(Sight(20.0, 0.0, 0.0), rng).velocity[0] for _ in range(500)]
    towards = [cars.motion(Sight(40.0, 0.1, np.pi), rng).velocity[0] for _ in range(500)]
    assert abs(np.median(ahead)) < 3.0  # it goes with us
    assert np.median(towards) > 5.0  # it comes, and so do we


def test_what_hides_an_object_takes_its_share_and_the_ground_lies_under_it():
    sight, size, ground = (
        Sight(20.0, 0.3, 0.3 + 0.5 * np.pi),
        np.array([4.0, 1.7, 1.5]),
        Ground(-1.7, np.array([0.01, 0.0])),
    )
    wall = Occluder(RigidBody(box_mesh(np.array([6.0, 0.3, 4.0]), Material.MASONRY)), 0.6, 1.0, 0.0)
    target = box_mesh(size, Material.PAINT_LIGHT)
    T = se3.from_yaw(sight.yaw, np.array([*sight.xy, ground.z(sight.xy)]))
    assert place_occluder(wall, sight, size, 0.0, ground) is None
    assert place_occluder(wall, Sight(4.0, 0.3, sight.yaw), size, 0.5, ground) is None  # no room

    def n_seen(hidden):
        before = place_occluder(wall, sight, size, hidden, ground)
        objects = [PlacedMesh(target, T)] + ([] if before is None else [before])
        return int((scan(objects, HDL_64E, np.random.default_rng(0)).object_index == 0).sum())

    assert n_seen(0.5) == pytest.approx(0.5 * n_seen(0.0), rel=0.1)
    assert n_seen(0.8) == pytest.approx(0.2 * n_seen(0.0), rel=0.2)
    patch = ground_patch(ground, sight.xy, 8.0)
    top = patch.mesh.moved(patch.T_lidar_obj).vertices[4:]
    np.testing.assert_allclose(top[:, 2], [ground.z(xy) for xy in top[:, :2]], atol=1e-9)


def test_a_hidden_share_changes_little_while_its_level_stays():
    rng = np.random.default_rng(0)
    steady = np.array([draw_hidden_shares((2, 2), 1, rng) for _ in range(200)])
    assert np.abs(np.diff(steady)).max() < 0.15
    assert {draw_hidden_shares((0, 0), 5, rng) for _ in range(5)} == {(0.0, 0.0)}
    appearing = np.array([draw_hidden_shares((0, 1), 5, rng) for _ in range(50)])
    assert (appearing[:, 0] == 0.0).all()
    assert appearing[:, 1].min() >= 0.15
