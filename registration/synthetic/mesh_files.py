"""Meshes from files: one file as a `Mesh`, and a folder of them as lists by category."""

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from registration.errors import SimulationError
from registration.libraries import load_open3d
from registration.synthetic.meshes import Material, Mesh

SUFFIXES = (".obj", ".off", ".ply", ".stl")

# What flat folders call the categories that the data sets know.
_ALIASES = {"vehicle": "car", "cars": "car", "persons": "person", "pedestrian": "person"}
_IN_CLOTHES = ("person", "cyclist", "sitting_person")
_NUMBER = re.compile(r"(\d+)$")


@dataclass(frozen=True)
class MeshFile:
    """A mesh file and what its place and name say.

    Attributes:
        path: of the file.
        category: what it shows, as `car`.
        number: at the end of its name, as 12 in `car_0012.off`; None without one.
    """

    path: Path
    category: str
    number: int | None


def read_mesh(path: Path, material: Material = Material.PAINT_SILVER) -> Mesh:
    """Read a .ply, .obj, .off or .stl file.

    Vertices stay where they are, in the file's own axes and units; those that no triangle names are dropped, so that
    the bounding box is that of the surface.  Faces of more than three corners are divided.  Files of ModelNet40
    whose first line runs into the second (`OFF1234 567 0`) are read too.

    Args:
        path: of the file.
        material: of all triangles: files do not say what is glass.

    Raises:
        SimulationError: the file cannot be read, is of no known kind, holds no triangle, or has a vertex that
            is not finite; the message names it.
        MissingLibraryError: Open3D cannot be imported.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise SimulationError(f"{path}: a mesh is one of {', '.join(SUFFIXES)}, got {path.suffix or 'no suffix'}")
    if not path.is_file():
        raise SimulationError(f"{path}: no such mesh file")
    vertices, triangles = _read_arrays(path)
    if len(triangles) == 0:
        raise SimulationError(f"{path}: a mesh needs triangles, this file is broken or has none")
    if not np.isfinite(vertices).all():
        raise SimulationError(f"{path}: a mesh must have finite vertices, got {_first_bad(vertices)}")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise SimulationError(
            f"{path}: a triangle names vertex {int(triangles.max())}, the file has {len(vertices)} vertices"
        )
    used, renumbered = np.unique(triangles, return_inverse=True)
    renumbered = renumbered.reshape(-1, 3).astype(np.int64)
    return Mesh(vertices[used], renumbered, np.full(len(renumbered), int(material)))


def usual_material(category: str) -> Material:
    """Tell what the surface of a category is when its file does not: cloth on persons, paint on the rest."""
    return Material.CLOTH if category in _IN_CLOTHES else Material.PAINT_SILVER


def find_meshes(folder: Path) -> tuple[MeshFile, ...]:
    """List the mesh files of a folder, in order.

    Known layouts: ModelNet40's `car/train/car_0001.off` and `car/test/car_0198.off`, one folder a category as
    `car/anything.ply`, and a flat folder whose names begin with the category, as `car_suv.ply`; there `vehicle`
    counts as `car`.

    Raises:
        SimulationError: the folder is not there, or holds no mesh.
    """
    if not folder.is_dir():
        raise SimulationError(f"{folder}: no such folder of meshes")
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not found:
        raise SimulationError(f"{folder}: no mesh in this folder; meshes are {', '.join(SUFFIXES)}")
    return tuple(_described(path, folder) for path in found)


def is_modelnet(files: tuple[MeshFile, ...]) -> bool:
    """Tell whether the files lie as in ModelNet40: all numbered, in `train` and `test` folders."""
    return all(f.number is not None and f.path.parent.name in ("train", "test") for f in files)


def _described(path: Path, folder: Path) -> MeshFile:
    """Take category and number from the place and the name of a file."""
    inner = path.relative_to(folder).parts[:-1]
    word = inner[0] if inner and inner[0] not in ("train", "test") else re.split(r"[_\-.\d]", path.stem, maxsplit=1)[0]
    category = word.lower() or "mesh"
    number = _NUMBER.search(path.stem)
    return MeshFile(path, _ALIASES.get(category, category), int(number[1]) if number else None)


def _read_arrays(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Let Open3D read the vertices and the triangles of a file; none at all of one that it cannot read."""
    open3d = load_open3d("reading mesh files")
    try:
        with _readable(path) as readable, open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
            mesh = open3d.io.read_triangle_mesh(os.fspath(readable))
    except (OSError, RuntimeError, UnicodeDecodeError) as error:
        raise SimulationError(f"{path}: cannot be read as a mesh: {error}") from error
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.triangles, dtype=np.int64)


@contextmanager
def _readable(path: Path) -> Iterator[Path]:
    """Give a file that Open3D reads: the file itself, or a copy whose glued first line is divided."""
    head = path.open("rb").readline() if path.suffix.lower() == ".off" else b""
    glued = re.match(rb"\s*((?:ST|C|N|4)*OFF)[ \t]*([\d-].*)", head)
    if glued is None:
        yield path
        return
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "mesh.off"
        with path.open("rb") as source, copy.open("wb") as target:
            source.readline()
            target.write(glued[1] + b"\n" + glued[2].strip() + b"\n")
            target.write(source.read())
        yield copy


def _first_bad(vertices: np.ndarray) -> str:
    row = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
    return f"{vertices[row].tolist()} in row {row}"
