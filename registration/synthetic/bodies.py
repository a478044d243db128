"""Bodies of road users: meshes that may move with the way gone, and how to draw one of a class at random."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from registration.errors import SimulationError, unknown_name
from registration.synthetic.cars import HATCHBACK, SEDAN, SUV, VAN, car, varied
from registration.synthetic.meshes import Material, Mesh
from registration.synthetic.persons import STRIDE_PER_HEIGHT, person, person_size
from registration.types import Point

_PAINTS = (Material.PAINT_LIGHT, Material.PAINT_SILVER, Material.PAINT_SILVER, Material.PAINT_DARK)


@runtime_checkable
class Body(Protocol):
    """What a road user looks like: a mesh that may change with the way it has gone."""

    @property
    def size(self) -> Point:
        """Length, width, height of the box about the actor's axis that always holds it [m]."""

    def mesh(self, distance: float) -> Mesh:
        """Shape after a way of `distance` [m]."""


@dataclass(frozen=True)
class RigidBody:
    """A body that keeps its shape: a car."""

    shape: Mesh

    @cached_property
    def size(self) -> Point:
        """Length, width, height [m]; the mesh is centred."""
        lower, upper = self.shape.bounds
        return np.array([upper[0] - lower[0], upper[1] - lower[1], upper[2]])

    def mesh(self, distance: float) -> Mesh:
        """Shape: always the same."""
        return self.shape


@dataclass(frozen=True)
class WalkingBody:
    """A person whose legs and arms swing with the way.

    Attributes:
        height: of the person [m].
        phase: of the gait at time 0 [rad].
    """

    height: float = 1.75
    phase: float = 0.0

    @cached_property
    def size(self) -> Point:
        """Length, width, height of the box that holds every phase of the gait [m]."""
        return person_size(self.height)

    def mesh(self, distance: float) -> Mesh:
        """Shape after a way of `distance` [m]."""
        return person(self.height, self.phase + 2.0 * np.pi * distance / (STRIDE_PER_HEIGHT * self.height))


def draw_body(class_name: str, rng: np.random.Generator, size: Point | None = None) -> Body:
    """Draw the body of a road user at random.

    Args:
        class_name: KITTI's word: `Car`, `Van`, `Pedestrian`, ...
        rng: source of its shape.
        size: length, width, height that it must have [m]; None for any that is usual.

    Raises:
        SimulationError: nothing of this class can be drawn.
    """
    if class_name in ("Pedestrian", "Person_sitting"):
        height = float(rng.uniform(1.55, 1.9)) if size is None else float(size[2])
        return WalkingBody(height, float(rng.uniform(0.0, 2.0 * np.pi)))
    kinds = {"Car": (SEDAN, HATCHBACK, SUV), "Van": (VAN,)}
    if class_name not in kinds:
        raise SimulationError(unknown_name("class", class_name, kinds))
    mesh = car(
        varied(kinds[class_name][rng.integers(len(kinds[class_name]))], rng), _PAINTS[rng.integers(len(_PAINTS))]
    )
    lower, upper = mesh.bounds
    return RigidBody(mesh if size is None else mesh.stretched(size / (upper - [*lower[:2], 0.0])))
