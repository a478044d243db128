"""Persons who sit: cyclists whose legs turn the pedals, and persons on a bench or a chair."""

from dataclasses import dataclass, replace

import numpy as np

from registration.errors import SimulationError
from registration.synthetic.limbs import joint, limb
from registration.synthetic.meshes import Material, Mesh, ellipsoid, merge, tube
from registration.synthetic.parts import both_sides, hoop, plate, rounded_box
from registration.types import Point

WAY_PER_TURN = 4.9  # of the pedals, for a bicycle of usual size [m]

_WHEEL, _CRANK = 0.34, 0.17  # radii [m]


@dataclass(frozen=True)
class CyclistLook:
    """What tells one cyclist from another.

    Attributes:
        bicycle: its size, 1 for a wheel of 0.68 m.
        height: of the rider, standing [m].
        lean: of the rider's back, forward from upright [rad].
        girth: of the rider's trunk and limbs, 1 for slender.
        breadth: of handlebar and shoulders, 1 for the usual.
        bag: behind the saddle or on the back: one of "none", "pannier", "basket", "backpack".
        has_helmet: a helmet or thick hair.
    """

    bicycle: float = 1.0
    height: float = 1.75
    lean: float = 0.45
    girth: float = 1.1
    breadth: float = 1.0
    bag: str = "none"
    has_helmet: bool = False

    def __post_init__(self) -> None:
        if not 0.4 < self.bicycle < 1.6 or not 0.8 < self.height < 2.4:
            raise SimulationError(
                f"a cyclist is 0.8 to 2.4 m tall on a bicycle of size 0.4 to 1.6, got {self.height} m on {self.bicycle}"
            )


def draw_cyclist_look(rng: np.random.Generator) -> CyclistLook:
    """Draw a grown-up cyclist."""
    return CyclistLook(
        bicycle=float(rng.uniform(0.93, 1.06)),
        height=float(rng.uniform(1.58, 1.90)),
        lean=float(rng.uniform(0.12, 0.75)),
        girth=float(rng.uniform(0.95, 1.35)),
        breadth=float(rng.uniform(0.9, 1.15)),
        bag=str(rng.choice(["none", "pannier", "basket", "backpack"], p=[0.5, 0.15, 0.15, 0.2])),
        has_helmet=bool(rng.uniform() < 0.45),
    )


def cyclist(look: CyclistLook, phase: float = 0.0) -> Mesh:
    """Build a bicycle and its rider; x forward, origin on the ground midway between the wheels' ends.

    Args:
        look: what tells this one from others.
        phase: of the pedals [rad]: 0 with the left one ahead, rising as it sinks.
    """
    scale, size = look.bicycle, look.height / 1.75
    saddle = np.array([-0.22 * scale, 0.0, max(0.62 * scale, 0.30 * scale + 0.35 * look.height)])
    grip = np.array([0.38 * scale, 0.24 * look.breadth, 1.02 * scale])
    parts = _bicycle(scale, saddle, grip)
    hips = saddle + [0.02, 0.0, 0.07 * size]
    for side, turn in ((1.0, phase), (-1.0, phase + np.pi)):
        parts += _pedalling_leg(hips, side, turn, look)
    return merge([*parts, *_upper_body(hips, grip, look), *_luggage(saddle, hips, look)])


def _bicycle(scale: float, saddle: Point, grip: Point) -> list[Mesh]:
    """Build wheels, frame, saddle and handlebar."""
    radius = _WHEEL * scale
    rear, front = np.array([-0.53 * scale, 0.0, radius]), np.array([0.53 * scale, 0.0, radius])
    crank, head = _crank(scale), np.array([0.36 * scale, 0.0, 0.82 * scale])
    stem = np.array([grip[0], 0.0, grip[2]])
    post = saddle + 0.35 * (crank - saddle)
    tubes = [(crank, saddle), (crank, head), (post, head), (rear, crank), (rear, post), (head, front), (head, stem)]
    frame = [tube(np.stack(ends), np.full((2, 2), 0.018 * scale), Material.PAINT_DARK, 6) for ends in tubes]
    bar = tube(np.stack([grip * [1.0, -1.0, 1.0], grip]), np.full((2, 2), 0.014), Material.METAL, 6)
    seat = ellipsoid(saddle + [-0.02, 0.0, 0.0], np.array([0.13, 0.08, 0.035]) * scale, Material.RUBBER, 8)
    wheels = []
    for hub in (rear, front):
        wheels.append(hoop(hub, radius, 0.042 * scale, Material.RUBBER))
        ends = hub + np.array([[0.0, -0.05, 0.0], [0.0, 0.05, 0.0]]) * scale
        wheels.append(tube(ends, np.full((2, 2), 0.03 * scale), Material.METAL, 6))
    return [*wheels, *frame, bar, seat]


