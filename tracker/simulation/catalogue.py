"""The traffic scenes that we have, by name."""

import dataclasses
from collections.abc import Callable

from registration.errors import unknown_name
from tracker.errors import InputError
from tracker.simulation.crossing import crossing_scene
from tracker.simulation.crowd import crowd_scene
from tracker.simulation.highway import highway_scene
from tracker.simulation.parked_row import parked_row_scene
from tracker.simulation.roundabout import roundabout_scene
from tracker.simulation.scenes import Scene
from tracker.simulation.street import street_scene

# A scene by name: a function of a seed and a number of frames.
SCENES: dict[str, Callable[[int, int], Scene]] = {
    "urban": street_scene,
    "street": street_scene,  # its first name
    "highway": highway_scene,
    "crossing": crossing_scene,
    "parked-row": parked_row_scene,
    "roundabout": roundabout_scene,
    "crowd": crowd_scene,
}


def create_scene(name: str = "street", seed: int = 0, n_frames: int = 100) -> Scene:
    """Set one of the scenes that we have.

    Raises:
        InputError: no scene has this name, or the scene is not that long.
    """
    if name not in SCENES:
        raise InputError(unknown_name("scene", name, SCENES))
    return dataclasses.replace(SCENES[name](seed, n_frames), name=name)
