"""Bodies of all classes: their sizes, their skins, how they move, and that hundreds of them differ."""

import numpy as np
import pytest

from registration.errors import SimulationError
from registration.synthetic.bodies import CLASSES, Body, CyclingBody, WalkingBody, draw_body
from registration.synthetic.car_draws import draw_car, draw_car_shape
from registration.synthetic.car_kinds import CARS, VANS
from registration.synthetic.coaches import TRAILERS, draw_trailer
from registration.synthetic.limbs import joint
from registration.synthetic.meshes import Material
from registration.synthetic.persons import PersonLook, person
from registration.synthetic.riders import CyclistLook
from registration.synthetic.trucks import TRUCKS, draw_truck
from tests.mesh_checks import first_triangles, flat_triangles, open_edges, rays_that_see_an_inside, volume

ALL = pytest.mark.parametrize("class_name", CLASSES)
MOVING = ("Pedestrian", "Cyclist")

# Sizes that labels of KITTI have: a usual one, and the smallest and largest, cut-off objects among them.
LABEL_SIZES = {
    "Car": [(3.9, 1.62, 1.49), (2.19, 1.14, 1.22), (5.24, 2.04, 2.48)],
    "Van": [(4.94, 1.87, 2.04), (3.18, 1.52, 1.65), (6.91, 2.52, 3.5)],
    "Truck": [(9.3, 2.5, 3.34), (5.42, 2.06, 2.32), (16.44, 3.01, 4.2)],
    "Bus": [(11.0, 2.5, 3.1), (5.0, 2.0, 2.5), (18.0, 2.6, 3.4)],
    "Tram": [(12.75, 2.52, 3.64), (3.14, 2.17, 3.48), (35.24, 2.81, 3.71)],
    "Misc": [(2.47, 1.56, 2.12), (1.01, 0.53, 0.76), (12.6, 2.68, 3.91)],
    "Pedestrian": [(0.87, 0.68, 1.75), (0.2, 0.3, 1.18), (1.44, 1.06, 2.0)],
    "Cyclist": [(1.76, 0.6, 1.73), (1.32, 0.34, 1.41), (2.0, 0.93, 2.09)],
    "Person_sitting": [(0.71, 0.6, 1.27), (0.5, 0.48, 1.05), (1.33, 0.78, 1.39)],
    "Person": [(0.71, 0.6, 1.27)],
}


def drawn(class_name: str, seed: int = 0, size=None) -> Body:
    return draw_body(class_name, np.random.default_rng(seed), None if size is None else np.array(size))


@ALL
def test_every_class_has_a_body_with_a_closed_skin_that_faces_outwards(class_name):
    for seed in range(4):
        mesh = drawn(class_name, seed).mesh(0.3)
        assert open_edges(mesh) == 0
        assert flat_triangles(mesh) == 0
        assert 300 < len(mesh.triangles) < 8000
        lower, upper = mesh.bounds
        assert 0.03 < volume(mesh) / np.prod(upper - lower) < 1.0
        assert lower[2] == pytest.approx(0.0, abs=1e-9)


@ALL
def test_a_ray_from_outside_never_meets_the_inside_of_a_skin(class_name):
    for seed in range(3):
        n_hits, n_backs = rays_that_see_an_inside(drawn(class_name, seed).mesh(0.3))
        assert n_hits > 500
        assert n_backs <= 1e-4 * n_hits


@ALL
def test_the_same_seed_gives_the_same_body_and_another_seed_another(class_name):
    one, again, other = (drawn(class_name, seed).mesh(1.0) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.vertices, again.vertices)
    np.testing.assert_array_equal(one.material, again.material)
    assert one.vertices.shape != other.vertices.shape or np.abs(one.vertices - other.vertices).max() > 1e-3


@ALL
def test_a_body_of_a_given_size_has_exactly_that_size_and_stays_within_it(class_name):
    for seed, size in enumerate(LABEL_SIZES[class_name]):
        body = drawn(class_name, seed, size)
        np.testing.assert_array_equal(body.size, size)
        for distance in np.linspace(0.0, 1.3, 5):
            lower, upper = body.mesh(float(distance)).bounds
            half = 0.5 * np.array(size[:2])
            assert (lower >= [*-half - 1e-9, -1e-9]).all()
            assert (upper <= [*half + 1e-9, size[2] + 1e-9]).all()


