"""Bodies of road users: meshes that may move with the way gone, and how to draw one of a class at random."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from registration.errors import SimulationError, unknown_name
from registration.synthetic.car_draws import draw_car
from registration.synthetic.car_kinds import CARS, VANS
from registration.synthetic.coaches import draw_bus, draw_trailer, draw_tram
from registration.synthetic.meshes import Mesh
from registration.synthetic.persons import PLAIN, STRIDE_PER_HEIGHT, PersonLook, draw_look, person, person_size
from registration.synthetic.riders import (
    WAY_PER_TURN,
    CyclistLook,
    cyclist,
    draw_cyclist_look,
    sitting_person,
)
from registration.synthetic.trucks import draw_truck
from registration.types import Point

_MAX_WIDENING = 1.15  # of a person, across, to fill a given box; a person never becomes broader than that


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
    """A body that keeps its shape: a car.

    Attributes:
        shape: its mesh.
        box: length, width and height that count as its size [m]; None for those of the mesh.
    """

    shape: Mesh
    box: Point | None = None

    @cached_property
    def size(self) -> Point:
        """Length, width, height [m]; the mesh is centred."""
        if self.box is not None:
            return self.box
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
        look: build, clothes, swing of the limbs.
        box: length, width and height that hold every phase [m], into which the person is fitted; None for
            whatever the person needs.
    """

    height: float = 1.75
    phase: float = 0.0
    look: PersonLook = PLAIN
    box: Point | None = None

    @cached_property
    def size(self) -> Point:
        """Length, width, height of the box that holds every phase of the gait [m]."""
        return person_size(self.height, self.look) if self.box is None else self.box

    @cached_property
    def _factors(self) -> Point | None:
        return None if self.box is None else _fit(person_size(self.height, self.look), self.box)

    def mesh(self, distance: float) -> Mesh:
        """Shape after a way of `distance` [m]."""
        stride = STRIDE_PER_HEIGHT * self.height * max(self.look.swing, 0.3)
        mesh = person(self.height, self.phase + 2.0 * np.pi * distance / stride, self.look)
        return mesh if self._factors is None else _fill(mesh, self._factors, self.size)


@dataclass(frozen=True)
class CyclingBody:
    """A bicycle and its rider, whose legs turn the pedals with the way.

    Attributes:
        look: of bicycle and rider.
        phase: of the pedals at time 0 [rad].
        box: length, width and height that hold every phase [m], into which both are fitted; None for whatever
            they need.
    """

    look: CyclistLook
    phase: float = 0.0
    box: Point | None = None

    @cached_property
    def size(self) -> Point:
        """Length, width, height of the box that holds every position of the pedals [m]."""
        return self._hull if self.box is None else self.box

    @cached_property
    def _hull(self) -> Point:
        return _hull([cyclist(self.look, phase) for phase in np.linspace(0.0, np.pi, 4, endpoint=False)])

    @cached_property
    def _factors(self) -> Point | None:
        return None if self.box is None else _fit(self._hull, self.box)

    def mesh(self, distance: float) -> Mesh:
        """Shape after a way of `distance` [m]."""
        turn = WAY_PER_TURN * self.look.bicycle
        mesh = cyclist(self.look, self.phase + 2.0 * np.pi * distance / turn)
        return mesh if self._factors is None else _fill(mesh, self._factors, self.size)


def draw_body(class_name: str, rng: np.random.Generator, size: Point | None = None) -> Body:
    """Draw the body of a road user at random.

    A vehicle of a given size is one of the kinds that come near it, brought to exactly that size.  A person or a
    cyclist is as tall as the size says; their step, or their bicycle, follows its length; they are then made narrower
    as far as the box demands, but hardly broader.

    Args:
        class_name: KITTI's word, or `Bus`.
        rng: source of its shape.
        size: length, width, height that it must have [m]; None for any that is usual.

    Raises:
        SimulationError: nothing of this class, or nothing of this size, can be drawn.
    """
    if class_name not in _DRAWS:
        raise SimulationError(unknown_name("class", class_name, _DRAWS))
    if size is not None and not (np.isfinite(size).all() and (size > 0.0).all()):
        raise SimulationError(f"a body needs a length, width and height above 0 m, got {size.tolist()}")
    return _DRAWS[class_name](rng, size)


