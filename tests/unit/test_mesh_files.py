"""Meshes from files and folders, and how meshes are divided into parts."""

import struct
from pathlib import Path

import numpy as np
import pytest

from registration.errors import SimulationError
from registration.synthetic.library import FolderSource, MeshSource, ParametricSource
from registration.synthetic.mesh_files import find_meshes, read_mesh
from registration.synthetic.mesh_splits import N_SHAPES, PARTS, modelnet_numbers, seed_range
from registration.synthetic.meshes import Material, Mesh, normalised

CORNERS = np.array([[1.0, 2.0, 3.0], [5.0, 2.0, 3.0], [1.0, 4.0, 3.0], [1.0, 2.0, 4.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def rows(array: np.ndarray, start: str = "") -> str:
    return "".join(start + " ".join(str(x) for x in row) + "\n" for row in array.tolist())


def off(corners=CORNERS, faces=FACES, first_line="OFF\n{n} {m} 0\n") -> str:
    return first_line.format(n=len(corners), m=len(faces)) + rows(corners) + rows(faces, "3 ")


def ply(corners=CORNERS, faces=FACES) -> str:
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\n{axes}"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    return head + rows(corners) + rows(faces, "3 ")


def obj() -> str:
    return rows(CORNERS, "v ") + rows(FACES + 1, "f ")


def stl() -> bytes:
    triangles = (struct.pack("<12fH", 0, 0, 0, *CORNERS[face].ravel(), 0) for face in FACES)
    return b"\0" * 80 + struct.pack("<I", len(FACES)) + b"".join(triangles)


def write(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def corners_of(mesh: Mesh) -> np.ndarray:
    """Corners of all triangles, in an order that does not depend on the file's."""
    corners = np.sort(mesh.vertices[mesh.triangles].round(5).view("f8,f8,f8"), axis=1).view(float).reshape(-1, 9)
    return corners[np.lexsort(corners.T)]


@pytest.mark.parametrize(("name", "content"), [("m.off", off()), ("m.ply", ply()), ("m.obj", obj()), ("m.STL", stl())])
def test_every_format_gives_the_triangles_that_were_written(tmp_path, name, content):
    mesh = read_mesh(write(tmp_path / name, content), Material.CLOTH)
    np.testing.assert_allclose(corners_of(mesh), corners_of(Mesh(CORNERS, FACES, np.zeros(4, dtype=np.int64))))
    assert mesh.material.tolist() == 4 * [Material.CLOTH]


@pytest.mark.parametrize("first_line", ["OFF{n} {m} 0\n", "OFF {n} {m} 0\n", "OFF{n} {m} 0\r\n"])
def test_the_glued_first_line_of_modelnet_is_read(tmp_path, first_line):
    mesh = read_mesh(write(tmp_path / "car_0001.off", off(first_line=first_line)))
    np.testing.assert_allclose(mesh.bounds, [[1.0, 2.0, 3.0], [5.0, 4.0, 4.0]])


def test_a_vertex_of_no_triangle_does_not_enlarge_the_box(tmp_path):
    stray = np.vstack([CORNERS, [100.0, 100.0, 100.0]])
    assert read_mesh(write(tmp_path / "m.off", off(stray))).bounds[1].max() == 5.0


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("m.off", "", "broken or has none"),
        ("m.off", "OFF\n4 0 0\n" + rows(CORNERS), "broken or has none"),
        ("m.ply", ply()[:120], "broken or has none"),
        ("m.ply", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "broken or has none"),
        ("m.obj", "# nothing\n", "broken or has none"),
        ("m.stl", stl()[:90], "broken or has none"),
        ("m.ply", ply(CORNERS * [1.0, np.nan, 1.0]), "finite vertices, got"),
        ("m.obj", obj() + "f 1 2 9\n", "names vertex 8, the file has 4 vertices|broken"),
        ("m.txt", off(), r"a mesh is one of \.obj, \.off, \.ply, \.stl, got \.txt"),
    ],
)
def test_a_broken_file_is_refused_by_name_and_with_the_reason(tmp_path, name, content, reason):
    path = write(tmp_path / name, content)
    with pytest.raises(SimulationError, match=reason) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)


def test_a_file_or_folder_that_is_not_there_or_empty_is_refused(tmp_path):
    with pytest.raises(SimulationError, match=r"nowhere\.ply: no such mesh file"):
        read_mesh(tmp_path / "nowhere.ply")
    with pytest.raises(SimulationError, match="nowhere: no such folder of meshes"):
        FolderSource(tmp_path / "nowhere")
    write(tmp_path / "notes.txt", "no mesh")
    with pytest.raises(SimulationError, match="no mesh in this folder"):
        FolderSource(tmp_path)


def test_a_normalised_mesh_is_centred_and_its_longest_side_is_one(tmp_path):
    mesh = normalised(read_mesh(write(tmp_path / "m.off", off())))
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -0.25, -0.125], [0.5, 0.25, 0.125]])
    with pytest.raises(SimulationError, match="no extent"):
        normalised(Mesh(np.ones((3, 3)), np.array([[0, 1, 2]]), np.zeros(1, dtype=np.int64)))


