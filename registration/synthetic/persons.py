"""Walking persons: a torso, a head, and limbs that swing with the phase of the gait; what they wear and carry."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from registration.errors import SimulationError
from registration.synthetic.limbs import down, limb
from registration.synthetic.meshes import Material, Mesh, ellipsoid, merge, tube
from registration.synthetic.parts import plate, rounded_box
from registration.types import Point

STRIDE_PER_HEIGHT = 0.82  # way of one full gait cycle (two steps) at the full swing, in body heights

CLOTHES = ("trousers", "skirt", "coat")
BAGS = ("none", "backpack", "handbag")


@dataclass(frozen=True)
class PersonLook:
    """What tells one person from another, their height apart.

    Attributes:
        girth: of trunk and limbs, 1 for slender.
        shoulders: breadth of shoulders and hips, 1 for the usual.
        swing: of legs and arms, 1 for a brisk walk, near 0 for standing.
        arm_splay: how far the arms stand off the body [rad].
        clothes: one of `CLOTHES`.
        bag: one of `BAGS`.
        has_hat: a cap, or thick hair.
    """

    girth: float = 1.0
    shoulders: float = 1.0
    swing: float = 1.0
    arm_splay: float = 0.0
    clothes: str = "trousers"
    bag: str = "none"
    has_hat: bool = False

    def __post_init__(self) -> None:
        if self.clothes not in CLOTHES or self.bag not in BAGS:
            raise SimulationError(
                f"a person wears one of {', '.join(CLOTHES)} and carries one of {', '.join(BAGS)}, "
                f"got {self.clothes!r} and {self.bag!r}"
            )


PLAIN = PersonLook()


def draw_look(rng: np.random.Generator) -> PersonLook:
    """Draw what a person looks like."""
    return PersonLook(
        girth=float(rng.uniform(0.92, 1.35)),
        shoulders=float(rng.uniform(0.92, 1.10)),
        swing=float(rng.uniform(0.55, 1.1)),
        arm_splay=float(rng.uniform(0.0, 0.22)),
        clothes=str(rng.choice(CLOTHES, p=[0.68, 0.12, 0.20])),
        bag=str(rng.choice(BAGS, p=[0.60, 0.22, 0.18])),
        has_hat=bool(rng.uniform() < 0.4),
    )


def person(height: float = 1.75, phase: float = 0.0, look: PersonLook = PLAIN) -> Mesh:
    """Build a person who walks along +x, the lower foot on the ground.

    Args:
        height: when standing upright [m].
        phase: of the gait [rad]: 0 with the legs together, pi/2 with the left leg farthest ahead.
        look: what tells this person from others.

    Returns:
        The mesh; origin on the ground below the hips.

    Raises:
        SimulationError: the height is none of a person.
    """
    if not 0.5 < height < 2.5:
        raise SimulationError(f"a person is between 0.5 and 2.5 m tall, got {height} m")
    hip, shoulder = 0.05 * look.shoulders, 0.125 * look.shoulders
    parts = [*_trunk(look), *_leg(phase, hip, look), *_leg(phase + np.pi, -hip, look)]
    parts += [*_arm(phase + np.pi, shoulder, look), *_arm(phase, -shoulder, look)]
    parts += [*_clothes(phase, look), *_bag(look)]
    body = merge(parts)
    vertices = body.vertices - [0.0, 0.0, body.vertices[:, 2].min()]  # the hips sink as the legs spread
    return Mesh(height * vertices, body.triangles, body.material)


def person_size(height: float = 1.75, look: PersonLook = PLAIN) -> Point:
    """Give the box (length, width, height) about the origin that holds a person in every phase [m]."""
    return height * _size_per_height(look)


@lru_cache(maxsize=1024)
def _size_per_height(look: PersonLook) -> Point:
    """Give the box of `person_size` in body heights: persons of one look differ by nothing but their scale."""
    # The second half of the gait is the first with the sides swapped.
    bounds = [person(1.0, phase, look).bounds for phase in np.linspace(0.0, np.pi, 8, endpoint=False)]
    reach = np.max([np.maximum(-lower, upper) for lower, upper in bounds], axis=0)
    return np.array([2.0 * reach[0], 2.0 * reach[1], reach[2]])


def _trunk(look: PersonLook) -> list[Mesh]:
    """Build torso, neck and head, in body heights."""
    heights = np.array([0.47, 0.52, 0.60, 0.72, 0.79, 0.825])
    radii = np.array([[0.06, 0.09], [0.07, 0.10], [0.06, 0.085], [0.07, 0.11], [0.065, 0.12], [0.03, 0.05]])
    coat = 1.12 if look.clothes == "coat" else 1.0
    radii = radii * coat * [look.girth, np.sqrt(look.girth) * look.shoulders]
    torso = tube(np.outer(heights, [0.0, 0.0, 1.0]), radii, Material.CLOTH)
    neck = tube(np.array([[0.0, 0.0, 0.80], [0.008, 0.0, 0.88]]), np.full((2, 2), 0.032), Material.SKIN)
    head = ellipsoid(np.array([0.012, 0.0, 0.93]), np.array([0.056, 0.046, 0.07]), Material.SKIN)
    hat = [ellipsoid(np.array([-0.004, 0.0, 0.958]), np.array([0.062, 0.056, 0.05]), Material.CLOTH)]
    return [torso, neck, head, *(hat if look.has_hat else [])]


def _leg(phase: float, y: float, look: PersonLook) -> list[Mesh]:
    """Build thigh, shin and foot of one leg, in body heights; the knee bends while the leg swings forward."""
    thigh = np.deg2rad(4.0 + 24.0 * look.swing * np.sin(phase))
    knee = np.deg2rad(6.0 + 50.0 * look.swing * max(0.0, np.cos(phase)) ** 2)
    hip = np.array([0.0, y, 0.49])
    knee_at = hip + 0.24 * down(thigh)
    ankle = knee_at + 0.215 * down(thigh - knee)
    toe = ankle + np.array([0.105, 0.0, -0.018])
    girth = float(np.sqrt(look.girth))
    shin = Material.SKIN if look.clothes == "skirt" else Material.CLOTH
    return [
        limb(hip, knee_at, 0.052 * girth, 0.035 * girth, Material.CLOTH),
        limb(knee_at, ankle, 0.036 * girth, 0.023 * girth, shin),
        limb(ankle - [0.03, 0.0, 0.012], toe, 0.024, 0.018, Material.RUBBER),
    ]


def _arm(phase: float, y: float, look: PersonLook) -> list[Mesh]:
    """Build upper arm, forearm and hand of one arm, in body heights."""
    swing = np.deg2rad(20.0 * look.swing * np.sin(phase))
    elbow_bend = np.deg2rad(15.0 + 12.0 * look.swing * np.sin(phase))
    shoulder = np.array([0.0, y, 0.79])
    out = np.array([0.0, np.sign(y) * np.tan(look.arm_splay), 0.0])
    elbow = shoulder + 0.17 * (down(swing) + out) + [0.0, 0.08 * y, 0.0]
    wrist = elbow + 0.15 * (down(swing + elbow_bend) + 0.6 * out)
    hand = wrist + 0.07 * down(swing + elbow_bend)
    girth = float(np.sqrt(look.girth))
    return [
        limb(shoulder, elbow, 0.032 * girth, 0.024 * girth, Material.CLOTH),
        limb(elbow, wrist, 0.024 * girth, 0.018 * girth, Material.CLOTH),
        limb(wrist, hand, 0.02, 0.014, Material.SKIN),
    ]


def _clothes(phase: float, look: PersonLook) -> list[Mesh]:
    """Build what hangs from the hips over the thighs, wide enough for the step, in body heights."""
    if look.clothes == "trousers":
        return []
    spread = np.deg2rad(4.0 + 24.0 * look.swing * abs(np.sin(phase)))
    hem = 0.27 if look.clothes == "skirt" else 0.34
    heights = np.array([hem, 0.40, 0.50, 0.58])
    girth = float(np.sqrt(look.girth))
    reach = (0.50 - heights).clip(0.0) * np.sin(spread) + 0.065 * girth
    side = 0.05 * look.shoulders + 0.058 * girth + 0.02 * (0.58 - heights) / 0.3
    reach[2:], side[2:] = np.array([0.08, 0.07]) * girth, np.array([0.112, 0.10]) * girth * look.shoulders
    return [tube(np.outer(heights, [0.0, 0.0, 1.0]), np.column_stack([reach, side]), Material.CLOTH)]


def _bag(look: PersonLook) -> list[Mesh]:
    """Build what is carried, in body heights."""
    back = -0.055 * look.girth
    if look.bag == "backpack":
        pack = rounded_box((back - 0.10, back), (-0.085, 0.085), (0.56, 0.81), Material.CLOTH, 0.03)
        return [pack]
    if look.bag == "handbag":
        y = -0.15 * look.shoulders - 0.19 * float(np.tan(look.arm_splay))
        bag = rounded_box((-0.07, 0.09), (y - 0.03, y + 0.03), (0.36, 0.50), Material.CLOTH, 0.015)
        strap = plate((0.0, 0.02), (y - 0.006, y + 0.006), (0.49, 0.80), Material.CLOTH)
        return [bag, strap]
    return []
