"""Sweeps over simple scenes whose answers are known."""

import dataclasses

import numpy as np
import pytest

from registration import se3
from registration.synthetic.cars import SEDAN, car
from registration.synthetic.lidar import (
    GROUND,
    HDL_64E,
    SYMMETRIC_64,
    BeamModel,
    PlacedMesh,
    level_ground,
    pose_after,
    scan,
    twist_between,
)
from registration.synthetic.meshes import Material, box_mesh, merge

# All beams start in one point and are lines: what is looked for in a test is switched on there.
COARSE = BeamModel("coarse", HDL_64E.elevations, np.deg2rad(0.5))
EXACT = dataclasses.replace(COARSE, range_noise=0.0, misfire=0.0)
KITTI_COARSE = dataclasses.replace(HDL_64E, azimuth_step=np.deg2rad(0.5))


def wall(distance: float, material: Material = Material.MASONRY, width: float = 4.0):
    """Place a wall whose face is the plane x = distance, from the ground up to 3 m, facing the sensor."""
    mesh = box_mesh(np.array([0.2, width, 3.0]), material)
    return mesh, se3.from_yaw(0.0, np.array([distance + 0.1, 0.0, -1.73]))


def sweep_of(objects, beam_model=COARSE, seed=0, ground=None):
    return scan([PlacedMesh(*placed) for placed in objects], beam_model, np.random.default_rng(seed), ground)


def test_without_noise_all_returns_lie_on_the_surface():
    sweep = sweep_of([wall(10.0)], EXACT, ground=level_ground(EXACT))
    on_wall = sweep.points_lidar[sweep.object_index == 0]
    on_ground = sweep.points_lidar[sweep.object_index == GROUND]
    front = on_wall[np.abs(on_wall[:, 1]) < 1.99]
    assert len(front) > 500
    assert len(on_ground) > 5000
    np.testing.assert_allclose(front[:, 0], 10.0, atol=1e-4)
    np.testing.assert_allclose(on_ground[:, 2], -1.73, atol=1e-4)


def test_range_noise_is_along_the_beam_and_as_large_as_the_model_says():
    points = sweep_of([wall(10.0)]).points_lidar
    points = points[points[:, 0] < 10.1]
    range_m = np.linalg.norm(points, axis=1)
    noise = range_m - 10.0 * range_m / points[:, 0]
    assert len(points) > 500
    assert noise.std() == pytest.approx(COARSE.range_noise, rel=0.1)
    assert abs(noise.mean()) < 0.003
    elevation = np.arcsin(points[:, 2] / range_m)
    assert np.abs(elevation[:, None] - HDL_64E.elevations).min(axis=1).max() < 1e-6


def test_what_stands_behind_something_is_not_seen():
    near, far = wall(10.0), wall(20.0)
    assert 0 in sweep_of([far]).object_index
    assert set(sweep_of([near, far]).object_index) == {0}
    assert set(sweep_of([near, wall(20.0, width=30.0)]).object_index) == {0, 1}


def test_a_car_casts_a_shadow_on_the_ground():
    placed = car(SEDAN), se3.from_yaw(0.0, np.array([10.0, 0.0, -1.73]))
    empty, occupied = (sweep_of(objects, ground=level_ground(COARSE)) for objects in ([], [placed]))

    def ground_behind(sweep):
        x, y, _ = sweep.points_lidar.T
        return int(((x > 13.0) & (x < 25.0) & (np.abs(y) < 0.5) & (sweep.object_index == GROUND)).sum())

    assert ground_behind(empty) > 20
    assert ground_behind(occupied) == 0


def test_glass_returns_less_than_paint():
    n_paint = len(sweep_of([wall(10.0, Material.PAINT_SILVER)]).points_lidar)
    n_glass = len(sweep_of([wall(10.0, Material.GLASS)]).points_lidar)
    assert 0 < n_glass < 0.3 * n_paint


def test_dark_paint_is_lost_at_a_distance_where_light_paint_is_not():
    def share_lost(distance, material):
        alone = dataclasses.replace(EXACT, reach=1e9)
        return 1.0 - len(sweep_of([wall(distance, material, 30.0)]).points_lidar) / len(
            sweep_of([wall(distance, Material.PAINT_LIGHT, 30.0)], alone).points_lidar
        )

    assert share_lost(20.0, Material.PAINT_DARK) < 0.1
    assert share_lost(110.0, Material.PAINT_DARK) > 0.4
    assert share_lost(110.0, Material.PAINT_LIGHT) < 0.1


