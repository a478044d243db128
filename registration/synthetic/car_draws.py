"""How a car or a van of the families in `car_kinds` is drawn: of any size that is usual, or of a given one."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from registration.errors import SimulationError, unknown_name
from registration.synthetic.car_kinds import CarKind, Range
from registration.synthetic.car_shapes import CarShape, deepest_bed, resized
from registration.synthetic.cars import CarTrim, car
from registration.synthetic.meshes import Mesh
from registration.synthetic.parts import draw_paint, fitted
from registration.types import Point

_N_CANDIDATES = 64  # kinds and sizes among which one near a given size is chosen
_MIN_LENGTH = 3.3  # of cars whose measures are certainly possible [m]
_SIZE_SPREAD = 0.04  # by which their sizes may differ from the given one, relative


@dataclass(frozen=True)
class DrawnCar:
    """A car as drawn: enough to build its mesh.

    Attributes:
        kind: its family's name.
        shape: what its outline is made of.
        trim: what it has besides.
    """

    kind: str
    shape: CarShape
    trim: CarTrim


def draw_car(
    kinds: Mapping[str, CarKind], rng: np.random.Generator, size: Point | None = None, kind: str | None = None
) -> Mesh:
    """Draw a car and build its mesh.

    Args:
        kinds: the families: `CARS` or `VANS`.
        rng: source of everything about it.
        size: length, width and height that it must have [m]; a kind that comes near is likely.  None for any.
        kind: its family's name; None for one at random.

    Raises:
        SimulationError: no such family, or a size that is not positive.
    """
    if size is not None and not (size > 0.0).all():
        raise SimulationError(f"a body needs a length, width and height above 0 m, got {size.tolist()}")
    if kind is not None and kind not in kinds:
        raise SimulationError(unknown_name("kind of car", kind, kinds))
    drawn = draw_car_shape(kinds if kind is None else {kind: kinds[kind]}, rng, size)
    paint = draw_paint(rng)
    if size is None:
        return car(drawn.shape, paint, drawn.trim)
    # Labels of cut-off cars are shorter than any car: such a one is built larger, and shrunk.
    scale = max(1.0, _MIN_LENGTH / float(size[0]))
    return fitted(car(resized(drawn.shape, scale * size), paint, drawn.trim), size)


def draw_car_shape(kinds: Mapping[str, CarKind], rng: np.random.Generator, size: Point | None = None) -> DrawnCar:
    """Draw a kind of car, and its proportions; near `size` [m], if one is given."""
    name, drawn_size = _draw_size(kinds, rng, size)
    kind = kinds[name]
    shape = _draw_shape(kind, drawn_size, rng)
    luck = rng.uniform(size=4)
    rail = float(rng.uniform(0.03, 0.06)) if luck[0] < kind.rails else 0.0
    has_box = size is None and rail > 0.0 and luck[1] < 0.12
    box = float(rng.uniform(0.32, 0.45)) if has_box else 0.0
    trim = CarTrim(bool(luck[2] < 0.95), bool(luck[3] < kind.cladding), rail, box)
    return DrawnCar(name, replace(shape, height=shape.height + max(rail, box)), trim)


def _draw_size(kinds: Mapping[str, CarKind], rng: np.random.Generator, size: Point | None) -> tuple[str, Point]:
    """Draw a kind and a size; the nearer to the given size, the likelier."""
    names = list(kinds)
    shares = np.array([kinds[name].share for name in names])
    n = 1 if size is None else _N_CANDIDATES
    chosen = rng.choice(len(names), size=n, p=shares / shares.sum())
    # Long cars are wide and tall, but not strictly.
    along = 0.6 * rng.uniform(size=(n, 1)) + 0.4 * rng.uniform(size=(n, 3))
    ranges = np.array([kinds[name].size for name in names])[chosen]
    sizes = ranges[..., 0] + along * (ranges[..., 1] - ranges[..., 0])
    if size is None:
        return names[chosen[0]], sizes[0]
    distance = np.square(np.log(sizes / size) / _SIZE_SPREAD).sum(axis=1)
    weight = np.exp(-0.5 * (distance - distance.min()))
    best = int(rng.choice(n, p=weight / weight.sum()))
    return names[chosen[best]], sizes[best]


def _draw_shape(kind: CarKind, size: Point, rng: np.random.Generator) -> CarShape:
    """Draw the proportions of a car of some size."""
    length, width, height = (float(extent) for extent in size)
    hood, windscreen, backlight, deck, wheelbase, overhang = (length * _even(r, rng) for r in kind.along)
    nose, cowl, belt, deck_height = (height * _even(r, rng) for r in kind.up)
    # The arches must leave room for a hood above them.
    wheel_radius = min(_even(kind.wheel_radius, rng), 0.5 * (nose + 0.25 * (cowl - nose) - 0.10))
    luck = rng.uniform(size=3)
    has_rear_windows = bool(luck[0] >= kind.no_rear_windows)
    measures = {
        "length": length, "width": width, "height": height, "wheelbase": wheelbase, "front_overhang": overhang,
        "clearance": _even(kind.clearance, rng), "wheel_radius": wheel_radius,
        "wheel_width": width * _even((0.105, 0.135), rng), "hood_length": hood, "windscreen_run": windscreen,
        "backlight_run": backlight, "deck_length": deck, "nose_height": nose, "cowl_height": cowl,
        "belt_height": belt, "deck_height": deck_height, "tumblehome_deg": _even(kind.tumblehome_deg, rng),
        "pillar_share": _even((0.36, 0.50), rng), "roof_drop": _even((0.025, 0.085), rng),
        "corner_length": _even((0.32, 0.68), rng), "tip_share": _even((0.62, 0.80), rng),
        "nose_share": _even((0.70, 0.90), rng), "tail_share": _even((0.80, 0.93), rng),
    }  # fmt: skip
    return CarShape(
        **measures | dict(kind.fixed),
        has_rear_windows=has_rear_windows,
        has_back_window=bool(has_rear_windows or luck[1] < 0.4),
        has_third_window=bool(luck[2] < kind.third_window),
        bed_depth=min(0.45, deepest_bed(deck_height, wheel_radius)) if kind.has_bed else 0.0,
    )


def _even(limits: Range, rng: np.random.Generator) -> float:
    return float(rng.uniform(*limits))