@pytest.mark.parametrize("class_name", [name for name in CLASSES if name not in (*MOVING, "Person", "Person_sitting")])
def test_vehicles_fill_the_box_that_they_are_given(class_name):
    for seed, size in enumerate(LABEL_SIZES[class_name]):
        lower, upper = drawn(class_name, seed, size).mesh(0.0).bounds
        np.testing.assert_allclose(upper - lower, size, atol=1e-9)


@pytest.mark.parametrize("class_name", [*MOVING, "Person_sitting"])
def test_persons_are_as_tall_as_their_box(class_name):
    for seed, size in enumerate(LABEL_SIZES[class_name]):
        body = drawn(class_name, seed, size)
        heights = [body.mesh(float(way)).bounds[1][2] for way in np.linspace(0.0, 2.5, 12)]
        assert max(heights) == pytest.approx(size[2], rel=0.03)


def test_a_small_pedestrian_is_no_thin_copy_of_a_tall_one():
    child, grown_up = (drawn("Pedestrian", 3, (0.5 * h, 0.38 * h, h)).mesh(0.0) for h in (1.2, 1.8))
    np.testing.assert_allclose(grown_up.vertices, 1.5 * child.vertices, atol=1e-9)


def test_a_broad_box_does_not_make_a_person_broad():
    _, upper = drawn("Pedestrian", 2, (1.2, 1.4, 1.7)).mesh(0.0).bounds
    assert upper[1] < 0.45


