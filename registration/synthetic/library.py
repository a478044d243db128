"""Sources of meshes by category and part: our own parametric families, or the files of a folder."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from registration.errors import SimulationError, unknown_name
from registration.synthetic.bodies import draw_body
from registration.synthetic.car_draws import draw_car
from registration.synthetic.car_kinds import CARS, VANS
from registration.synthetic.coaches import draw_bus, draw_trailer, draw_tram
from registration.synthetic.mesh_files import MeshFile, find_meshes, is_modelnet, read_mesh, usual_material
from registration.synthetic.mesh_splits import (
    FLAT_RULE,
    MODELNET_RULE,
    N_SHAPES,
    PARTS,
    check_part,
    seed_range,
    split_flat,
    split_modelnet,
)
from registration.synthetic.meshes import Mesh
from registration.synthetic.trucks import TRUCKS, draw_truck

FAMILY_VERSION = 1  # raise it when a seed gives another shape than before
_ENTROPY = 20190916  # of the parametric families, apart from every other stream of random numbers


@runtime_checkable
class MeshSource(Protocol):
    """Gives meshes by category; those of two parts have none in common."""

    @property
    def categories(self) -> tuple[str, ...]:
        """What there is, in alphabetical order."""

    def draw(self, category: str, part: str, rng: np.random.Generator) -> Mesh:
        """Draw one mesh of a category for `train`, `val` or `test`."""

    def describe(self) -> dict[str, Any]:
        """Tell where the meshes come from and how they are divided, for a data set's metadata."""


def _body_mesh(class_name: str) -> Callable[[np.random.Generator], Mesh]:
    """Draw persons and cyclists in the middle of a step."""
    return lambda rng: draw_body(class_name, rng).mesh(0.0)


def _truck(kind: str) -> Callable[[np.random.Generator], Mesh]:
    return lambda rng: draw_truck(rng, kind=kind)


# What a seed becomes; a category's random numbers follow from its name.
_FAMILIES: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "bus": draw_bus,
    "car": lambda rng: draw_car(CARS, rng),
    "caravan": lambda rng: draw_trailer(rng, kind="caravan"),
    "cyclist": _body_mesh("Cyclist"),
    "person": _body_mesh("Pedestrian"),
    "sitting_person": _body_mesh("Person_sitting"),
    "trailer": lambda rng: draw_trailer(rng, kind="trailer"),
    "tram": draw_tram,
    "van": lambda rng: draw_car(VANS, rng),
    **{kind.replace(" ", "_"): _truck(kind) for kind in TRUCKS},
}


@dataclass(frozen=True)
class ParametricSource:
    """Our own families: a member of a family follows from its number alone; each part has numbers of its own.

    Meshes are in metres: x forward, z up, origin on the ground below the middle of a vehicle or the hips of a person.
    No two categories share a mesh.
    """

    @property
    def categories(self) -> tuple[str, ...]:
        """Names of the families, in alphabetical order."""
        return tuple(sorted(_FAMILIES))

    def draw(self, category: str, part: str, rng: np.random.Generator) -> Mesh:
        """Draw a member of a family.

        Args:
            category: one of `categories`.
            part: `train`, `val` or `test`.
            rng: picks the member; one draw.

        Raises:
            SimulationError: no such category or part.
        """
        members = seed_range(part)
        return self.member(category, int(members[int(rng.integers(len(members)))]))

    def member(self, category: str, number: int) -> Mesh:
        """Build the member of a family that has this number; `mesh_splits.seed_range` says whose it is.

        Raises:
            SimulationError: no such category.
        """
        if category not in _FAMILIES:
            raise SimulationError(unknown_name("family of meshes", category, _FAMILIES))
        return _member(category, number)

    def describe(self) -> dict[str, Any]:
        """Tell what the families are, and which numbers each part has."""
        split = {part: [seed_range(part).start, seed_range(part).stop] for part in PARTS}
        return {
            "source": "parametric families",
            "version": FAMILY_VERSION,
            "categories": list(self.categories),
            "n_meshes": {category: dict(N_SHAPES) for category in self.categories},
            "split_rule": "each part has its own range of seeds",
            "seeds": split,
        }


@lru_cache(maxsize=256)
def _member(category: str, number: int) -> Mesh:
    name = int.from_bytes(hashlib.sha256(category.encode()).digest()[:4], "big")
    return _FAMILIES[category](np.random.default_rng([_ENTROPY, name, number]))


@dataclass(frozen=True)
class FolderSource:
    """The mesh files of a folder; `mesh_files.find_meshes` says which layouts are known.

    Meshes come as they are in the files: neither turned nor scaled.  ModelNet40's aligned version has z up.

    Attributes:
        path: of the folder.
    """

    path: Path

    def __post_init__(self) -> None:
        # A folder that cannot be used is noticed now, not in the middle of a data set.
        _ = self._split

    @cached_property
    def _files(self) -> tuple[MeshFile, ...]:
        return find_meshes(self.path)

    @cached_property
    def _split(self) -> dict[str, dict[str, tuple[MeshFile, ...]]]:
        """The files of each category and part."""
        divide = split_modelnet if is_modelnet(self._files) else split_flat
        names = sorted({file.category for file in self._files})
        return {name: divide([file for file in self._files if file.category == name]) for name in names}

    @property
    def categories(self) -> tuple[str, ...]:
        """What the folder has, in alphabetical order."""
        return tuple(self._split)

    def files(self, category: str, part: str) -> tuple[MeshFile, ...]:
        """List the files of a category that a part has.

        Raises:
            SimulationError: no such category or part.
        """
        check_part(part)
        if category not in self._split:
            raise SimulationError(f"{self.path}: {unknown_name('category of meshes', category, self._split)}")
        return self._split[category][part]

    def draw(self, category: str, part: str, rng: np.random.Generator) -> Mesh:
        """Draw one of the files and read it.

        Args:
            category: one of `categories`.
            part: `train`, `val` or `test`.
            rng: picks the file; one draw.

        Raises:
            SimulationError: no such category or part, no file in it, or a file that is broken.
        """
        files = self.files(category, part)
        if not files:
            counts = {name: len(these) for name, these in self._split[category].items()}
            raise SimulationError(f"{self.path}: no mesh of {category!r} is left for {part!r}; there are {counts}")
        return _read(files[int(rng.integers(len(files)))].path, category)

    def describe(self) -> dict[str, Any]:
        """Tell what the folder has, and how it is divided; `digest` changes with any file's name or part."""
        counts = {
            category: {part: len(files) for part, files in parts.items()} for category, parts in self._split.items()
        }
        lines = [
            f"{category} {part} {file.path.relative_to(self.path).as_posix()}"
            for category, parts in self._split.items()
            for part, files in parts.items()
            for file in files
        ]
        return {
            "source": "folder",
            "folder": self.path.name,
            "layout": "ModelNet40" if is_modelnet(self._files) else "flat",
            "categories": list(self.categories),
            "n_meshes": counts,
            "split_rule": MODELNET_RULE if is_modelnet(self._files) else FLAT_RULE,
            "digest": hashlib.sha256("\n".join(lines).encode()).hexdigest(),
        }


@lru_cache(maxsize=32)
def _read(path: Path, category: str) -> Mesh:
    return read_mesh(path, usual_material(category))
