"""Parametric trucks: a cab and what it carries or pulls, of any length, width and height."""

from collections.abc import Mapping

import numpy as np

from registration.errors import SimulationError, unknown_name
from registration.synthetic.meshes import Material, Mesh, merge, tube
from registration.synthetic.parts import PAINTS, Span, axle, both_sides, draw_paint, fitted, plate, rounded_box, shell
from registration.types import Point

Ranges = tuple[tuple[float, float], ...]  # of lengths, widths and heights [m]

_LONG = 11.0  # from which length on a truck is articulated [m]
_WHEEL_WIDTH = 0.30

# Usual lengths, widths and heights [m].
_SIZES: dict[str, Ranges] = {
    "box truck": ((5.6, 9.8), (2.15, 2.55), (2.8, 3.8)),
    "flatbed truck": ((5.6, 9.5), (2.15, 2.55), (2.4, 3.2)),
    "tank truck": ((6.5, 9.5), (2.40, 2.55), (3.0, 3.5)),
    "articulated truck": ((12.0, 16.5), (2.45, 2.60), (3.6, 4.0)),
}
TRUCKS = tuple(_SIZES)


def draw_truck(rng: np.random.Generator, size: Point | None = None, kind: str | None = None) -> Mesh:
    """Draw a truck.

    Args:
        rng: source of everything about it.
        size: length, width and height that it must have [m]; None for usual ones.
        kind: one of `TRUCKS`; None for one that is usual at this length.

    Raises:
        SimulationError: no such kind, or a size that is not positive.
    """
    if kind is None:
        is_long = rng.uniform() < 0.35 if size is None else bool(size[0] > _LONG)
        kind = "articulated truck" if is_long else str(rng.choice(TRUCKS[:3], p=[0.6, 0.25, 0.15]))
    wanted = size_of_kind("kind of truck", kind, _SIZES, size, rng)
    # A label may cut a truck off: it is then built as long as the shortest, and shrunk.
    built = np.maximum(wanted, [5.0, 1.8, 2.0])
    parts = _articulated_truck(built, rng) if kind == "articulated truck" else _rigid_truck(built, rng, kind)
    return fitted(merge(parts), wanted)


def size_of_kind(
    what: str, kind: str, sizes: Mapping[str, Ranges], size: Point | None, rng: np.random.Generator
) -> Point:
    """Give the size that is wanted, or draw one that is usual for a kind [m].

    Raises:
        SimulationError: no such kind, which the message calls `what`.
    """
    if kind not in sizes:
        raise SimulationError(unknown_name(what, kind, sizes))
    return draw_size(sizes[kind], rng) if size is None else size


def draw_size(ranges: Ranges, rng: np.random.Generator) -> Point:
    """Draw a length, a width and a height from even ranges that grow together by half [m]."""
    share = 0.5 * rng.uniform() + 0.5 * rng.uniform(size=3)
    low, high = np.array(ranges).T
    return low + share * (high - low)


def _rigid_truck(size: Point, rng: np.random.Generator, kind: str) -> list[Mesh]:
    """Build a truck in one piece; its front is at x = 0 [m]."""
    length, width, height = (float(extent) for extent in size)
    radius = float(rng.uniform(0.40, 0.50))
    cab_length = float(rng.uniform(1.55, 1.95)) + (0.5 if length > 8.0 and rng.uniform() < 0.4 else 0.0)
    is_low = kind == "flatbed truck"
    cab_height = height if is_low else height * float(rng.uniform(0.80, 0.96))
    bed = float(rng.uniform(0.95, 1.15))
    cargo_front = -cab_length - float(rng.uniform(0.06, 0.20))
    rear_axle = -length + float(rng.uniform(0.22, 0.30)) * (length - cab_length)
    parts = [*_cab(cab_length, 0.96 * width, cab_height, rng), *_chassis(-length, -0.5 * cab_length, width, bed)]
    parts += axle(-0.55 * cab_length, 0.48 * width, radius, _WHEEL_WIDTH)
    parts += axle(rear_axle, 0.48 * width, radius, 2.0 * _WHEEL_WIDTH)
    if length > 8.5 and rng.uniform() < 0.5:
        parts += axle(rear_axle + 2.3 * radius + 0.1, 0.48 * width, radius, 2.0 * _WHEEL_WIDTH)
    parts += _skirts(rear_axle + 2.0, -0.55 * cab_length - 0.8, width, bed, rng)
    return parts + _cargo(kind, (-length, cargo_front), (width, bed, height), rng)


