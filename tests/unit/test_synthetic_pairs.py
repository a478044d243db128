"""The synthetic sets of pairs: what is drawn, what is true of it, and which meshes it is made of."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from registration import planar, se3
from registration.errors import PairSetError, SimulationError
from registration.synthetic.aim import beams_towards
from registration.synthetic.catalogue import create_recipe
from registration.synthetic.lidar import HDL_64E, SYMMETRIC_64, PlacedMesh, scan
from registration.synthetic.meshes import Mesh, normalised
from registration.synthetic.pairs import Kind, draw_poses
from registration.synthetic.production import Order, make_pair, make_pair_set
from tests.pair_recipes import Boxes, synth

EXACT_64 = replace(SYMMETRIC_64, jitter=None, range_noise=0.0, misfire=0.0)
CLEAN_HDL = replace(HDL_64E, range_noise=0.0)


def test_poses_have_the_papers_ranges_and_fill_them():
    rng = np.random.default_rng(0)
    poses = [draw_poses(rng) for _ in range(4000)]
    start, end = (np.array([pair[k][:3, 3] for pair in poses]) for k in (0, 1))
    radius, shift = np.hypot(*start[:, :2].T), np.hypot(*(end - start)[:, :2].T)
    turn = np.array([planar.wrap(se3.yaw(b) - se3.yaw(a)) for a, b in poses])
    headings = np.array([se3.yaw(a) for a, _ in poses])
    assert start[:, 2].tolist() == end[:, 2].tolist() == [0.0] * 4000  # at the sensor's height
    for values, low, high in (
        (radius, 2.0, 80.0),
        (shift, 0.0, 1.0),
        (turn, -0.5 * np.pi, 0.5 * np.pi),
        (headings, -np.pi, np.pi),
        (np.arctan2(start[:, 1], start[:, 0]), -np.pi, np.pi),
    ):
        assert low <= values.min() < values.max() <= high
        # uniform: quartiles where they belong, within four standard errors of 4000 draws
        expected = low + np.array([0.25, 0.5, 0.75]) * (high - low)
        np.testing.assert_allclose(np.quantile(values, [0.25, 0.5, 0.75]), expected, atol=0.032 * (high - low))
    assert np.mean(radius < 20.0) == pytest.approx(18.0 / 78.0, abs=0.03)  # 231 of 1000 in the published table


def test_a_mesh_is_centred_by_its_box_and_scaled_by_its_longest_side():
    mesh = normalised(Boxes().draw("car", "train", np.random.default_rng(0)), 3.5)
    lower, upper = mesh.bounds
    np.testing.assert_allclose(lower, -upper, atol=1e-12)
    assert (upper - lower).max() == pytest.approx(3.5)


def test_a_mesh_of_no_extent_is_refused():
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros(1, dtype=np.int64))
    with pytest.raises(SimulationError, match="no extent"):
        normalised(flat, 2.0)


def test_the_true_motion_carries_the_first_noiseless_cloud_onto_the_object_at_the_second_pose():
    scenes = synth(EXACT_64)
    for index in range(12):
        pair = make_pair(scenes, 3, "train", index)
        moved = se3.transform(pair.T_target_source, pair.source)
        T_end_lidar = se3.invert(se3.from_yaw(pair.end_angle, pair.end_position))
        on_box = se3.transform(T_end_lidar, moved)
        target_on_box = se3.transform(T_end_lidar, pair.target)
        half = np.maximum(np.abs(on_box).max(axis=0), np.abs(target_on_box).max(axis=0))
        assert half.max() <= 0.5 * pair.extra["mesh_scale"] + 1e-4
        # every point lies on a face of the box, whose half sides are those of the mesh
        mesh = redrawn_mesh(scenes, 3, index)
        faces = np.abs(np.abs(on_box) - 0.5 * np.ptp(mesh.vertices, axis=0)).min(axis=1)
        assert faces.max() < 1e-4


def redrawn_mesh(scenes, seed, index):
    """Draw a pair's mesh again, up to the redraw that was kept."""
    pair = make_pair(scenes, seed, "train", index)
    meshes = []

    @dataclass(frozen=True)
    class Spy(Boxes):
        def draw(self, category, part, rng):
            meshes.append(super().draw(category, part, rng))
            return meshes[-1]

    make_pair(replace(scenes, meshes=Spy()), seed, "train", index)
    return normalised(meshes[-1], pair.extra["mesh_scale"])


def test_no_cloud_is_empty_and_noise_is_the_papers():
    pairs = [make_pair(synth(), 0, "val", index) for index in range(40)]
    assert min(min(len(p.source), len(p.target)) for p in pairs) > 0
    assert {p.extra["cat"] for p in pairs} == {"car", "person"}
    near = [p for p in pairs if np.linalg.norm(p.start_position) < 40.0]
    far = [p for p in pairs if np.linalg.norm(p.start_position) > 40.0]
    assert np.median([len(p.source) for p in near]) > 5 * np.median([len(p.source) for p in far])
    for p in pairs:
        half = 0.5 * p.extra["mesh_scale"]
        reach = np.abs(se3.transform(se3.invert(se3.from_yaw(p.start_angle, p.start_position)), p.source)).max()
        assert reach <= half + np.sqrt(2.0) * 0.05 + 1e-6  # noise is cut off at 5 cm an axis


