"""Walking persons: a torso, a head, and limbs that swing with the phase of the gait."""

import numpy as np
from jaxtyping import Float64

from registration.errors import SimulationError
from registration.synthetic.meshes import Material, Mesh, ellipsoid, merge, tube
from registration.types import Point

STRIDE_PER_HEIGHT = 0.82  # way of one full gait cycle (two steps), in body heights


def person(height: float = 1.75, phase: float = 0.0) -> Mesh:
    """Build a person who walks along +x, the lower foot on the ground.

    Args:
        height: when standing upright [m].
        phase: of the gait [rad]: 0 with the legs together, pi/2 with the left leg farthest ahead.

    Returns:
        The mesh; origin on the ground below the hips.

    Raises:
        SimulationError: the height is none of a person.
    """
    if not 0.5 < height < 2.5:
        raise SimulationError(f"a person is between 0.5 and 2.5 m tall, got {height} m")
    parts = [*_trunk(), *_leg(phase, 0.05), *_leg(phase + np.pi, -0.05)]
    parts += [*_arm(phase + np.pi, 0.125), *_arm(phase, -0.125)]
    body = merge(parts)
    vertices = body.vertices - [0.0, 0.0, body.vertices[:, 2].min()]  # the hips sink as the legs spread
    return Mesh(height * vertices, body.triangles, body.material)


def person_size(height: float = 1.75) -> Point:
    """Give the box (length, width, height) about the origin that holds a person in every phase [m]."""
    bounds = [person(height, phase).bounds for phase in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)]
    reach = np.max([np.maximum(-lower, upper) for lower, upper in bounds], axis=0)
    return np.array([2.0 * reach[0], 2.0 * reach[1], reach[2]])


def _trunk() -> list[Mesh]:
    """Build torso, neck and head, in body heights."""
    heights = np.array([0.47, 0.52, 0.60, 0.72, 0.79, 0.825])
    radii = np.array([[0.06, 0.09], [0.07, 0.10], [0.06, 0.085], [0.07, 0.11], [0.065, 0.12], [0.03, 0.05]])
    torso = tube(np.outer(heights, [0.0, 0.0, 1.0]), radii, Material.CLOTH)
    neck = tube(np.array([[0.0, 0.0, 0.80], [0.008, 0.0, 0.88]]), np.full((2, 2), 0.032), Material.SKIN)
    head = ellipsoid(np.array([0.012, 0.0, 0.93]), np.array([0.056, 0.046, 0.07]), Material.SKIN)
    return [torso, neck, head]


def _leg(phase: float, y: float) -> list[Mesh]:
    """Build thigh, shin and foot of one leg, in body heights; the knee bends while the leg swings forward."""
    thigh = np.deg2rad(4.0 + 24.0 * np.sin(phase))
    knee = np.deg2rad(6.0 + 50.0 * max(0.0, np.cos(phase)) ** 2)
    hip = np.array([0.0, y, 0.49])
    knee_at = hip + 0.24 * _down(thigh)
    ankle = knee_at + 0.215 * _down(thigh - knee)
    toe = ankle + np.array([0.105, 0.0, -0.018])
    return [
        _limb(hip, knee_at, 0.052, 0.035, Material.CLOTH),
        _limb(knee_at, ankle, 0.036, 0.023, Material.CLOTH),
        _limb(ankle - [0.03, 0.0, 0.012], toe, 0.024, 0.018, Material.RUBBER),
    ]


def _arm(phase: float, y: float) -> list[Mesh]:
    """Build upper arm, forearm and hand of one arm, in body heights."""
    swing = np.deg2rad(20.0 * np.sin(phase))
    elbow_bend = np.deg2rad(15.0 + 12.0 * np.sin(phase))
    shoulder = np.array([0.0, y, 0.79])
    elbow = shoulder + 0.17 * _down(swing) + [0.0, 0.08 * y, 0.0]
    wrist = elbow + 0.15 * _down(swing + elbow_bend)
    hand = wrist + 0.07 * _down(swing + elbow_bend)
    return [
        _limb(shoulder, elbow, 0.032, 0.024, Material.CLOTH),
        _limb(elbow, wrist, 0.024, 0.018, Material.CLOTH),
        _limb(wrist, hand, 0.02, 0.014, Material.SKIN),
    ]


def _down(angle: float) -> Point:
    """Point down, leaning forward by `angle` [rad]."""
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def _limb(start: Point, end: Point, radius_start: float, radius_end: float, material: Material) -> Mesh:
    """Build one bone with its flesh: a tapered tube with rounded ends."""
    share = np.array([-0.06, 0.0, 0.5, 1.0, 1.06])[:, None]
    centers: Float64[np.ndarray, "k 3"] = start + share * (end - start)
    radii = radius_start + np.clip(share, 0.0, 1.0) * (radius_end - radius_start)
    return tube(centers, radii * np.array([[0.6], [1.0], [1.0], [1.0], [0.6]]) * np.ones(2), material, 8)
