"""Parametric cars: a lofted body with windows, on wheels."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.interpolate import PchipInterpolator

from registration.errors import SimulationError
from registration.synthetic.meshes import Material, Mesh, box_mesh, loft, merge
from registration.types import Point

N_HALF = 10  # points of half a cross-section, from the middle of the floor to the middle of the roof
ARCH_GAP = 0.06  # between tyre and wheel arch [m]


@dataclass(frozen=True)
class CarShape:
    """What a car's outline is made of; lengths run along x, heights above the ground [m].

    The roof takes the length that hood, windscreen, backlight and deck leave.
    """

    length: float = 4.62
    width: float = 1.80
    height: float = 1.45
    wheelbase: float = 2.70
    front_overhang: float = 0.90  # front axle to front bumper
    clearance: float = 0.18  # ground to floor
    wheel_radius: float = 0.32
    wheel_width: float = 0.21
    hood_length: float = 1.20  # nose to the foot of the windscreen
    windscreen_run: float = 0.85  # horizontal length of the windscreen
    backlight_run: float = 0.75  # horizontal length of the rear window
    deck_length: float = 0.55  # boot lid behind the rear window
    nose_height: float = 0.72
    cowl_height: float = 0.98  # foot of the windscreen
    belt_height: float = 0.93  # lower edge of the side windows
    deck_height: float = 1.06  # foot of the rear window
    tumblehome_deg: float = 19.0  # lean of the side windows
    has_rear_windows: bool = True  # a panel van has none behind its doors

    def __post_init__(self) -> None:
        if self.roof_length < 0.3:
            raise SimulationError(
                f"a car needs a roof of at least 0.3 m, this one has {self.roof_length:.2f} m: "
                "hood, windscreen, backlight and deck leave nothing of its length"
            )
        if self.front_overhang + self.wheelbase + self.wheel_radius + ARCH_GAP >= self.length:
            raise SimulationError("the rear wheels of a car must be within its length")
        if not self.clearance < self.belt_height < self.height:
            raise SimulationError("a car needs clearance < belt_height < height")

    @property
    def roof_length(self) -> float:
        """Length of the roof between windscreen and backlight [m]."""
        return self.length - self.hood_length - self.windscreen_run - self.backlight_run - self.deck_length

    @property
    def rear_axle_x(self) -> float:
        """Where the rear axle is, seen from the centre: negative [m]."""
        return 0.5 * self.length - self.front_overhang - self.wheelbase


SEDAN = CarShape()
HATCHBACK = CarShape(
    length=4.05, width=1.74, height=1.49, wheelbase=2.53, front_overhang=0.82, wheel_radius=0.31,
    hood_length=0.95, windscreen_run=0.85, backlight_run=0.48, deck_length=0.10,
    nose_height=0.74, cowl_height=1.00, belt_height=0.95, deck_height=1.02,
)  # fmt: skip
SUV = CarShape(
    length=4.60, width=1.88, height=1.70, wheelbase=2.68, front_overhang=0.90, clearance=0.23,
    wheel_radius=0.36, wheel_width=0.24, hood_length=1.15, windscreen_run=0.80, backlight_run=0.45,
    deck_length=0.10, nose_height=0.90, cowl_height=1.12, belt_height=1.08, deck_height=1.15,
    tumblehome_deg=16.0,
)  # fmt: skip
VAN = CarShape(
    length=4.95, width=1.92, height=1.98, wheelbase=3.00, front_overhang=0.92, clearance=0.20,
    wheel_radius=0.34, wheel_width=0.22, hood_length=0.72, windscreen_run=0.80, backlight_run=0.16,
    deck_length=0.08, nose_height=0.92, cowl_height=1.18, belt_height=1.12, deck_height=1.15,
    tumblehome_deg=8.0, has_rear_windows=False,
)  # fmt: skip


# Measures that a bigger car has more of together.
_TOGETHER = (
    ("length", "wheelbase", "front_overhang", "hood_length", "windscreen_run", "backlight_run", "deck_length"),
    ("height", "clearance", "wheel_radius", "nose_height", "cowl_height", "belt_height", "deck_height"),
    ("width", "wheel_width"),
    ("tumblehome_deg",),
)


def varied(shape: CarShape, rng: np.random.Generator, spread: float = 0.03) -> CarShape:
    """Draw another car of the same kind: lengths, heights and widths grow together, each measure a little by itself.

    Args:
        shape: the kind of car.
        rng: source of the factors.
        spread: standard deviation of the common factors; that of a single measure's own is half as large.  All are
            clipped at two standard deviations.

    Raises:
        SimulationError: the spread is so large that a car came out impossible.
    """
    changes = {}
    for names in _TOGETHER:
        common, *own = 1.0 + spread * np.clip(rng.standard_normal(1 + len(names)), -2.0, 2.0)
        for name, factor in zip(names, own, strict=True):
            changes[name] = getattr(shape, name) * float(common * (0.5 + 0.5 * factor))
    return dataclasses.replace(shape, **changes)


def car(shape: CarShape, paint: Material = Material.PAINT_SILVER) -> Mesh:
    """Build a car; its bounding box has exactly the shape's length, width and height.

    Args:
        shape: what the outline is made of.
        paint: material of the body.

    Returns:
        The mesh; x forward, origin on the ground below the centre of the bounding box.
    """
    body = _body(shape, paint)
    lower, upper = body.bounds
    body = body.stretched(np.array([shape.length, shape.width, shape.height]) / _extent(lower, upper))
    return merge([body, _underbody(shape), *_wheels(shape)])


def _extent(lower: Point, upper: Point) -> Point:
    """Length and width of a body, and its height above the ground: what is stretched to size."""
    return np.array([upper[0] - lower[0], upper[1] - lower[1], upper[2]])


def _body(shape: CarShape, paint: Material) -> Mesh:
    """Loft the body over cross-sections from tail to nose."""
    u = _stations(shape)
    rings = np.stack([_section(shape, station) for station in u])
    rings[..., 0] = (0.5 * shape.length - u)[:, None]
    material = _body_material(shape, 0.5 * (u[1:] + u[:-1]), paint)
    return loft(rings, material, int(paint))


def _stations(shape: CarShape) -> Float64[np.ndarray, " k"]:
    """Choose where cross-sections are cut: distances from the tip of the nose, the tail first [m]."""
    ends = np.array([0.0, 0.015, 0.04, 0.08, 0.13, 0.20, 0.30, 0.42])
    reach = shape.wheel_radius + ARCH_GAP
    arch = reach * np.concatenate([np.cos(np.linspace(0.0, np.pi, 13)), [1.004, -1.004]])
    axles = shape.front_overhang + np.array([0.0, shape.wheelbase])
    edges = np.concatenate([window for window, _ in _windows(shape)])
    u = np.concatenate([
        np.linspace(0.0, shape.length, 48), ends, shape.length - ends, *(axle + arch for axle in axles), edges,
    ])  # fmt: skip
    u = np.unique(np.clip(u, 0.0, shape.length))
    return u[np.concatenate([[True], np.diff(u) > 1e-3])][::-1].copy()


def _top(shape: CarShape, u: float) -> float:
    """Height of the middle of the car, `u` behind its nose [m]."""
    roof = shape.hood_length + shape.windscreen_run
    tail = shape.length - shape.deck_length
    heights = {
        0.0: 0.78 * shape.nose_height,
        0.05: 0.93 * shape.nose_height,
        0.20: shape.nose_height,
        0.6 * shape.hood_length: shape.nose_height + 0.62 * (shape.cowl_height - shape.nose_height),
        shape.hood_length: shape.cowl_height,
        roof - 0.12: shape.cowl_height + 0.86 * (shape.height - shape.cowl_height),
        roof + 0.10: shape.height - 0.025,
        roof + 0.5 * shape.roof_length: shape.height,
        tail - shape.backlight_run: shape.height - 0.05,
        tail: shape.deck_height,
        shape.length - 0.3 * shape.deck_length: shape.deck_height - 0.02,
        shape.length: 0.86 * shape.deck_height,
    }
    return float(PchipInterpolator(list(heights), list(heights.values()))(u))


def _floor(shape: CarShape, u: float) -> float:
    """Height of the lower edge of the body, `u` behind its nose: arched over the wheels [m]."""
    reach = shape.wheel_radius + ARCH_GAP
    for axle in (shape.front_overhang, shape.front_overhang + shape.wheelbase):
        if abs(u - axle) <= reach:
            return shape.wheel_radius + float(np.sqrt(reach**2 - (u - axle) ** 2))
    to_end = min(u, shape.length - u)
    return shape.clearance + 0.14 * max(0.0, 1.0 - to_end / 0.35) ** 2


def _half_width(shape: CarShape, u: float) -> float:
    """Half the width of the body, `u` behind its nose: rounded corners, and a slight barrel [m]."""
    corner, power, tip = 0.50, 2.8, 0.70
    to_end = min(u, shape.length - u)
    rounding = (1.0 - max(0.0, 1.0 - to_end / corner) ** power) ** (1.0 / power)
    barrel = 1.0 - 0.04 * (2.0 * u / shape.length - 1.0) ** 2
    return 0.5 * shape.width * barrel * (tip + (1.0 - tip) * rounding)


def _section(shape: CarShape, u: float) -> Float64[np.ndarray, "n 3"]:
    """Cut the body `u` behind its nose: a closed ring, counter-clockwise seen from the front; x is left at 0."""
    width, floor, top = _half_width(shape, u), _floor(shape, u), _top(shape, u)
    shoulder = min(shape.belt_height, top - 0.05)
    rise = top - shoulder
    eaves = 0.93 * width - 0.9 * rise * np.tan(np.deg2rad(shape.tumblehome_deg))
    half = np.array([
        [0.0, floor], [0.86 * width, floor], [0.96 * width, floor + 0.08 * (shoulder - floor)],
        [width, floor + 0.45 * (shoulder - floor)], [0.99 * width, floor + 0.75 * (shoulder - floor)],
        [0.955 * width, shoulder], [0.93 * width, shoulder + 0.02 * rise], [eaves, shoulder + 0.86 * rise],
        [0.86 * eaves, shoulder + 0.96 * rise], [0.0, top],
    ])  # fmt: skip
    ring = np.concatenate([half, half[-2:0:-1] * [-1.0, 1.0]])
    return np.column_stack([np.zeros(len(ring)), ring])


def _windows(shape: CarShape) -> list[tuple[Float64[np.ndarray, "2"], int]]:
    """List the windows: from where to where behind the nose [m], and in which row of quads of half a section."""
    side, top = 6, 8
    cowl, roof = shape.hood_length, shape.hood_length + shape.windscreen_run
    tail = shape.length - shape.deck_length
    roof_end = tail - shape.backlight_run
    pillar = roof + 0.42 * shape.roof_length if shape.has_rear_windows else roof + 0.75
    windows = [
        (np.array([cowl + 0.04, roof - 0.05]), top),
        (np.array([cowl + 0.40 * shape.windscreen_run, pillar - 0.05]), side),
        (np.array([roof_end + 0.06 * shape.backlight_run, tail - 0.10 * shape.backlight_run]), top),
    ]
    if shape.has_rear_windows:
        windows.append((np.array([pillar + 0.05, roof_end + 0.20 * shape.backlight_run]), side))
    return windows


def _body_material(shape: CarShape, u_middle: Float64[np.ndarray, " k"], paint: Material) -> Int64[np.ndarray, "k n"]:
    """Paint the body's quads, and glaze those that are windows; one row a band between two sections."""
    n_ring = 2 * (N_HALF - 1)
    material = np.full((len(u_middle), n_ring), int(paint))
    for (start, end), row in _windows(shape):
        glazed: Bool[np.ndarray, " k"] = (start < u_middle) & (u_middle < end)
        # The ring runs up one side and down the other: quad j of the left is n_ring - 1 - j of the right.
        material[glazed, row] = Material.GLASS
        material[glazed, n_ring - 1 - row] = Material.GLASS
    return material