def _crank(scale: float) -> Point:
    return np.array([-0.06, 0.0, 0.28]) * scale


def _pedalling_leg(hips: Point, side: float, turn: float, look: CyclistLook) -> list[Mesh]:
    """Build thigh, shin, foot and pedal crank of one leg."""
    size, girth = look.height, float(np.sqrt(look.girth))
    hip = hips + [0.0, 0.052 * size * side, 0.0]
    axle = _crank(look.bicycle) + [0.0, 0.09 * side, 0.0]
    pedal = axle + _CRANK * look.bicycle * np.array([np.cos(turn), 0.0, -np.sin(turn)])
    ankle = pedal + [-0.06 * size / 1.75, 0.0, 0.075 * size / 1.75]
    knee = joint(hip, ankle, 0.245 * size, 0.235 * size, np.array([1.0, 0.0, 0.3]))
    foot = pedal + [0.09, 0.0, 0.02]
    return [
        limb(hip, knee, 0.050 * size * girth, 0.034 * size * girth, Material.CLOTH),
        limb(knee, ankle, 0.035 * size * girth, 0.023 * size * girth, Material.CLOTH),
        limb(ankle - [0.02, 0.0, 0.01], foot, 0.042, 0.03, Material.RUBBER),
        tube(np.stack([axle, pedal]), np.full((2, 2), 0.014), Material.METAL, 6),
    ]


def _upper_body(hips: Point, grip: Point, look: CyclistLook) -> list[Mesh]:
    """Build trunk, head and arms of somebody who holds a handlebar."""
    size, girth = look.height, float(np.sqrt(look.girth))
    back = np.array([np.sin(look.lean), 0.0, np.cos(look.lean)])
    parts = _torso(hips, back, size, look.girth)
    neck = hips + 0.335 * size * back
    head = neck + size * np.array([0.035, 0.0, 0.105])
    parts.append(limb(neck - 0.03 * size * back, head, 0.032 * size, 0.032 * size, Material.SKIN))
    parts.append(ellipsoid(head, size * np.array([0.056, 0.046, 0.07]), Material.SKIN))
    if look.has_helmet:
        parts.append(
            ellipsoid(head + [0.0, 0.0, 0.02 * size], size * np.array([0.075, 0.056, 0.06]), Material.PAINT_LIGHT)
        )
    shoulder = hips + 0.30 * size * back + [0.0, 0.115 * size, 0.0]
    hand = shoulder + min(1.0, 0.335 * size / float(np.linalg.norm(grip - shoulder))) * (grip - shoulder)
    elbow = joint(shoulder, hand, 0.175 * size, 0.165 * size, np.array([-0.3, 0.5, -1.0]))
    arm = [
        limb(shoulder, elbow, 0.033 * size * girth, 0.025 * size * girth, Material.CLOTH),
        limb(elbow, hand, 0.025 * size * girth, 0.020 * size, Material.CLOTH),
        ellipsoid(hand, size * np.array([0.025, 0.025, 0.025]), Material.SKIN, 8),
    ]
    return [*parts, *(mesh for part in arm for mesh in both_sides(part))]


def _torso(hips: Point, back: Point, size: float, girth: float) -> list[Mesh]:
    """Build a trunk from the hips along the back."""
    share = np.array([-0.05, 0.0, 0.08, 0.20, 0.29, 0.335])[:, None]
    radii = np.array([[0.045, 0.08], [0.07, 0.10], [0.065, 0.09], [0.07, 0.11], [0.06, 0.12], [0.03, 0.05]])
    return [tube(hips + share * size * back, radii * size * [girth, np.sqrt(girth)], Material.CLOTH)]


