"""Meshes, the car of given measures and the walking person."""

import dataclasses

import numpy as np
import pytest

from registration import se3
from registration.errors import SimulationError
from registration.synthetic.cars import HATCHBACK, SEDAN, SUV, VAN, CarTrim, car, resized, varied
from registration.synthetic.meshes import Material, Mesh, box_mesh, cylinder, ellipsoid, loft, merge
from registration.synthetic.persons import STRIDE_PER_HEIGHT, person, person_size
from tests.mesh_checks import open_edges, volume

SHAPES = pytest.mark.parametrize("shape", [SEDAN, HATCHBACK, SUV, VAN], ids=["sedan", "hatchback", "suv", "van"])


def test_a_box_has_the_volume_of_its_sides_and_stands_on_the_ground():
    mesh = box_mesh(np.array([2.0, 3.0, 4.0]), Material.MASONRY)
    assert volume(mesh) == pytest.approx(2 * 3 * 4)
    np.testing.assert_allclose(mesh.bounds, [[-1.0, -1.5, 0.0], [1.0, 1.5, 4.0]])


def test_round_primitives_approach_their_textbook_volumes():
    assert volume(cylinder(0.5, 2.0, Material.METAL, n_sides=200)) == pytest.approx(np.pi * 0.25 * 2.0, rel=1e-3)
    ball = ellipsoid(np.array([5.0, 0.0, 1.0]), np.array([1.0, 2.0, 3.0]), Material.SKIN, n_sides=200)
    assert volume(ball) == pytest.approx(4 / 3 * np.pi * 1 * 2 * 3, rel=1e-3)


