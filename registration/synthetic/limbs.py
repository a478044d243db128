"""Limbs of persons: tapered bones, and where a joint is between two that are known."""

import numpy as np
from jaxtyping import Float64

from registration.synthetic.meshes import Material, Mesh, tube
from registration.types import Point


def down(angle: float) -> Point:
    """Point down, leaning forward by `angle` [rad]."""
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def limb(start: Point, end: Point, radius_start: float, radius_end: float, material: Material) -> Mesh:
    """Build one bone with its flesh: a tapered tube with rounded ends."""
    share = np.array([-0.06, 0.0, 0.5, 1.0, 1.06])[:, None]
    centers: Float64[np.ndarray, "k 3"] = start + share * (end - start)
    radii = radius_start + np.clip(share, 0.0, 1.0) * (radius_end - radius_start)
    return tube(centers, radii * np.array([[0.6], [1.0], [1.0], [1.0], [0.6]]) * np.ones(2), material, 8)


def joint(start: Point, end: Point, upper: float, lower: float, toward: Point) -> Point:
    """Find the knee or elbow between two ends of a limb.

    Args:
        start: hip or shoulder [m].
        end: ankle or wrist [m]; one out of reach is taken for the farthest that is in reach.
        upper: length of the bone at the start [m].
        lower: length of the bone at the end [m].
        toward: which way the joint points.

    Returns:
        The joint, `upper` from the start and, if it is in reach, `lower` from the end [m].
    """
    chord = end - start
    distance = float(np.linalg.norm(chord))
    along = chord / distance
    reach = float(np.clip(distance, abs(upper - lower), upper + lower))
    aside = toward - (toward @ along) * along
    aside = aside / np.linalg.norm(aside)
    share = (upper**2 - lower**2 + reach**2) / (2.0 * reach)
    return start + share * along + np.sqrt(max(upper**2 - share**2, 0.0)) * aside
