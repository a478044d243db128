"""The beam model, and sweeps over simple scenes whose answers are known."""

import dataclasses

import numpy as np
import pytest

from registration import se3
from registration.errors import SimulationError
from registration.synthetic.cars import SEDAN, car
from registration.synthetic.lidar import GROUND, HDL_64E, BeamModel, PlacedMesh, level_ground, ray_directions, scan
from registration.synthetic.meshes import Material, box_mesh

EXACT = dataclasses.replace(HDL_64E, range_noise=0.0, misfire=0.0, azimuth_step=np.deg2rad(0.5))
COARSE = dataclasses.replace(HDL_64E, azimuth_step=np.deg2rad(0.5))


def wall(distance: float, material: Material = Material.MASONRY, width: float = 4.0):
    """Place a wall whose face is the plane x = distance, from the ground up to 3 m, facing the sensor."""
    mesh = box_mesh(np.array([0.2, width, 3.0]), material)
    return mesh, se3.from_yaw(0.0, np.array([distance + 0.1, 0.0, -1.73]))


def sweep_of(objects, beam_model=COARSE, seed=0, ground=None):
    return scan([PlacedMesh(*placed) for placed in objects], beam_model, np.random.default_rng(seed), ground)


def test_the_hdl_64e_has_two_blocks_of_32_beams():
    elevations_deg = np.rad2deg(HDL_64E.elevations)
    assert elevations_deg[[0, 31, 32, 63]] == pytest.approx([2.0, -8.33, -8.83, -24.33], abs=0.01)
    np.testing.assert_allclose(np.diff(elevations_deg[:32]), -1 / 3)
    np.testing.assert_allclose(np.diff(elevations_deg[32:]), -1 / 2)
    assert HDL_64E.n_azimuths == 2083


def test_rays_leave_at_the_beams_elevations_and_cover_the_circle_evenly():
    directions = ray_directions(HDL_64E, phase=0.001).reshape(64, 2083, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(np.arcsin(directions[:, 7, 2]), HDL_64E.elevations)
    azimuth = np.unwrap(np.arctan2(directions[40, :, 1], directions[40, :, 0]))
    np.testing.assert_allclose(azimuth, 0.001 + 2 * np.pi * np.arange(2083) / 2083)


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
    assert noise.std() == pytest.approx(HDL_64E.range_noise, rel=0.1)
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
    first, again, other = (sweep_of(objects, seed=seed, ground=level_ground(COARSE)) for seed in (7, 7, 8))
    for name in ("points_lidar", "intensity", "object_index"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.points_lidar.tobytes() != other.points_lidar.tobytes()


def test_a_return_keeps_its_noise_when_something_else_enters_the_scene():
    alone = sweep_of([wall(10.0)])
    joined = sweep_of([wall(10.0), (wall(10.0)[0], se3.from_yaw(np.pi, np.array([-10.0, 0.0, -1.73])))])
    np.testing.assert_array_equal(joined.points_lidar[joined.object_index == 0], alone.points_lidar)


def test_an_empty_world_returns_nothing():
    sweep = sweep_of([])
    assert sweep.points_lidar.shape == (0, 3)
    assert len(sweep.object_index) == 0


def test_impossible_sensors_are_refused_with_the_reason():
    with pytest.raises(SimulationError, match="at least one beam"):
        BeamModel("blind", np.zeros(0), 0.01)
    with pytest.raises(SimulationError, match="min_range < max_range"):
        BeamModel("short", np.zeros(1), 0.01, min_range=5.0, max_range=4.0)