@SHAPES
def test_a_car_has_no_holes_in_its_skin_and_no_triangle_that_faces_inwards(shape):
    mesh = car(shape)
    assert open_edges(mesh) == 0
    assert 0.3 < volume(mesh) / (shape.length * shape.width * shape.height) < 0.95
    corners = mesh.vertices[mesh.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert (areas > 1e-9).mean() > 0.99


@SHAPES
def test_a_cars_box_is_exactly_what_its_shape_says_and_centred_on_the_ground(shape):
    half = 0.5 * np.array([shape.length, shape.width])
    expected = [[*-half, 0.0], [*half, shape.height]]
    np.testing.assert_allclose(car(shape).bounds, expected, atol=1e-9)


@SHAPES
def test_a_car_is_the_same_on_both_sides(shape):
    vertices = car(shape).vertices
    mirrored = vertices * [1.0, -1.0, 1.0]
    np.testing.assert_allclose(np.unique(vertices.round(6), axis=0), np.unique(mirrored.round(6) + 0.0, axis=0))


@SHAPES
def test_windows_are_above_the_belt_and_tyres_touch_the_ground(shape):
    mesh = car(shape)
    heights = mesh.vertices[mesh.triangles, 2]
    glass = mesh.material == Material.GLASS
    assert 0.03 < glass.mean() < 0.3
    assert heights[glass].min() > 0.8 * shape.belt_height
    assert heights[mesh.material == Material.RUBBER].min() == pytest.approx(0.0, abs=1e-9)


def test_a_panel_van_has_fewer_windows_than_one_for_passengers():
    with_windows = car(dataclasses.replace(VAN, has_rear_windows=True))
    assert (car(VAN).material == Material.GLASS).sum() < (with_windows.material == Material.GLASS).sum()


@SHAPES
def test_varied_cars_are_possible_different_and_the_same_for_the_same_seed(shape):
    drawn = [varied(shape, np.random.default_rng(seed)) for seed in range(200)]
    assert len({other.length for other in drawn}) == 200
    assert np.std([other.length / shape.length for other in drawn]) == pytest.approx(0.033, abs=0.012)
    assert drawn[3] == varied(shape, np.random.default_rng(3))


def test_impossible_cars_are_refused_with_the_reason():
    with pytest.raises(SimulationError, match=r"roof of at least 0\.3 m, this one has -"):
        dataclasses.replace(SEDAN, hood_length=3.5)
    with pytest.raises(SimulationError, match="rear wheels of a car must be within its length"):
        dataclasses.replace(SEDAN, wheelbase=3.6)
    with pytest.raises(SimulationError, match="clearance < belt_height < height"):
        dataclasses.replace(SEDAN, belt_height=1.6)
    with pytest.raises(SimulationError, match="bed of a pick-up must be above the wheel arches"):
        dataclasses.replace(SEDAN, bed_depth=0.6)


def test_a_resized_car_has_the_new_size_and_round_wheels():
    size = np.array([4.0, 1.7, 1.6])
    shape = resized(SEDAN, size)
    mesh = car(shape)
    np.testing.assert_allclose(mesh.bounds, [[-2.0, -0.85, 0.0], [2.0, 0.85, 1.6]], atol=1e-9)
    assert shape.wheel_radius == pytest.approx(SEDAN.wheel_radius * 4.0 / SEDAN.length)
    assert shape.hood_length / SEDAN.hood_length == pytest.approx(4.0 / SEDAN.length)


def test_what_stands_on_a_roof_is_part_of_the_height_and_mirrors_of_the_width():
    trim = CarTrim(has_mirrors=True, has_cladding=True, rail_height=0.05, box_height=0.4)
    mesh = car(dataclasses.replace(SEDAN, height=1.85), trim=trim)
    np.testing.assert_allclose(mesh.bounds[1], [2.31, 0.90, 1.85], atol=1e-9)
    assert open_edges(mesh) == 0
    assert len(mesh.triangles) > len(car(SEDAN).triangles)


@pytest.mark.parametrize("phase", np.linspace(0.0, 2.0 * np.pi, 7, endpoint=False))
def test_a_walking_person_stands_on_the_ground_within_the_box_of_all_phases(phase):
    lower, upper = person(1.75, phase).bounds
    size = person_size(1.75)
    assert lower[2] == pytest.approx(0.0, abs=1e-9)
    assert 1.6 < upper[2] <= size[2] + 0.01
    assert (upper[:2] <= 0.5 * size[:2] + 0.02).all()
    assert (lower[:2] >= -0.5 * size[:2] - 0.02).all()


def test_legs_and_arms_swap_sides_after_half_a_cycle():
    mesh, half_a_cycle_later = person(1.75, 0.7), person(1.75, 0.7 + np.pi)
    mirrored = half_a_cycle_later.vertices * [1.0, -1.0, 1.0]
    np.testing.assert_allclose(np.sort(mesh.vertices[:, 0]), np.sort(mirrored[:, 0]), atol=1e-9)
    assert np.abs(mesh.vertices - half_a_cycle_later.vertices).max() > 0.3


def test_a_stride_is_as_long_as_the_legs_reach():
    feet = [person(1.75, phase).vertices[:, 0] for phase in (0.5 * np.pi, 1.5 * np.pi)]
    reach = max(foot.max() - foot.min() for foot in feet)
    assert 0.4 * STRIDE_PER_HEIGHT * 1.75 < reach < STRIDE_PER_HEIGHT * 1.75


def test_nobody_is_ten_metres_tall():
    with pytest.raises(SimulationError, match=r"between 0\.5 and 2\.5 m tall, got 10"):
        person(10.0)


def test_merging_and_moving_keep_every_triangles_shape_and_material():
    parts = [box_mesh(np.array([1.0, 1.0, 1.0]), Material.GLASS), cylinder(1.0, 1.0, Material.RUBBER)]
    T_world_obj = se3.from_yaw(0.7, np.array([3.0, 4.0, 5.0]))
    merged = merge(parts).moved(T_world_obj)
    expected = [se3.transform(T_world_obj, part.vertices)[part.triangles] for part in parts]
    np.testing.assert_allclose(merged.vertices[merged.triangles], np.concatenate(expected))
    assert merged.material.tolist() == [Material.GLASS] * 12 + [Material.RUBBER] * (len(merged.triangles) - 12)
    assert len(merge([]).triangles) == 0


def test_broken_meshes_are_refused_with_the_reason():
    corners, triangle, paint = np.eye(3), np.array([[0, 1, 2]]), np.array([2])
    with pytest.raises(SimulationError, match=r"vertex outside 0\.\.2"):
        Mesh(corners, triangle + 1, paint)
    with pytest.raises(SimulationError, match="finite vertices"):
        Mesh(corners * np.nan, triangle, paint)
    with pytest.raises(SimulationError, match="at least 2 rings of 3 points, got 1 of 3"):
        loft(corners[None], 2)