def _articulated_truck(size: Point, rng: np.random.Generator) -> list[Mesh]:
    """Build a tractor and its semi-trailer; its front is at x = 0 [m]."""
    length, width, height = (float(extent) for extent in size)
    radius = float(rng.uniform(0.46, 0.52))
    cab_length = float(rng.uniform(1.9, 2.35))
    cab_height = height * float(rng.uniform(0.86, 0.98))
    bed = float(rng.uniform(1.10, 1.25))
    gap = float(rng.uniform(0.35, 0.75))
    drive_axle = -cab_length - float(rng.uniform(1.3, 1.8))
    parts = [
        *_cab(cab_length, 0.97 * width, cab_height, rng),
        *_chassis(drive_axle - 0.9, -0.5 * cab_length, width, 0.9),
    ]
    parts += axle(-0.6 * cab_length, 0.48 * width, radius, _WHEEL_WIDTH)
    parts += axle(drive_axle, 0.48 * width, radius, 2.0 * _WHEEL_WIDTH)
    last_axle = -length + float(rng.uniform(1.0, 1.6))
    n_axles = 3 if length > 12.0 else 2
    for i in range(n_axles):
        parts += axle(last_axle + 1.3 * i, 0.48 * width, radius, _WHEEL_WIDTH)
    parts += _chassis(-length, drive_axle + 0.3, 0.9 * width, bed)
    parts += _skirts(last_axle + 1.3 * n_axles, drive_axle - 1.1, width, bed, rng)
    kind = str(rng.choice(TRUCKS[:3], p=[0.75, 0.1, 0.15]))
    return parts + _cargo(kind, (-length, -cab_length - gap), (width, bed, height), rng)


def _cab(length: float, width: float, height: float, rng: np.random.Generator) -> list[Mesh]:
    """Build a cab above the engine: a shell that leans back a little, with windows; its front is at x = 0 [m]."""
    paint, half, floor = draw_paint(rng), 0.5 * width, 0.45
    rise = height - floor
    belt, brow = floor + 0.44 * rise, floor + min(0.80, 0.44 + 0.95 / rise) * rise
    hull = rounded_box((-length, 0.0), (-half, half), (floor, height), paint, 0.13)
    pane = plate((-0.05, 0.012), (-0.85 * half, 0.85 * half), (belt, brow), Material.GLASS)
    door = plate((-0.75 * length, -0.18 * length), (half - 0.03, half + 0.008), (belt, brow), Material.GLASS)
    mirror_x = (-0.14 * length - 0.10, -0.14 * length)
    mirror = rounded_box(mirror_x, (half - 0.06, half + 0.04), (belt + 0.1, brow - 0.05), Material.PAINT_DARK, 0.03)
    grille = plate((-0.05, 0.010), (-0.6 * half, 0.6 * half), (floor + 0.08, belt - 0.15), Material.METAL)
    bumper = rounded_box((-0.5, 0.015), (-half, half), (0.28, 0.62), Material.PAINT_DARK, 0.06)
    leaning = _leant_back(merge([hull, pane]), (belt, height), float(rng.uniform(0.0, 0.05)) * rise)
    return [leaning, *both_sides(door), *both_sides(mirror), grille, bumper]


def _leant_back(mesh: Mesh, heights: Span, lean: float) -> Mesh:
    """Shear the front half of a cab so that between two heights it leans back by `lean` [m]."""
    x, z = mesh.vertices[:, 0], mesh.vertices[:, 2]
    up = np.clip((z - heights[0]) / (heights[1] - heights[0]), 0.0, 1.0)
    front = np.clip(2.0 - 2.0 * x / x.min(), 0.0, 1.0)
    return Mesh(mesh.vertices - np.outer(lean * up * front, [1.0, 0.0, 0.0]), mesh.triangles, mesh.material)


