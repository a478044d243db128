"""What a parametric car's outline is made of, and four kinds of cars to start from."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from registration.errors import SimulationError
from registration.types import Point

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
    has_back_window: bool = True
    pillar_share: float = 0.42  # where the pillar behind the front doors is, of the roof's length
    has_third_window: bool = False  # a pillar divides the rear side window, as in estates and minivans
    window_top: float = 1.0  # upper edge of the side windows, of the way from belt to eaves
    roof_drop: float = 0.05  # of the rear end of the roof below its middle
    corner_length: float = 0.50  # over which the ends are rounded, seen from above
    tip_share: float = 0.70  # width of the bumpers' straight part, of the whole
    nose_share: float = 0.78  # height of the nose's tip, of nose_height
    tail_share: float = 0.86  # height of the tail's edge, of deck_height
    bed_depth: float = 0.0  # of a pick-up's open bed below its rim; 0 for a closed deck

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
        if self.bed_depth and not 0.0 < self.bed_depth <= deepest_bed(self.deck_height, self.wheel_radius):
            raise SimulationError("the bed of a pick-up must be above the wheel arches")

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


def deepest_bed(deck_height: float, wheel_radius: float) -> float:
    """Tell how far the floor of a pick-up's bed may lie below its rim: the wheel arches are under it [m]."""
    return deck_height - 2.0 * wheel_radius - ARCH_GAP - 0.07


def resized(shape: CarShape, size: Point) -> CarShape:
    """Give a car of the same proportions another length, width and height [m]; its wheels stay round.

    Raises:
        SimulationError: so small a car is impossible.
    """
    along, across, up = (float(f) for f in size / [shape.length, shape.width, shape.height])
    changes = {
        name: getattr(shape, name) * factor
        for names, factor in zip(_TOGETHER[:3], (along, up, across), strict=True)
        for name in names
    }
    changes["corner_length"] = shape.corner_length * along
    # A wheel is as long as it is high, and follows the smaller change.
    changes["wheel_radius"] = shape.wheel_radius * min(along, up)
    deepest = deepest_bed(changes["deck_height"], changes["wheel_radius"])
    changes["bed_depth"] = min(shape.bed_depth * up, deepest)
    length, width, height = (float(s) for s in size)
    return dataclasses.replace(shape, **changes | {"length": length, "width": width, "height": height})
