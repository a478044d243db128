"""Recipes of pairs that tests share: boxes on the synthetic sets' terms, and one that costs nothing."""

from dataclasses import dataclass, replace

import numpy as np

from registration import se3
from registration.pair_set import CloudPair
from registration.synthetic.lidar import SYMMETRIC_64
from registration.synthetic.meshes import Material, Mesh, box_mesh
from registration.synthetic.pairs import CAR_SCALE, Kind, SynthScenes


@dataclass(frozen=True)
class Boxes:
    """Meshes of boxes whose proportions are drawn: off the origin, and of any size."""

    categories: tuple[str, ...] = ("car", "person")

    def draw(self, category: str, part: str, rng: np.random.Generator) -> Mesh:
        width, height = rng.uniform(0.3, 0.5, 2)
        box = box_mesh(20.0 * np.array([1.0, width, height]), Material.PAINT_LIGHT)
        return box.moved(se3.from_yaw(0.0, np.array([3.0, -2.0, 7.0])))

    def describe(self) -> dict[str, object]:
        return {"source": "boxes"}


def synth(beam_model=SYMMETRIC_64, **changes):
    kinds = (Kind(("car",), CAR_SCALE, 0.8), Kind(("person",), (1.6, 2.0), 0.2))
    return replace(SynthScenes("boxes", kinds, Boxes(), beam_model), **changes)


@dataclass(frozen=True)
class Dots:
    """A recipe that costs nothing: two points somewhere."""

    name: str = "dots"
    allow_empty: bool = False
    empty_share: float = 0.0

    def describe(self) -> dict[str, object]:
        return {"empty_share": self.empty_share}

    def check(self, parts) -> None:
        pass

    def draw(self, part: str, rng: np.random.Generator) -> CloudPair | None:
        cloud = rng.normal(size=(0 if rng.uniform() < self.empty_share else 2, 3))
        start = rng.normal(size=3)
        return CloudPair(cloud, cloud + 1.0, start, start + 1.0, 0.1, 0.2, {"part_drawn": part})
