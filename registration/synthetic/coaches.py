"""Parametric buses, trams and trailers: long shells with plates for windows, of any length, width and height."""

import numpy as np

from registration.synthetic.meshes import Material, Mesh, ellipsoid, merge, tube
from registration.synthetic.parts import axle, both_sides, draw_paint, fitted, plate, rounded_box, shell
from registration.synthetic.trucks import draw_size, size_of_kind
from registration.types import Point

_BUS_SIZE = ((8.5, 13.0), (2.40, 2.55), (2.85, 3.45))
_TRAM_SIZE = ((14.0, 34.0), (2.20, 2.65), (3.35, 3.75))
_TRAILER_SIZES = {
    "caravan": ((4.8, 7.2), (2.05, 2.45), (2.40, 2.70)),
    "trailer": ((2.2, 4.6), (1.30, 1.90), (0.85, 2.10)),
}
TRAILERS = tuple(_TRAILER_SIZES)


def draw_bus(rng: np.random.Generator, size: Point | None = None) -> Mesh:
    """Draw a bus of a given length, width and height, or of usual ones [m].

    Raises:
        SimulationError: a size that is not positive.
    """
    wanted = draw_size(_BUS_SIZE, rng) if size is None else size
    length, width, height = (float(extent) for extent in np.maximum(wanted, [5.0, 1.9, 2.2]))
    paint, half = draw_paint(rng), 0.5 * width
    floor, corner = float(rng.uniform(0.24, 0.36)), float(rng.uniform(0.14, 0.28))
    roof = height - (float(rng.uniform(0.18, 0.30)) if rng.uniform() < 0.6 else 0.0)
    belt, brow = floor + float(rng.uniform(0.32, 0.46)) * (roof - floor), roof - corner - 0.12
    x = np.array([-0.5 * length, 0.5 * length])
    parts = [shell(x, np.tile([half, floor, roof, corner], (2, 1)), paint, 0.16)]
    parts += _window_row(x + [0.35, -1.3], half, (belt, brow), float(rng.uniform(1.1, 1.7)))
    parts += _end_windows(x, half, (belt - 0.15, brow + 0.05), (belt + 0.2, brow))
    parts += _doors(x, half, (floor + 0.1, brow), rng)
    radius = 0.48
    front_axle, rear_axle = x[1] - 0.21 * length, x[0] + 0.26 * length
    for axle_x in (front_axle, rear_axle, *([rear_axle - 1.25] if length > 12.3 else [])):
        parts += axle(float(axle_x), half + 0.012, radius, 0.34)
    if roof < height:
        parts.append(_roof_pod(x, 0.75 * half, (roof, height), rng))
    parts += both_sides(_bus_mirror(float(x[1]), half, roof))
    return fitted(merge(parts), wanted)


def draw_tram(rng: np.random.Generator, size: Point | None = None) -> Mesh:
    """Draw a tram of a given length, width and height, or of usual ones [m]: cars joined by bellows, tapered ends.

    Raises:
        SimulationError: a size that is not positive.
    """
    wanted = draw_size(_TRAM_SIZE, rng) if size is None else size
    length, width, height = (float(extent) for extent in np.maximum(wanted, [5.0, 1.9, 2.6]))
    paint, half = draw_paint(rng), 0.5 * width
    roof = height - float(rng.uniform(0.15, 0.35))
    floor, taper = 0.16, float(rng.uniform(0.7, 1.5))
    n_cars = max(1, round(length / float(rng.uniform(7.0, 10.0))))
    joints = np.linspace(-0.5 * length, 0.5 * length, n_cars + 1)
    parts = []
    for i, (rear, front) in enumerate(zip(joints[:-1], joints[1:], strict=True)):
        ends = (i == 0, i == n_cars - 1)
        parts += _tram_car((float(rear), float(front)), ends, (half, floor, roof, taper), paint)
        parts.append(_roof_pod(np.array([rear, front]), 0.7 * half, (roof, height), rng))
    for joint in joints[1:-1]:
        sides = np.tile([0.9 * half, floor + 0.15, roof - 0.08, 0.12], (2, 1))
        parts.append(shell(joint + np.array([-0.45, 0.45]), sides, Material.RUBBER))
    return fitted(merge(parts), wanted)


