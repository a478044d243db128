"""The traffic scenes that we have, by name."""

import dataclasses

from registration.errors import unknown_name
from tracker.errors import InputError
from tracker.simulation.braking import braking_scene
from tracker.simulation.crossing import crossing_scene
from tracker.simulation.crowd import crowd_scene
from tracker.simulation.highway import highway_scene
from tracker.simulation.parked_row import parked_row_scene
from tracker.simulation.roundabout import roundabout_scene
from tracker.simulation.scenes import Scene, SceneRecipe
from tracker.simulation.street import street_scene

SCENES: dict[str, SceneRecipe] = {
    "urban": street_scene,
    "street": street_scene,  # its first name
    "highway": highway_scene,
    "crossing": crossing_scene,
    "parked-row": parked_row_scene,
    "roundabout": roundabout_scene,
    "crowd": crowd_scene,
    "braking": braking_scene,
}


def create_scene(name: str = "street", seed: int = 0, n_frames: int = 100) -> Scene:
    """Set one of the scenes that we have.

    Raises:
        InputError: no scene has this name, the scene is not that long, or the seed is negative.
    """
    if seed < 0:
        raise InputError(f"expected a seed >= 0, got {seed}")
    if name not in SCENES:
        raise InputError(unknown_name("scene", name, SCENES))
    return dataclasses.replace(SCENES[name](seed, n_frames), name=name)