def test_clouds_may_be_empty_only_where_the_set_says_so():
    coarse = replace(SYMMETRIC_64, elevations=np.deg2rad([-1.0, 1.0]), azimuth_step=np.deg2rad(0.5))
    scenes = synth(coarse, allow_empty=True)
    pairs = [make_pair(scenes, 0, "train", index) for index in range(20)]
    assert any(len(p.source) == 0 for p in pairs)
    full = [make_pair(replace(scenes, allow_empty=False), 0, "train", index) for index in range(20)]
    assert all(len(p.source) and len(p.target) for p in full)
    assert sum(p.extra["redraws"] for p in full) > 0


def test_the_sensor_is_never_inside_the_object():
    scenes = synth(radius=(2.0, 2.2), kinds=(Kind(("car",), (4.3, 4.5)),))
    found = [scenes.draw("train", np.random.default_rng(seed)) for seed in range(12)]
    assert any(pair is None for pair in found)
    for pair in filter(None, found):
        for center, yaw, cloud in (
            (pair.start_position, pair.start_angle, pair.source),
            (pair.end_position, pair.end_angle, pair.target),
        ):
            sensor = se3.invert(se3.from_yaw(yaw, center))[:3, 3]
            assert np.abs(sensor).max() > 0.15 * pair.extra["mesh_scale"]
            assert len(cloud) > 0


def test_only_beams_that_can_meet_the_object_are_fired_and_none_is_missed():
    mesh = normalised(Boxes().draw("car", "train", np.random.default_rng(1)), 4.0)
    for model in (EXACT_64, CLEAN_HDL):
        for distance in (8.0, 12.0, 50.0):
            T = se3.from_yaw(0.6, np.array([distance, 1.0, -0.4]))
            sensor = beams_towards(model, T, np.ptp(mesh.vertices, axis=0))
            assert len(sensor.elevations) < len(model.elevations)
            everything, aimed = (scan([PlacedMesh(mesh, T)], m, np.random.default_rng(0)) for m in (model, sensor))
            hit = set(np.round(model.elevations[everything.beam_index], 9))
            assert hit <= set(np.round(sensor.elevations, 9))
            assert len(aimed.points_lidar) == pytest.approx(len(everything.points_lidar), rel=0.15, abs=8)


CUBE = """OFF
8 12 0
0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1
3 0 2 1\n3 0 3 2\n3 4 5 6\n3 4 6 7\n3 0 1 5\n3 0 5 4\n3 1 2 6\n3 1 6 5\n3 2 3 7\n3 2 7 6\n3 3 0 4\n3 3 4 7
"""


@pytest.fixture
def cubes(tmp_path):
    """A folder of five categories with six meshes each."""
    for category in ("airplane", "bed", "car", "person", "vase"):
        (tmp_path / "meshes" / category).mkdir(parents=True)
        for k in range(6):
            (tmp_path / "meshes" / category / f"{category}_{k}.off").write_text(CUBE)
    return tmp_path / "meshes"


def test_sets_of_twenty_share_the_categories_without_a_common_one(cubes):
    first, others = (create_recipe(name, cubes).kinds[0].categories for name in ("synth-20", "synth-20-others"))
    assert (first, others) == (("airplane", "bed", "car"), ("person", "vase"))
    own, own_others = (create_recipe(name).kinds[0].categories for name in ("synth-20", "synth-20-others"))
    assert own
    assert own_others
    assert not {*own} & {*own_others}


def test_a_set_says_which_meshes_it_is_made_of(cubes, tmp_path):
    make_pair_set(Order(create_recipe("synth-20-others", cubes), counts=(2, 1, 1)), tmp_path / "set")
    about = json.loads((tmp_path / "set" / "about.json").read_text())
    assert about["meshes"]["source"] == "folder"
    assert about["kinds"][0]["categories"] == ["person", "vase"]
    assert "parametric" in create_recipe("synth-20").describe()["meshes"]["source"]


def test_cars_and_persons_have_their_shares_and_scales(cubes):
    cars, persons = create_recipe("synth-cars-persons", cubes).kinds
    assert (cars.categories, cars.scale, cars.share) == (("car",), (2.5, 4.5), 0.8)
    assert (persons.categories, persons.scale, persons.share) == (("person",), (1.6, 2.0), 0.2)
    assert create_recipe("synth-20").kinds[0].scale == (1.0, 5.0)


def test_a_broken_mesh_file_an_empty_folder_and_missing_categories_are_refused_before_anything_is_written(
    cubes, tmp_path
):
    out = tmp_path / "out" / "set"
    (cubes / "car" / "car_3.off").write_text(CUBE[:60])
    with pytest.raises(SimulationError, match=r"car_3\.off"):
        make_pair_set(Order(create_recipe("synth-cars", cubes), counts=(1, 1, 1)), out)
    for k in range(1, 6):
        (cubes / "person" / f"person_{k}.off").unlink()
    with pytest.raises(SimulationError, match=r"no mesh of 'person' is left for 'val'"):
        make_pair_set(Order(create_recipe("synth-20-others", cubes), counts=(1, 1, 1)), out)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SimulationError, match="no mesh in this folder"):
        create_recipe("synth-cars", tmp_path / "empty")
    with pytest.raises(PairSetError, match="synth-cars needs meshes of the category car, got bed"):
        create_recipe("synth-cars", cubes / "bed")
    assert not out.parent.exists()