def draw_trailer(rng: np.random.Generator, size: Point | None = None, kind: str | None = None) -> Mesh:
    """Draw a caravan or an open or boxed trailer, drawbar ahead.

    Arguments and errors are those of `trucks.draw_truck`; kinds are those of `TRAILERS`.
    """
    if kind is None:
        is_large = rng.uniform() < 0.5 if size is None else bool(size[0] > 4.2 and size[2] > 2.0)
        kind = "caravan" if is_large else "trailer"
    wanted = size_of_kind("kind of trailer", kind, _TRAILER_SIZES, size, rng)
    least = [3.0, 1.6, 1.8] if kind == "caravan" else [1.5, 0.9, 0.7]
    built = np.maximum(wanted, least)
    parts = _caravan(built, rng) if kind == "caravan" else _trailer(built, rng)
    return fitted(merge(parts), wanted)


def _window_row(
    x: np.ndarray, half: float, heights: tuple[float, float], pitch: float, material: Material = Material.GLASS
) -> list[Mesh]:
    """Put panes of one pitch along both sides, a little proud of them [m]."""
    n = max(1, round(float(x[1] - x[0]) / pitch))
    edges = np.linspace(x[0], x[1], n + 1)
    panes = []
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        panes += both_sides(plate((a + 0.04, b - 0.04), (half - 0.05, half + 0.008), heights, material))
    return panes


def _end_windows(
    x: np.ndarray, half: float, front: tuple[float, float], rear: tuple[float, float], share: float = 0.84
) -> list[Mesh]:
    """Put a windscreen before the front end and a window behind the rear one [m]."""
    return [
        plate((x[1] - 0.1, x[1] + 0.008), (-share * half, share * half), (front[0], front[1]), Material.GLASS),
        plate((x[0] - 0.008, x[0] + 0.1), (-0.7 * half, 0.7 * half), (rear[0], rear[1]), Material.GLASS),
    ]


def _doors(x: np.ndarray, half: float, heights: tuple[float, float], rng: np.random.Generator) -> list[Mesh]:
    """Glaze two or three doors on the right [m]."""
    shares = [0.93, 0.52, 0.16] if rng.uniform() < 0.5 else [0.93, 0.50]
    return [
        plate(
            (x[0] + share * (x[1] - x[0]) - 0.5, x[0] + share * (x[1] - x[0]) + 0.5),
            (-half - 0.010, -half + 0.05),
            (heights[0], heights[1]),
            Material.GLASS,
        )
        for share in shares
    ]


def _roof_pod(x: np.ndarray, half: float, heights: tuple[float, float], rng: np.random.Generator) -> Mesh:
    """Build a box on the roof: air conditioning, batteries [m]."""
    start, end = x[0] + (x[1] - x[0]) * np.array([rng.uniform(0.12, 0.35), rng.uniform(0.60, 0.85)])
    return rounded_box((start, end), (-half, half), (heights[0] - 0.05, heights[1]), Material.PAINT_LIGHT, 0.08)


def _bus_mirror(front: float, half: float, roof: float) -> Mesh:
    """Hang a mirror before the corner of the windscreen [m]."""
    return ellipsoid(
        np.array([front + 0.06, 0.93 * half, roof - 0.75]), np.array([0.07, 0.10, 0.18]), Material.PAINT_DARK, 8
    )


def _tram_car(
    x: tuple[float, float], ends: tuple[bool, bool], section: tuple[float, float, float, float], paint: Material
) -> list[Mesh]:
    """Build one car of a tram.

    Args:
        x: its rear and its front [m].
        ends: whether its rear and its front are the tram's.
        section: half width, floor, roof, and the length of the taper of an end [m].
        paint: material of its skin.
    """
    half, floor, roof, taper = section
    straight = np.array([x[0] + (taper if ends[0] else 0.3), x[1] - (taper if ends[1] else 0.3)])
    full, tip = [half, floor, roof, 0.2], [0.72 * half, floor + 0.12, roof - 0.35, 0.25]
    stations = [(straight[0], full), (straight[1], full)]
    stations.insert(0, (x[0], tip) if ends[0] else (x[0] + 0.29, full))
    stations.append((x[1], tip) if ends[1] else (x[1] - 0.29, full))
    hull = shell(np.array([s[0] for s in stations]), np.array([s[1] for s in stations]), paint)
    belt, brow = floor + 0.32 * (roof - floor), floor + 0.82 * (roof - floor)
    panes = _window_row(straight + [0.1, -0.1], half, (belt, brow), 1.6)
    bogie = plate((straight.mean() - 1.1, straight.mean() + 1.1), (-0.8 * half, 0.8 * half), (0.0, 0.3), Material.METAL)
    for is_end, tip_x, sign in ((ends[0], x[0], -1.0), (ends[1], x[1], 1.0)):
        if is_end:
            low, high = np.sort([tip_x + 0.008 * sign, tip_x - 0.06 * sign])
            panes.append(plate((low, high), (-0.6 * half, 0.6 * half), (belt, brow - 0.1), Material.GLASS))
    return [hull, *panes, bogie]