def test_modelnets_numbers_are_divided_as_the_paper_did_and_the_held_out_ones_by_halves():
    cars = modelnet_numbers("car", range(1, 298))
    assert len(cars["train"]) == 53 - 3
    assert not {21, 31, 46} & set(cars["train"])
    assert cars["val"] + cars["test"] == tuple(range(54, 104))
    assert len(cars["val"]) == len(cars["test"]) == 25
    persons = modelnet_numbers("person", range(1, 109))
    assert persons["train"] == tuple(range(1, 41))
    assert persons["val"] + persons["test"] == tuple(range(54, 94))
    chairs = modelnet_numbers("chair", range(1, 990))
    assert chairs["train"] == tuple(range(1, 21))
    assert chairs["val"] + chairs["test"] == tuple(range(21, 41))


def modelnet(folder: Path) -> FolderSource:
    for number in range(1, 46):
        part = "train" if number <= 30 else "test"
        for category in ("car", "night_stand"):
            shifted = off(CORNERS + number, first_line="OFF{n} {m} 0\n")
            write(folder / category / part / f"{category}_{number:04d}.off", shifted)
    for number in range(46, 60):
        write(folder / "car" / "test" / f"car_{number:04d}.off", off(CORNERS + number))
    return FolderSource(folder)


def test_modelnets_layout_gives_every_part_its_own_meshes(tmp_path):
    source = modelnet(tmp_path)
    assert isinstance(source, MeshSource)
    assert source.categories == ("car", "night_stand")
    numbers = {part: [file.number for file in source.files("night_stand", part)] for part in PARTS}
    assert numbers == {"train": list(range(1, 21)), "val": list(range(21, 31)), "test": list(range(31, 41))}
    assert [file.number for file in source.files("car", "val")] == [54, 55, 56]
    drawn = {source.draw("car", "val", np.random.default_rng(seed)).bounds[0][0] - 1.0 for seed in range(30)}
    assert drawn == {54.0, 55.0, 56.0}
    described = source.describe()
    assert described["layout"] == "ModelNet40"
    assert described["n_meshes"]["car"] == {"train": 53 - 3, "val": 3, "test": 3}


def flat(folder: Path) -> FolderSource:
    names = [f"vehicle_{name}.ply" for name in "abcdef"] + [f"person_{i:02d}_child.ply" for i in range(11)]
    for name in [*names, "bollard.ply"]:
        write(folder / name, ply())
    return FolderSource(folder)