@pytest.mark.parametrize("class_name", MOVING)
def test_limbs_move_with_the_way_and_come_back_after_a_cycle(class_name):
    body = drawn(class_name, 1, LABEL_SIZES[class_name][0])
    cycle = {
        "Pedestrian": lambda b: 0.82 * b.height * max(b.look.swing, 0.3),
        "Cyclist": lambda b: 4.9 * b.look.bicycle,
    }[class_name](body)
    start, halfway, end = (body.mesh(share * cycle).vertices for share in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(end, start, atol=1e-9)
    assert np.abs(halfway - start).max() > 0.1


def test_bodies_of_no_given_size_hold_all_their_phases():
    for body in (WalkingBody(1.7, 0.4, PersonLook(bag="backpack")), CyclingBody(CyclistLook(bag="pannier"))):
        for distance in np.linspace(0.0, 5.0, 9):
            lower, upper = body.mesh(float(distance)).bounds
            assert (np.maximum(-lower[:2], upper[:2]) <= 0.5 * body.size[:2] + 0.02).all()


def test_five_hundred_cars_differ_from_one_another_in_their_proportions():
    shapes = [draw_car_shape(CARS, np.random.default_rng(seed)) for seed in range(500)]
    measures = np.array([
        [getattr(s.shape, name) for name in ("length", "height", "hood_length", "windscreen_run", "belt_height")]
        for s in shapes
    ])  # fmt: skip
    distance = np.linalg.norm(measures[:, None] - measures[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    assert distance.min() > 1e-3
    assert {s.kind for s in shapes} == set(CARS)
    assert 3.3 <= measures[:, 0].min() < 3.6
    assert 4.9 < measures[:, 0].max() < 5.5


def test_the_kind_of_car_follows_from_its_size():
    def share(size, kinds):
        shapes = [draw_car_shape(CARS, np.random.default_rng(seed), np.array(size)) for seed in range(100)]
        return np.mean([s.kind in kinds for s in shapes])

    assert share((3.4, 1.6, 1.5), {"city car", "hatchback"}) > 0.98
    assert share((4.5, 1.85, 1.75), {"suv", "minivan", "pick-up"}) > 0.95
    assert share((4.6, 1.75, 1.42), {"sedan", "estate", "coupe", "hatchback"}) > 0.98
    assert share((4.3, 1.75, 1.3), {"coupe"}) > 0.5


@pytest.mark.parametrize("kind", [*CARS, *VANS])
def test_no_size_of_a_label_makes_a_car_impossible(kind):
    families = CARS if kind in CARS else VANS
    rng = np.random.default_rng(0)
    for seed in range(25):
        size = rng.uniform([2.1, 1.1, 1.2], [7.0, 2.6, 3.6])
        mesh = draw_car(families, np.random.default_rng(seed), size, kind)
        np.testing.assert_allclose(mesh.bounds[1] - mesh.bounds[0], size, atol=1e-9)


@pytest.mark.parametrize(("families", "kind"), [*((CARS, kind) for kind in CARS), *((VANS, kind) for kind in VANS)])
def test_nothing_of_a_cars_underside_shows_through_its_hood_or_roof(families, kind):
    for seed in range(8):
        mesh = draw_car(families, np.random.default_rng(seed), kind=kind)
        _, (x, y, height) = mesh.bounds
        grid = np.stack(np.meshgrid(np.linspace(-0.98 * x, 0.98 * x, 150), np.linspace(-0.5 * y, 0.5 * y, 9)), axis=-1)
        above = np.column_stack([grid.reshape(-1, 2), np.full(grid[..., 0].size, height + 1.0)])
        seen = first_triangles(mesh, above, np.array([0.0, 0.0, -1.0]))
        assert (seen >= 0).all()
        # What carries a box on the roof is metal too.
        low = mesh.vertices[mesh.triangles[seen], 2].max(axis=1) < 0.7 * height
        assert not (low & (mesh.material[seen] == Material.METAL)).any()


def test_a_pick_up_has_a_bed_that_is_open_above_and_lower_than_its_rim():
    mesh = draw_car(CARS, np.random.default_rng(1), kind="pick-up")
    _, upper = mesh.bounds
    behind = mesh.vertices[(mesh.vertices[:, 0] < -0.30 * 2 * upper[0]) & (mesh.vertices[:, 0] > -0.9 * upper[0])]
    middle = behind[np.abs(behind[:, 1]) < 0.05]
    assert middle[:, 2].max() < behind[:, 2].max() - 0.15


@pytest.mark.parametrize("kind", TRUCKS)
def test_trucks_of_every_kind_stand_on_tyres(kind):
    mesh = draw_truck(np.random.default_rng(2), kind=kind)
    lowest = mesh.vertices[mesh.triangles, 2].min(axis=1) < 1e-3
    assert set(mesh.material[lowest]) == {Material.RUBBER}
    assert (mesh.material == Material.GLASS).any()


def test_a_long_truck_pulls_a_trailer_and_a_short_one_does_not():
    wheels = [
        (draw_truck(np.random.default_rng(0), np.array([length, 2.5, 3.6])).material == Material.RUBBER).sum()
        for length in (6.5, 15.0)
    ]
    assert wheels[1] >= 2 * wheels[0]


@pytest.mark.parametrize("kind", TRAILERS)
def test_trailers_are_drawn_in_either_kind(kind):
    mesh = draw_trailer(np.random.default_rng(0), kind=kind)
    assert mesh.bounds[0][2] == pytest.approx(0.0, abs=1e-9)


def test_skirts_coats_and_bags_change_what_a_person_looks_like():
    plain = person(1.7, 0.8)
    for look in (PersonLook(clothes="skirt"), PersonLook(clothes="coat"), PersonLook(bag="backpack")):
        assert len(person(1.7, 0.8, look).triangles) > len(plain.triangles)


def test_a_joint_is_as_far_from_both_ends_as_the_bones_are_long():
    start, end = np.array([0.0, 0.0, 1.0]), np.array([0.3, 0.1, 0.4])
    knee = joint(start, end, 0.45, 0.42, np.array([1.0, 0.0, 0.0]))
    assert np.linalg.norm(knee - start) == pytest.approx(0.45)
    assert np.linalg.norm(knee - end) == pytest.approx(0.42)
    assert knee[0] > 0.15


def test_impossible_bodies_are_refused_with_the_reason():
    with pytest.raises(SimulationError, match="no class 'Cat'.*Available: Bus, Car"):
        drawn("Cat")
    with pytest.raises(SimulationError, match="length, width and height above 0 m, got"):
        drawn("Car", size=(4.0, 0.0, 1.5))
    with pytest.raises(SimulationError, match="above 0 m, got"):
        drawn("Pedestrian", size=(0.5, np.nan, 1.5))
    with pytest.raises(SimulationError, match="no kind of truck 'tanktruck'. Did you mean 'tank truck'"):
        draw_truck(np.random.default_rng(0), kind="tanktruck")
    with pytest.raises(SimulationError, match="no kind of car 'sedna'. Did you mean 'sedan'"):
        draw_car(CARS, np.random.default_rng(0), kind="sedna")
    with pytest.raises(SimulationError, match="no kind of trailer 'tent'"):
        draw_trailer(np.random.default_rng(0), kind="tent")
    with pytest.raises(SimulationError, match="wears one of trousers, skirt, coat"):
        PersonLook(clothes="toga")
    with pytest.raises(SimulationError, match=r"0\.8 to 2\.4 m tall on a bicycle"):
        CyclistLook(height=3.0)