def _underbody(shape: CarShape) -> Mesh:
    """Fill the middle between the wheels, so that nobody looks through the wheel arches."""
    reach = shape.wheel_radius + ARCH_GAP
    inner_width = shape.width - 2.0 * (shape.wheel_width + 0.10)
    top = shape.wheel_radius + reach + 0.02  # just above the arches, and still below the hood
    block = box_mesh(np.array([shape.wheelbase + 2.0 * reach, inner_width, top - shape.clearance]), Material.METAL)
    center_x = shape.rear_axle_x + 0.5 * shape.wheelbase
    return Mesh(block.vertices + [center_x, 0.0, shape.clearance], block.triangles, block.material)


def _wheels(shape: CarShape) -> list[Mesh]:
    """Put four wheels under the body, a little inside its sides."""
    inset = 0.045
    y = 0.5 * shape.width - inset - 0.5 * shape.wheel_width
    wheel = _wheel(shape.wheel_radius, shape.wheel_width)
    return [
        Mesh(wheel.vertices + [x, side * y, shape.wheel_radius], wheel.triangles, wheel.material)
        for x in (shape.rear_axle_x, shape.rear_axle_x + shape.wheelbase)
        for side in (-1.0, 1.0)
    ]


def _wheel(radius: float, width: float, n_sides: int = 20) -> Mesh:
    """Build a wheel about the y axis, centred: a tyre, and a dished rim on either side."""
    angle = 2.0 * np.pi * np.arange(n_sides) / n_sides
    circle = np.column_stack([np.sin(angle), np.zeros(n_sides), np.cos(angle)])
    profile = [(0.15, 0.36), (0.64, 0.42), (0.66, 0.50), (0.93, 0.50), (1.0, 0.40)]
    profile += [(r, -half) for r, half in reversed(profile)]
    rings = np.stack([r * radius * circle - [0.0, half * width, 0.0] for r, half in profile])
    bands = np.array([Material.METAL] + 7 * [Material.RUBBER] + [Material.METAL], dtype=np.int64)
    return loft(rings, np.repeat(bands[:, None], n_sides, axis=1), int(Material.METAL))