def test_flat_hits_are_lost_more_often_than_steep_ones():
    steep_only = dataclasses.replace(EXACT, min_grazing=1e-9, reach=1e9)
    thinning = dataclasses.replace(steep_only, min_grazing=np.deg2rad(5.0))
    kept = [len(sweep_of([], model, ground=level_ground(model)).points_lidar) for model in (steep_only, thinning)]
    assert kept[1] < 0.9 * kept[0]
    head_on = [len(sweep_of([wall(10.0)], model).points_lidar) for model in (steep_only, thinning)]
    assert head_on[1] > 0.98 * head_on[0]


def test_nothing_is_returned_from_too_near_or_too_far():
    model = dataclasses.replace(COARSE, min_range=5.0, max_range=30.0)
    sweep = sweep_of([wall(3.0), wall(40.0, width=60.0)], model, ground=level_ground(model))
    range_m = np.linalg.norm(sweep.points_lidar, axis=1)
    assert 5.0 <= range_m.min() < 6.0
    assert range_m.max() <= 30.0


def test_brighter_surfaces_echo_more_strongly_and_all_intensities_are_shares():
    light, dark = (sweep_of([wall(10.0, paint)]) for paint in (Material.PAINT_LIGHT, Material.PAINT_DARK))
    assert light.intensity.mean() > 3.0 * dark.intensity.mean()
    assert 0.0 <= dark.intensity.min() <= light.intensity.max() <= 1.0


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not():
    objects = [(car(SEDAN), se3.from_yaw(0.4, np.array([8.0, 3.0, -1.73])))]
    model = KITTI_COARSE
    first, again, other = (sweep_of(objects, model, seed, level_ground(model)) for seed in (7, 7, 8))
    for field in dataclasses.fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(again, field.name))
    assert first.points_lidar.tobytes() != other.points_lidar.tobytes()


@pytest.mark.parametrize("model", [COARSE, KITTI_COARSE], ids=["lines", "hdl-64e"])
def test_a_return_keeps_its_noise_when_something_else_enters_the_scene(model):
    alone = sweep_of([wall(10.0)], model)
    joined = sweep_of([wall(10.0), (wall(10.0)[0], se3.from_yaw(np.pi, np.array([-10.0, 0.0, -1.73])))], model)
    np.testing.assert_array_equal(joined.points_lidar[joined.object_index == 0], alone.points_lidar)


def test_an_empty_world_returns_nothing():
    sweep = sweep_of([])
    assert sweep.points_lidar.shape == (0, 3)
    assert len(sweep.object_index) == 0


def test_a_post_before_a_car_hides_what_is_behind_it():
    placed = PlacedMesh(car(SEDAN), se3.from_yaw(0.5 * np.pi, np.array([12.0, 0.0, -1.73])))
    post = PlacedMesh(
        box_mesh(np.array([0.3, 0.3, 3.0]), Material.METAL), se3.from_yaw(0.0, np.array([6.0, 0.0, -1.73]))
    )
    free, hidden = (scan(objects, EXACT, np.random.default_rng(0)) for objects in ([placed], [placed, post]))
    azimuth = np.arctan2(hidden.points_lidar[:, 1], hidden.points_lidar[:, 0])
    behind = np.abs(azimuth) < np.arctan2(0.14, 6.15)
    assert set(hidden.object_index[behind]) == {1}
    lost = set(map(tuple, free.points_lidar)) - set(map(tuple, hidden.points_lidar))
    assert len(lost) > 50
    assert max(abs(np.arctan2(y, x)) for x, y, _ in lost) < np.arctan2(0.16, 5.85)


def test_points_of_a_moving_wall_lie_where_it_is_when_their_beam_fires():
    velocity, turn = np.array([15.0, -4.0, 0.0]), 0.8
    twist = np.concatenate([velocity, [0.0, 0.0, turn]])
    sweep = scan([PlacedMesh(*wall(10.0, width=40.0), twist)], EXACT, np.random.default_rng(0))
    front = np.abs(np.arctan2(sweep.points_lidar[:, 1], sweep.points_lidar[:, 0])) < 1.0
    assert front.sum() > 3000
    assert np.ptp(sweep.time[front]) > 0.02
    for point, t in zip(sweep.points_lidar[front][::29], sweep.time[front][::29], strict=True):
        # The face x = 10 turns about the sensor's axis while the point at the origin goes along an arc.
        angle = turn * t
        arc = np.array([[np.sin(angle), np.cos(angle) - 1.0], [1.0 - np.cos(angle), np.sin(angle)]]) / turn
        normal = np.array([np.cos(angle), np.sin(angle)])
        assert (point[:2] - arc @ velocity[:2]) @ normal == pytest.approx(10.0, abs=1e-3)