def _rigid(draw: Callable[[np.random.Generator, Point | None], Mesh]) -> Callable[..., Body]:
    return lambda rng, size: RigidBody(draw(rng, size), size)


def _draw_walker(rng: np.random.Generator, size: Point | None) -> Body:
    """Draw a walking person."""
    look, phase = draw_look(rng), float(rng.uniform(0.0, 2.0 * np.pi))
    height = float(rng.uniform(1.52, 1.93))
    if size is None:
        return WalkingBody(height, phase, look)
    # The longer the box, the longer the step: anybody's hull grows evenly with the swing.
    short, long = (person_size(1.0, replace(PLAIN, swing=swing)) for swing in (0.2, 1.2))
    wanted = float(size[0] / size[2]) * long[2]
    swing = 0.2 + float(np.clip((wanted - short[0]) / max(long[0] - short[0], 0.1), 0.0, 1.0))
    look = replace(look, swing=swing)
    height = float(np.clip(size[2] / person_size(1.0, look)[2], 0.6, 2.4))
    return WalkingBody(height, phase, look, size)


def _draw_cyclist(rng: np.random.Generator, size: Point | None) -> Body:
    """Draw a cyclist."""
    look, phase = draw_cyclist_look(rng), float(rng.uniform(0.0, 2.0 * np.pi))
    if size is None:
        return CyclingBody(look, phase)
    hull = CyclingBody(look).size
    # A child rides a child's bicycle; the rest of the difference in length is the box's.
    tall = float(size[2] / hull[2])
    bicycle = float(np.clip(look.bicycle * size[0] / hull[0], 0.82 * tall * look.bicycle, 1.12 * tall * look.bicycle))
    look = replace(
        look, height=float(np.clip(look.height * tall, 0.9, 2.3)), bicycle=float(np.clip(bicycle, 0.45, 1.5))
    )
    return CyclingBody(look, phase, size)


def _draw_sitter(rng: np.random.Generator, size: Point | None) -> Body:
    """Draw a sitting person."""
    height = float(rng.uniform(1.52, 1.90))
    if size is None:
        return RigidBody(sitting_person(rng, height))
    mesh = sitting_person(rng, 1.72)
    hull = _hull([mesh])
    return RigidBody(_fill(mesh, _fit(hull, size), size), size)


def _hull(meshes: Sequence[Mesh]) -> Point:
    """Give the box about the axis that holds all of the meshes [m]."""
    reach = np.max([np.maximum(-mesh.bounds[0], mesh.bounds[1]) for mesh in meshes], axis=0)
    return np.array([2.0 * reach[0], 2.0 * reach[1], reach[2]])


def _fit(hull: Point, box: Point) -> Point:
    """Tell how a person's hull is scaled to a box: exactly upwards; across like that, a little broader, or narrower."""
    factors = box / hull
    factors[:2] = np.minimum(factors[:2], _MAX_WIDENING * factors[2])
    return factors


def _fill(mesh: Mesh, factors: Point, box: Point) -> Mesh:
    """Scale a person; what a phase between those of the hull leaves outside the box is pushed onto its sides."""
    vertices = mesh.vertices * factors
    half = 0.5 * box[:2]
    limits = np.array([[-half[0], -half[1], 0.0], [half[0], half[1], box[2]]])
    return Mesh(np.clip(vertices, *limits), mesh.triangles, mesh.material)


_DRAWS: dict[str, Callable[[np.random.Generator, Point | None], Body]] = {
    "Car": _rigid(lambda rng, size: draw_car(CARS, rng, size)),
    "Van": _rigid(lambda rng, size: draw_car(VANS, rng, size)),
    "Truck": _rigid(draw_truck),
    "Bus": _rigid(draw_bus),
    "Tram": _rigid(draw_tram),
    "Misc": _rigid(draw_trailer),
    "Cyclist": _draw_cyclist,
    "Pedestrian": _draw_walker,
    "Person_sitting": _draw_sitter,
    "Person": _draw_sitter,  # as KITTI's tracking labels call a sitting one
}
CLASSES = tuple(_DRAWS)  # that `draw_body` knows
