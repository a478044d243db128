"""Families of cars and vans, as ranges of their sizes and proportions."""

from collections.abc import Mapping
from dataclasses import dataclass, field

Range = tuple[float, float]


@dataclass(frozen=True)
class CarKind:
    """A family of cars; every range is drawn from evenly.

    Attributes:
        size: ranges of length, width and height [m]; they grow together.
        along: of hood, windscreen, backlight, deck, wheelbase and front overhang, in lengths.
        up: of nose, cowl, belt and deck, in heights.
        clearance: of the floor above the ground [m].
        wheel_radius: [m].
        tumblehome_deg: lean of the side windows.
        share: how often it is drawn.
        fixed: measures that all have alike.
        third_window: share of them with a third side window.
        rails: share of them with rails on the roof.
        cladding: share of them with sills of black plastic.
        no_rear_windows: share of them without windows behind the front doors.
        has_bed: they are pick-ups.
    """

    size: tuple[Range, Range, Range]
    along: tuple[Range, Range, Range, Range, Range, Range]
    up: tuple[Range, Range, Range, Range]
    clearance: Range = (0.15, 0.20)
    wheel_radius: Range = (0.29, 0.34)
    tumblehome_deg: Range = (15.0, 21.0)
    share: float = 1.0
    fixed: Mapping[str, float] = field(default_factory=dict)
    third_window: float = 0.0
    rails: float = 0.0
    cladding: float = 0.1
    no_rear_windows: float = 0.0
    has_bed: bool = False


CARS: dict[str, CarKind] = {
    "city car": CarKind(
        ((3.30, 3.75), (1.50, 1.70), (1.40, 1.58)),
        ((0.18, 0.23), (0.19, 0.25), (0.06, 0.12), (0.010, 0.030), (0.64, 0.685), (0.175, 0.20)),
        ((0.47, 0.53), (0.63, 0.69), (0.60, 0.65), (0.64, 0.69)), wheel_radius=(0.265, 0.30), share=1.3,
    ),
    "hatchback": CarKind(
        ((3.75, 4.40), (1.62, 1.82), (1.40, 1.55)),
        ((0.215, 0.255), (0.18, 0.225), (0.085, 0.14), (0.015, 0.040), (0.595, 0.640), (0.19, 0.215)),
        ((0.47, 0.52), (0.64, 0.69), (0.61, 0.66), (0.66, 0.71)), share=2.5, third_window=0.15,
    ),
    "sedan": CarKind(
        ((4.15, 5.05), (1.66, 1.90), (1.37, 1.50)),
        ((0.235, 0.285), (0.165, 0.205), (0.135, 0.185), (0.08, 0.14), (0.565, 0.605), (0.18, 0.205)),
        ((0.47, 0.52), (0.65, 0.69), (0.62, 0.66), (0.70, 0.75)), share=1.7, wheel_radius=(0.30, 0.345), cladding=0.05,
    ),
    "estate": CarKind(
        ((4.30, 5.00), (1.68, 1.88), (1.41, 1.55)),
        ((0.235, 0.275), (0.165, 0.20), (0.065, 0.115), (0.012, 0.030), (0.565, 0.605), (0.18, 0.205)),
        ((0.46, 0.51), (0.64, 0.68), (0.61, 0.65), (0.65, 0.70)), share=1.5, wheel_radius=(0.30, 0.345),
        third_window=0.95, rails=0.7,
    ),
    "suv": CarKind(
        ((4.00, 5.00), (1.72, 1.98), (1.58, 1.88)),
        ((0.215, 0.265), (0.145, 0.195), (0.05, 0.115), (0.012, 0.030), (0.565, 0.615), (0.18, 0.205)),
        ((0.50, 0.56), (0.63, 0.68), (0.61, 0.66), (0.65, 0.70)), clearance=(0.19, 0.27), wheel_radius=(0.335, 0.385),
        tumblehome_deg=(11.0, 18.0), share=1.3, third_window=0.6, rails=0.7, cladding=0.6,
    ),
    "coupe": CarKind(
        ((3.95, 4.75), (1.68, 1.92), (1.24, 1.40)),
        ((0.270, 0.335), (0.175, 0.215), (0.185, 0.245), (0.05, 0.09), (0.56, 0.605), (0.185, 0.21)),
        ((0.52, 0.57), (0.66, 0.71), (0.64, 0.69), (0.69, 0.74)), clearance=(0.12, 0.16), wheel_radius=(0.30, 0.35),
        tumblehome_deg=(18.0, 24.0), share=0.6, fixed={"pillar_share": 0.85},
    ),
    "minivan": CarKind(
        ((3.90, 4.95), (1.66, 1.92), (1.56, 1.80)),
        ((0.155, 0.205), (0.195, 0.255), (0.045, 0.095), (0.010, 0.025), (0.58, 0.635), (0.185, 0.21)),
        ((0.45, 0.51), (0.60, 0.65), (0.58, 0.62), (0.61, 0.66)), tumblehome_deg=(11.0, 17.0), share=1.2,
        third_window=0.85, rails=0.4,
    ),
    "pick-up": CarKind(
        ((4.75, 5.40), (1.72, 1.95), (1.68, 1.88)),
        ((0.205, 0.235), (0.125, 0.155), (0.025, 0.045), (0.270, 0.335), (0.575, 0.615), (0.165, 0.19)),
        ((0.52, 0.57), (0.63, 0.67), (0.61, 0.65), (0.635, 0.67)), clearance=(0.22, 0.30), wheel_radius=(0.34, 0.38),
        tumblehome_deg=(12.0, 17.0), share=0.35, fixed={"tail_share": 0.985, "roof_drop": 0.03},
        cladding=0.5, has_bed=True,
    ),
}  # fmt: skip