def test_returns_say_when_they_were_fired_clockwise_from_the_rear():
    sweep = sweep_of([], EXACT, ground=level_ground(EXACT))
    azimuth = np.arctan2(sweep.points_lidar[:, 1], sweep.points_lidar[:, 0])
    np.testing.assert_allclose(sweep.time, -0.1 * azimuth / (2.0 * np.pi), atol=1e-9)
    still = sweep_of([wall(10.0)], EXACT)
    moving = scan([PlacedMesh(*wall(10.0), np.zeros(6))], EXACT, np.random.default_rng(0))
    np.testing.assert_allclose(moving.points_lidar, still.points_lidar, atol=1e-6)


def test_a_moving_sensor_sees_a_street_sheared_and_its_own_poses_straighten_it():
    # The sensor drives 20 m/s and turns; a wall on each side, one before the cut at the rear and one after.
    T_world_lidar, later = se3.from_yaw(0.0, np.zeros(3)), se3.from_yaw(0.03, np.array([2.0, 0.03, 0.0]))
    twist_lidar = twist_between(se3.invert(T_world_lidar), se3.invert(later), 0.1)
    box = box_mesh(np.array([80.0, 0.2, 4.0]), Material.MASONRY)
    sides = [se3.from_yaw(0.0, np.array([0.0, y, -1.73])) for y in (8.1, -8.1)]
    street = merge([box.moved(side) for side in sides])
    sweep = scan([PlacedMesh(street, np.eye(4), twist_lidar)], EXACT, np.random.default_rng(0))
    T_world_then = [se3.invert(pose_after(twist_lidar, float(t))) for t in sweep.time[::41]]
    straight = np.array([T[:3, :3] @ p + T[:3, 3] for T, p in zip(T_world_then, sweep.points_lidar[::41], strict=True)])
    assert len(straight) > 300
    face = np.abs(straight[:, 0]) < 30.0
    np.testing.assert_allclose(np.abs(straight[face, 1]), 8.0, atol=1e-3)
    sheared = np.abs(np.abs(sweep.points_lidar[::41][face, 1]) - 8.0)
    assert sheared.max() > 0.1


def test_each_laser_keeps_its_range_offset_from_sweep_to_sweep():
    offsets = np.linspace(-0.03, 0.03, 64)
    model = dataclasses.replace(EXACT, range_offsets=offsets)
    for seed in (0, 1):
        sweep = sweep_of([wall(10.0, width=20.0)], model, seed)
        front = sweep.points_lidar[:, 0] < 10.09
        points, beam = sweep.points_lidar[front], sweep.beam_index[front]
        range_m = np.linalg.norm(points, axis=1)
        np.testing.assert_allclose(range_m - 10.0 * range_m / points[:, 0], offsets[beam], atol=1e-4)


def test_beams_start_at_their_height_on_the_axis():
    heights = np.linspace(0.0, 0.3, 64)
    sweep = sweep_of([wall(10.0)], dataclasses.replace(EXACT, beam_heights=heights))
    x, y, z = sweep.points_lidar.T
    slope = (z - heights[sweep.beam_index]) / np.hypot(x, y)
    np.testing.assert_allclose(np.arctan(slope), EXACT.elevations[sweep.beam_index], atol=1e-6)


@pytest.mark.parametrize("distance", [5.0, 60.0])
def test_the_papers_sensor_loses_nothing_and_shakes_each_coordinate(distance):
    pane = box_mesh(np.array([0.002, 6.0, 2.0]), Material.GLASS)
    T_lidar_obj = se3.from_yaw(0.0, np.array([distance, 0.0, -1.0]))
    sweep, exact = (
        scan([PlacedMesh(pane, T_lidar_obj)], model, np.random.default_rng(3))
        for model in (SYMMETRIC_64, dataclasses.replace(SYMMETRIC_64, jitter=None))
    )
    n_rows = (np.abs(np.tan(SYMMETRIC_64.elevations)) * distance < 1.0).sum()
    n_columns = 4500 * 2.0 * np.arctan2(3.0, distance) / (2.0 * np.pi)
    assert len(sweep.points_lidar) == pytest.approx(n_rows * n_columns, rel=0.05)
    noise = sweep.points_lidar - exact.points_lidar
    normal = np.random.default_rng(0).standard_normal(100_000)
    expected = np.clip(max(0.005, 0.05 * distance / 80.0) * normal, -0.05, 0.05).std()
    assert noise.std(axis=0) == pytest.approx(expected, rel=0.12)
    assert np.abs(noise).max() <= 0.05 + 1e-12
    again = scan([PlacedMesh(pane, T_lidar_obj)], SYMMETRIC_64, np.random.default_rng(4))
    assert len(again.points_lidar) == len(sweep.points_lidar)
