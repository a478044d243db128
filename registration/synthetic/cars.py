"""Parametric cars: a lofted body with windows, on wheels, with what its owner bought besides."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from registration.synthetic.car_body import car_body, eaves_half_width
from registration.synthetic.car_shapes import ARCH_GAP, HATCHBACK, SEDAN, SUV, VAN, CarShape, resized, varied
from registration.synthetic.meshes import Material, Mesh, box_mesh, ellipsoid, merge
from registration.synthetic.parts import fitted, plate, rounded_box, wheel
from registration.types import Point

__all__ = ["HATCHBACK", "SEDAN", "SUV", "VAN", "CarShape", "CarTrim", "car", "resized", "varied"]


@dataclass(frozen=True)
class CarTrim:
    """What a car has besides its body.

    Attributes:
        has_mirrors: door mirrors; they stay within the car's width.
        has_cladding: sills and bumpers of black plastic.
        rail_height: of rails above the roof [m]; 0 for none.
        box_height: of a luggage box above the roof [m]; 0 for none.
    """

    has_mirrors: bool = False
    has_cladding: bool = False
    rail_height: float = 0.0
    box_height: float = 0.0


def car(shape: CarShape, paint: Material = Material.PAINT_SILVER, trim: CarTrim | None = None) -> Mesh:
    """Build a car; its bounding box has exactly the shape's length, width and height.

    Args:
        shape: what the outline is made of.  Rails and a box on the roof are part of its height.
        paint: material of the body.
        trim: what it has besides; None for nothing.

    Returns:
        The mesh; x forward, origin on the ground below the centre of the bounding box.

    Raises:
        SimulationError: what stands on the roof leaves no room for windows.
    """
    if trim is None:
        trim = CarTrim()
    size = np.array([shape.length, shape.width, shape.height])
    shape = dataclasses.replace(shape, height=shape.height - max(trim.rail_height, trim.box_height))
    body = car_body(shape, paint, trim.has_cladding)
    lower, upper = body.bounds
    body = body.stretched(np.array([shape.length, shape.width, shape.height]) / _extent(lower, upper))
    bare = merge([body, _underbody(shape), *_wheels(shape)])
    if trim == CarTrim():
        return bare
    return fitted(merge([bare, *_trim(shape, trim, paint)]), size)


def _extent(lower: Point, upper: Point) -> Point:
    """Length and width of a body, and its height above the ground: what is stretched to size."""
    return np.array([upper[0] - lower[0], upper[1] - lower[1], upper[2]])


def _underbody(shape: CarShape) -> Mesh:
    """Fill the middle between the wheels, so that nobody looks through the wheel arches."""
    reach = shape.wheel_radius + ARCH_GAP
    inner_width = shape.width - 2.0 * (shape.wheel_width + 0.10)
    top = shape.wheel_radius + reach + 0.02  # just above the arches, and still below the hood
    block = box_mesh(np.array([shape.wheelbase + 2.0 * reach, inner_width, top - shape.clearance]), Material.METAL)
    center_x = shape.rear_axle_x + 0.5 * shape.wheelbase
    return block.shifted(np.array([center_x, 0.0, shape.clearance]))


def _wheels(shape: CarShape) -> list[Mesh]:
    """Put four wheels under the body, a little inside its sides."""
    inset = 0.045
    y = 0.5 * shape.width - inset - 0.5 * shape.wheel_width
    one = wheel(shape.wheel_radius, shape.wheel_width)
    return [
        one.shifted(np.array([x, side * y, shape.wheel_radius]))
        for x in (shape.rear_axle_x, shape.rear_axle_x + shape.wheelbase)
        for side in (-1.0, 1.0)
    ]


def _trim(shape: CarShape, trim: CarTrim, paint: Material) -> list[Mesh]:
    """Build what a car has besides its body."""
    roof_front = 0.5 * shape.length - shape.hood_length - shape.windscreen_run
    roof = (roof_front - 0.92 * shape.roof_length, roof_front - 0.08 * shape.roof_length)
    eaves = eaves_half_width(shape)
    parts = []
    if trim.has_mirrors:
        parts += _mirrors(shape, paint)
    if trim.rail_height > 0.0:
        z = (shape.height - 0.09, shape.height + trim.rail_height)
        parts += [rounded_box(roof, (y - 0.02, y + 0.02), z, Material.METAL, 0.01) for y in (-eaves, eaves)]
    if trim.box_height > 0.0:
        low, half = shape.height + 0.05, 0.62 * eaves
        z = (low, shape.height + trim.box_height)
        parts.append(rounded_box(roof, (-half, half), z, Material.PAINT_DARK, 0.12))
        bars = (roof[0] + share * (roof[1] - roof[0]) for share in (0.25, 0.75))
        parts += [plate((x, x + 0.04), (-eaves, eaves), (low - 0.08, low + 0.02), Material.METAL) for x in bars]
    return parts


def _mirrors(shape: CarShape, paint: Material) -> list[Mesh]:
    """Put a mirror on each front door, no farther out than the body is wide."""
    radii = np.array([0.055, 0.085, 0.065]) * shape.height / 1.45
    x = 0.5 * shape.length - shape.hood_length - 0.45 * shape.windscreen_run
    y, z = 0.5 * shape.width - radii[1], shape.belt_height + 0.9 * radii[2]
    return [ellipsoid(np.array([x, side * y, z]), radii, paint, 8) for side in (-1.0, 1.0)]