VANS: dict[str, CarKind] = {
    "delivery van": CarKind(
        ((3.85, 4.65), (1.64, 1.85), (1.74, 1.98)),
        ((0.165, 0.215), (0.175, 0.225), (0.020, 0.040), (0.010, 0.018), (0.59, 0.645), (0.185, 0.21)),
        ((0.43, 0.49), (0.55, 0.60), (0.53, 0.57), (0.56, 0.60)), tumblehome_deg=(6.0, 10.0), share=1.0,
        fixed={"roof_drop": 0.03, "tail_share": 0.9, "corner_length": 0.4}, no_rear_windows=0.5, rails=0.15,
        cladding=0.4,
    ),
    "panel van": CarKind(
        ((4.65, 5.45), (1.80, 2.00), (1.88, 2.15)),
        ((0.115, 0.165), (0.145, 0.185), (0.018, 0.032), (0.008, 0.015), (0.57, 0.62), (0.165, 0.19)),
        ((0.40, 0.46), (0.55, 0.60), (0.53, 0.57), (0.55, 0.59)), clearance=(0.17, 0.22), wheel_radius=(0.31, 0.345),
        tumblehome_deg=(4.5, 8.0), share=1.2, fixed={"roof_drop": 0.03, "tail_share": 0.9, "corner_length": 0.35},
        no_rear_windows=0.55, cladding=0.5,
    ),
    "high van": CarKind(
        ((5.10, 6.90), (1.92, 2.08), (2.25, 2.80)),
        ((0.105, 0.150), (0.120, 0.155), (0.012, 0.022), (0.006, 0.012), (0.56, 0.63), (0.145, 0.175)),
        ((0.36, 0.41), (0.45, 0.50), (0.44, 0.475), (0.46, 0.50)), clearance=(0.19, 0.25), wheel_radius=(0.33, 0.365),
        tumblehome_deg=(2.5, 4.5), share=0.9,
        fixed={"roof_drop": 0.04, "tail_share": 0.9, "corner_length": 0.32, "window_top": 0.62},
        no_rear_windows=0.75, cladding=0.6,
    ),
}  # fmt: skip