def _chassis(rear: float, front: float, width: float, bed: float) -> list[Mesh]:
    """Build the frame under the cargo, and the bar that keeps cars from driving under its end [m]."""
    frame = plate((rear + 0.08, front), (-0.22 * width, 0.22 * width), (0.58, bed), Material.METAL)
    bar = plate((rear + 0.08, rear + 0.18), (-0.44 * width, 0.44 * width), (0.45, 0.62), Material.METAL)
    return [frame, bar]


def _skirts(rear: float, front: float, width: float, bed: float, rng: np.random.Generator) -> list[Mesh]:
    """Hang tanks, boxes or planks between the axles on both sides [m]."""
    if front - rear < 0.6:
        return []
    side = 0.47 * width
    if rng.uniform() < 0.5:
        plank = plate((rear, front), (side - 0.03, side), (0.50, bed - 0.15), Material.METAL)
        return both_sides(plank)
    length = min(front - rear, float(rng.uniform(0.6, 1.4)))
    tank = rounded_box((front - length, front), (side - 0.5, side), (0.45, bed - 0.08), Material.METAL, 0.08)
    return both_sides(tank)


def _cargo(
    kind: str, along: tuple[float, float], section: tuple[float, float, float], rng: np.random.Generator
) -> list[Mesh]:
    """Build what is carried: a box, a bed with a load, or a tank.

    Args:
        kind: of truck.
        along: its rear and its front [m].
        section: its width, and the heights of the bed and of the vehicle [m].
        rng: source of its details.
    """
    (rear, front), (width, bed, height) = along, section
    half = 0.5 * width
    paint = PAINTS[rng.integers(len(PAINTS))] if rng.uniform() < 0.6 else Material.CLOTH  # tarpaulin
    if kind == "box truck":
        box = rounded_box((rear, front), (-half, half), (bed, height), paint, 0.035)
        rail = plate((rear + 0.02, front - 0.02), (-half, half), (bed - 0.05, bed + 0.01), Material.METAL)
        return [box, rail]
    if kind == "tank truck":
        radius = min(0.47 * width, 0.5 * (height - bed))
        x = np.array([rear + 0.1, rear + 0.3, front - 0.3, front - 0.1])
        centers = np.column_stack([x, np.zeros(4), np.full(4, height - radius)])
        radii = np.outer([0.55, 1.0, 1.0, 0.55], [radius, 0.47 * width])
        walkway = plate((rear, front), (-half, half), (bed - 0.02, bed + 0.06), Material.METAL)
        return [tube(centers, radii, Material.METAL, 20), walkway]
    return _open_bed(along, (half, bed, height), paint, rng)


def _open_bed(
    along: tuple[float, float], section: tuple[float, float, float], paint: Material, rng: np.random.Generator
) -> list[Mesh]:
    """Build a bed with boards around it and, most times, a load [m]."""
    (rear, front), (half, bed, height) = along, section
    board = bed + float(rng.uniform(0.35, 0.6))
    parts = [plate((rear, front), (-half, half), (bed - 0.05, bed + 0.08), Material.METAL)]
    parts += both_sides(plate((rear, front), (half - 0.05, half), (bed, board), paint))
    parts.append(plate((rear, rear + 0.05), (-half, half), (bed, board), paint))
    parts.append(plate((front - 0.06, front), (-half, half), (bed, board + 0.3), paint))
    if rng.uniform() < 0.75:
        ends = np.sort(rng.uniform(rear + 0.15, front - 0.15, 2)) + [-0.1, 0.1]
        top = float(rng.uniform(board, max(board + 0.05, height - 0.05)))
        material = Material.MASONRY if rng.uniform() < 0.5 else Material.CLOTH
        parts.append(shell(ends, np.tile([0.8 * half, bed, top, 0.15], (2, 1)), material, 0.1))
    return parts
