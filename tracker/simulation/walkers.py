"""Bodies of the persons in a scene: a few looks, and a height and a gait for each."""

from dataclasses import replace
from functools import cache

import numpy as np

from registration.synthetic.bodies import WalkingBody
from registration.synthetic.persons import PersonLook, draw_look

N_LOOKS = 24  # in all scenes: how much room a look takes is work
STANDING = 0.1  # swing of those who stand


def draw_walker(rng: np.random.Generator, is_standing: bool = False) -> WalkingBody:
    """Draw somebody who walks, or who stands with their feet together."""
    look = _look(int(rng.integers(N_LOOKS)), is_standing)
    height, phase = rng.uniform([1.52, 0.0], [1.93, 2.0 * np.pi])
    return WalkingBody(float(height), float(phase), look)


@cache
def _look(number: int, is_standing: bool) -> PersonLook:
    look = draw_look(np.random.default_rng(number))
    return replace(look, swing=STANDING) if is_standing else look