def test_a_flat_folder_is_divided_by_names_alone_and_no_file_is_in_two_parts(tmp_path):
    source = flat(tmp_path / "here")
    assert source.categories == ("bollard", "car", "person")
    counts = {c: [len(source.files(c, part)) for part in PARTS] for c in source.categories}
    assert counts == {"bollard": [1, 0, 0], "car": [4, 1, 1], "person": [7, 2, 2]}
    everything = [file.path for c in source.categories for part in PARTS for file in source.files(c, part)]
    assert sorted(everything) == sorted((tmp_path / "here").iterdir())
    elsewhere = flat(tmp_path / "elsewhere")
    for part in PARTS:
        assert [f.path.name for f in source.files("car", part)] == [f.path.name for f in elsewhere.files("car", part)]
    assert source.draw("person", "test", np.random.default_rng(0)).material[0] == Material.CLOTH
    assert source.describe()["digest"] == elsewhere.describe()["digest"]


def test_asking_a_folder_for_what_it_does_not_have_says_what_it_has(tmp_path):
    source, rng = flat(tmp_path), np.random.default_rng(0)
    with pytest.raises(SimulationError, match="no category of meshes 'cat'.*Available: bollard, car, person"):
        source.draw("cat", "train", rng)
    with pytest.raises(SimulationError, match="no part of the meshes 'valid'. Did you mean 'val'"):
        source.draw("car", "valid", rng)
    with pytest.raises(SimulationError, match="no mesh of 'bollard' is left for 'test'"):
        source.draw("bollard", "test", rng)


def test_two_files_of_one_number_are_refused(tmp_path):
    write(tmp_path / "car" / "train" / "car_0001.off", off())
    write(tmp_path / "car" / "test" / "car_0001.off", off())
    with pytest.raises(SimulationError, match="has the same number as"):
        FolderSource(tmp_path)


def test_folders_named_like_their_category_are_known(tmp_path):
    for name in "abc":
        write(tmp_path / "cars" / f"{name}.obj", obj())
    assert {file.category for file in find_meshes(tmp_path)} == {"car"}


def test_parametric_families_have_hundreds_of_members_and_no_seed_in_two_parts():
    ranges = [seed_range(part) for part in PARTS]
    assert [len(r) for r in ranges] == [N_SHAPES[part] for part in PARTS] == [1000, 200, 200]
    assert len(set().union(*ranges)) == sum(len(r) for r in ranges)


def test_members_of_two_parts_are_different_meshes():
    source = ParametricSource()
    boxes = {
        part: {tuple(source.member("car", number).bounds[1]) for number in list(seed_range(part))[:60]}
        for part in PARTS
    }
    assert all(len(these) == 60 for these in boxes.values())
    assert not boxes["train"] & boxes["val"]
    assert not boxes["train"] & boxes["test"]
    assert not boxes["val"] & boxes["test"]


def test_a_number_means_the_same_mesh_as_in_the_sets_that_were_made():
    """Where this fails on purpose, raise `FAMILY_VERSION`: old sets cannot be made again."""
    source = ParametricSource()
    np.testing.assert_allclose(source.member("car", 0).bounds[1], [2.154824, 0.914229, 1.302737], atol=1e-6)
    np.testing.assert_allclose(source.member("person", 0).bounds[1], [0.580364, 0.289647, 1.801275], atol=1e-6)
    assert source.describe()["version"] == 1


@pytest.mark.parametrize("category", ParametricSource().categories)
def test_every_family_draws_the_same_mesh_for_the_same_seed(category):
    source = ParametricSource()
    assert isinstance(source, MeshSource)
    one, again, other = (source.draw(category, "train", np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.vertices, again.vertices)
    assert one.vertices.shape != other.vertices.shape or not np.array_equal(one.vertices, other.vertices)


def test_the_parametric_source_describes_itself_and_knows_its_limits():
    source, rng = ParametricSource(), np.random.default_rng(0)
    assert {"car", "person"} <= set(source.categories)
    assert list(source.categories) == sorted(source.categories)
    assert source.describe()["seeds"] == {"train": [0, 1000], "val": [1000, 1200], "test": [1200, 1400]}
    with pytest.raises(SimulationError, match="no family of meshes 'cat'"):
        source.draw("cat", "train", rng)
    with pytest.raises(SimulationError, match="no part of the meshes"):
        source.draw("car", "holdout", rng)