def _luggage(saddle: Point, hips: Point, look: CyclistLook) -> list[Mesh]:
    """Build bags behind the saddle, or one on the back."""
    scale = look.bicycle
    if look.bag == "pannier":
        bag = rounded_box(
            (-0.72 * scale, -0.38 * scale),
            (0.05 * scale, 0.20 * scale),
            (0.36 * scale, 0.72 * scale),
            Material.CLOTH,
            0.04,
        )
        return both_sides(bag)
    if look.bag == "basket":
        return [
            plate(
                (-0.70 * scale, -0.40 * scale),
                (-0.16 * scale, 0.16 * scale),
                (0.74 * scale, 0.94 * scale),
                Material.METAL,
            )
        ]
    if look.bag == "backpack":
        back = np.array([np.sin(look.lean), 0.0, np.cos(look.lean)])
        behind = hips - (0.07 * look.girth + 0.04) * look.height * np.array([back[2], 0.0, -back[0]])
        ends = behind + np.array([[0.09], [0.13], [0.24], [0.28]]) * look.height * back
        radii = look.height * np.array([[0.035, 0.06], [0.055, 0.085], [0.055, 0.085], [0.035, 0.06]])
        return [tube(ends, radii, Material.CLOTH)]
    return []


def sitting_person(rng: np.random.Generator, height: float = 1.72) -> Mesh:
    """Build a person on a seat, facing +x; the origin is on the ground below the middle of the bounding box.

    Args:
        rng: source of build, posture and seat.
        height: of the person when standing [m].
    """
    girth = float(rng.uniform(0.95, 1.35))
    lean = float(rng.uniform(-0.25, 0.30))
    look = CyclistLook(1.0, height, lean, girth, 1.0, "none", bool(rng.uniform() < 0.3))
    seat = height * float(rng.uniform(0.235, 0.275))
    hips = np.array([0.0, 0.0, seat + 0.06 * height])
    knee_x, spread = 0.245 * height, float(rng.uniform(0.05, 0.085)) * height
    ankle_x = knee_x + float(rng.uniform(-0.08, 0.08)) * height
    hands = hips + np.array([float(rng.uniform(0.10, 0.19)) * height, 0.07 * height, 0.06 * height])
    parts = _upper_body(hips, hands, replace(look, girth=girth))
    wide = float(np.sqrt(girth))
    for side in (1.0, -1.0):
        hip, knee = hips + [0.0, 0.05 * height * side, 0.0], np.array([knee_x, spread * side, 0.28 * height])
        ankle = np.array([ankle_x, spread * side, 0.045 * height])
        parts.append(limb(hip, knee, 0.052 * height * wide, 0.035 * height * wide, Material.CLOTH))
        parts.append(limb(knee, ankle, 0.036 * height * wide, 0.024 * height * wide, Material.CLOTH))
        parts.append(
            limb(ankle - [0.03, 0.0, 0.03], ankle + [0.10 * height, 0.0, -0.045], 0.042, 0.03, Material.RUBBER)
        )
    mesh = merge([*parts, *_seat(seat, height, rng)])
    lower, upper = mesh.bounds
    return mesh.shifted(-np.array([*0.5 * (lower + upper)[:2], lower[2]]))


def _seat(top: float, height: float, rng: np.random.Generator) -> list[Mesh]:
    """Build a stool, a chair or a block to sit on."""
    half, rear, front = 0.13 * height, -0.13 * height, 0.12 * height
    if rng.uniform() < 0.3:
        return [plate((rear, front), (-half, half), (0.0, top), Material.MASONRY)]
    board = plate((rear, front), (-half, half), (top - 0.04, top), Material.METAL)
    legs = [
        plate((x - 0.02, x + 0.02), (half - 0.05, half - 0.01), (0.0, top - 0.02), Material.METAL)
        for x in (rear + 0.03, front - 0.03)
    ]
    parts = [board, *(mesh for leg in legs for mesh in both_sides(leg))]
    if rng.uniform() < 0.5:
        back = plate((rear - 0.03, rear), (-half, half), (top - 0.02, top + 0.24 * height), Material.METAL)
        parts.append(back)
    return parts