def _caravan(size: Point, rng: np.random.Generator) -> list[Mesh]:
    """Build a caravan whose drawbar ends at x = 0 [m]."""
    length, width, height = (float(extent) for extent in size)
    half, floor, bar = 0.5 * width, 0.42, min(1.15, 0.25 * length)
    slope = float(rng.uniform(0.12, 0.35))
    x = np.array([-length, -length + slope, -bar - slope, -bar])
    low, high = [half, floor, height, 0.14], [half, floor + 0.12, height - 0.9 * slope, 0.14]
    parts = [shell(x, np.array([high, low, low, high]), Material.PAINT_LIGHT, 0.06)]
    parts += _window_row(x[[1, 2]] + [0.3, -0.3], half, (1.35, min(1.95, height - 0.35)), float(rng.uniform(1.3, 2.2)))
    middle = 0.5 * (x[0] + x[3]) - 0.15
    for axle_x in [middle - 0.4, middle + 0.4] if length > 6.5 else [middle]:
        parts += axle(float(axle_x), half + 0.008, 0.32, 0.2)
    return [*parts, *_drawbar(bar, 0.5 * half)]


def _trailer(size: Point, rng: np.random.Generator) -> list[Mesh]:
    """Build a trailer whose drawbar ends at x = 0: an open tub, or one under a hood [m]."""
    length, width, height = (float(extent) for extent in size)
    bar, radius = 0.28 * length, min(0.30, 0.35 * height)
    half = 0.5 * width
    tub, bed = half - 0.16 if width > 1.2 else half - 0.06, 0.9 * radius + 0.12
    board = max(bed + 0.2, min(height, float(rng.uniform(0.85, 1.2))))
    material = Material.METAL if rng.uniform() < 0.5 else draw_paint(rng)
    parts = [plate((-length, -bar), (-tub, tub), (bed, bed + 0.05), material)]
    parts += both_sides(plate((-length, -bar), (tub - 0.04, tub), (bed, board), material))
    parts += [plate((x, x + 0.04), (-tub, tub), (bed, board), material) for x in (-length, -bar - 0.04)]
    if board < height - 0.1:
        hood = rounded_box((-length, -bar), (-tub, tub), (board - 0.05, height), Material.CLOTH, 0.08)
        parts.append(hood)
    axle_x = -0.5 * (length + bar) - 0.05
    parts += axle(axle_x, half, radius, min(0.17, 0.3 * width))
    beam = np.array([[axle_x, -half + 0.05, radius], [axle_x, half - 0.05, radius]])
    parts.append(tube(beam, np.full((2, 2), 0.04), Material.METAL, 6))
    return [*parts, *_drawbar(bar, 0.6 * tub, bed)]


def _drawbar(length: float, half: float, height: float = 0.45) -> list[Mesh]:
    """Build two beams that meet at x = 0, and the wheel that carries them when parked [m]."""
    beams = [
        tube(np.array([[-length - 0.3, y, height], [-0.05, 0.0, height]]), np.full((2, 2), 0.045), Material.METAL, 6)
        for y in (-half, half)
    ]
    coupling = plate((-0.18, 0.0), (-0.06, 0.06), (height - 0.06, height + 0.06), Material.METAL)
    leg = tube(np.array([[-0.3, 0.0, 0.0], [-0.3, 0.0, height + 0.2]]), np.full((2, 2), 0.035), Material.METAL, 8)
    return [*beams, coupling, leg]
