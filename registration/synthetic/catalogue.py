"""The sets of pairs that we can generate, by name."""

from pathlib import Path

from registration.errors import PairSetError, unknown_name
from registration.synthetic.kitti_like import kitti_like_names, kitti_like_scenes
from registration.synthetic.pairs import SYNTH_SETS, synth_scenes
from registration.synthetic.production import Recipe


def generated_names() -> list[str]:
    """List the sets that `create_recipe` knows."""
    return [*SYNTH_SETS, *kitti_like_names()]


def create_recipe(name: str, meshes: Path | None = None) -> Recipe:
    """Set up how the pairs of a set come about.

    Args:
        name: one of `generated_names()`.
        meshes: folder of meshes for `synth-*`; None for our own parametric families.

    Raises:
        PairSetError: no such set, or one that takes no meshes.
        RegistrationError: the meshes cannot be used.
    """
    if name in SYNTH_SETS:
        return synth_scenes(name, meshes)
    if name not in kitti_like_names():
        raise PairSetError(unknown_name("set of pairs", name, generated_names()))
    if meshes is not None:
        raise PairSetError(f"{name} needs shapes of given sizes and draws its own: it takes no folder of meshes")
    return kitti_like_scenes(name)
