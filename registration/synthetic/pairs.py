"""The synthetic sets of AlignNet-3D: one mesh somewhere around the sensor, scanned at two poses.

Source: AlignNet-3D (3DV 2019), section 4, and the ranges that it states; the object's own centre is that of its
bounding box, as in the released code.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from registration import planar, se3
from registration.errors import PairSetError, unknown_name
from registration.pair_set import CloudPair
from registration.synthetic.aim import beams_towards
from registration.synthetic.library import FolderSource, MeshSource, ParametricSource
from registration.synthetic.lidar import SYMMETRIC_64, BeamModel, PlacedMesh, scan
from registration.synthetic.mesh_files import read_mesh
from registration.synthetic.meshes import Mesh, normalised
from registration.types import Point, Points, Transform

MAX_SHIFT = 1.0  # of the centre between the two poses [m]
MAX_TURN = 0.5 * np.pi  # between the two poses, either way [rad]
RADIUS = (2.0, 80.0)  # distance of the first pose's centre [m]
CAR_SCALE, PERSON_SCALE, ANY_SCALE = (2.5, 4.5), (1.6, 2.0), (1.0, 5.0)  # largest extent [m]
PERSON_SHARE = 0.2
CARS, PERSONS = ("car",), ("person",)

SYNTH_SETS = ("synth-cars", "synth-cars-persons", "synth-20", "synth-20-others")


@dataclass(frozen=True)
class Kind:
    """Meshes that are drawn alike.

    Attributes:
        categories: their categories; each is as likely.
        scale: smallest and largest length of the longest side of the bounding box [m].
        share: of the set.
    """

    categories: tuple[str, ...]
    scale: tuple[float, float]
    share: float = 1.0


@dataclass(frozen=True)
class SynthScenes:
    """Recipe of a synthetic set: bearing, headings and the shift's direction are uniform, and so is the distance.

    The object's centre is at the sensor's height.  Both clouds are scans of their own of the same mesh, without
    ground and without anything else; their truth is exact.  A sensor inside the object's bounding box sees nothing of
    use: unlike the released generator's, such scenes are drawn again.

    Attributes:
        name: of the set.
        kinds: what is scanned.
        meshes: where meshes come from; those of two parts have none in common.
        beam_model: the sensor.
        radius: least and largest distance of the first pose [m].
        allow_empty: whether a cloud may be empty, as in the released generator.
    """

    name: str
    kinds: tuple[Kind, ...]
    meshes: MeshSource
    beam_model: BeamModel = SYMMETRIC_64
    radius: tuple[float, float] = RADIUS
    allow_empty: bool = False

    def describe(self) -> dict[str, Any]:
        """Tell all that decides what pairs come out."""
        kinds = [{"categories": list(k.categories), "scale": list(k.scale), "share": k.share} for k in self.kinds]
        return {
            "kinds": kinds,
            "meshes": self.meshes.describe(),
            "beam_model": self.beam_model.name,
            "radius": list(self.radius),
            "max_shift": MAX_SHIFT,
            "max_turn": MAX_TURN,
            "allow_empty": self.allow_empty,
        }

    def check(self, parts: Sequence[str]) -> None:
        """Read every mesh file that scenes of some parts may need.

        Raises:
            SimulationError: a file is broken, or a part has none of a category.
        """
        if isinstance(self.meshes, FolderSource):
            for category in (category for kind in self.kinds for category in kind.categories):
                for part in parts:
                    self.meshes.draw(category, part, np.random.default_rng(0))
                    for file in self.meshes.files(category, part):
                        normalised(read_mesh(file.path))

    def draw(self, part: str, rng: np.random.Generator) -> CloudPair | None:
        """Draw an object and two poses, and scan both; None where the sensor is inside the object."""
        kind = self.kinds[int(rng.choice(len(self.kinds), p=[k.share for k in self.kinds]))]
        category = kind.categories[int(rng.integers(len(kind.categories)))]
        scale = float(rng.uniform(*kind.scale))
        mesh = normalised(self.meshes.draw(category, part, rng), scale)
        poses = draw_poses(rng, self.radius)
        if any(_holds_sensor(mesh, T_lidar_obj) for T_lidar_obj in poses):
            return None
        source, target = (self._look(mesh, T_lidar_obj, rng) for T_lidar_obj in poses)
        (start, start_angle), (end, end_angle) = ((T[:3, 3].copy(), se3.yaw(T)) for T in poses)
        extra = {"cat": category, "mesh_scale": scale}
        # As in the authors' sets, the turn is the difference of the angles, which may leave (-pi, pi].
        end_angle = start_angle + planar.wrap(end_angle - start_angle)
        return CloudPair(source, target, start, end, start_angle, end_angle, extra)

    def _look(self, mesh: Mesh, T_lidar_obj: Transform, rng: np.random.Generator) -> Points:
        lower, upper = mesh.bounds
        sensor = beams_towards(self.beam_model, T_lidar_obj, upper - lower)
        return scan([PlacedMesh(mesh, T_lidar_obj)], sensor, rng).points_lidar


def draw_poses(rng: np.random.Generator, radius: tuple[float, float] = RADIUS) -> tuple[Transform, Transform]:
    """Draw where an object is, `radius` [m] away, and where it is a moment later: T_lidar_obj each."""
    bearing, heading, direction = rng.uniform(-np.pi, np.pi, 3)
    start = rng.uniform(*radius) * _unit(bearing)
    shift = rng.uniform(0.0, MAX_SHIFT) * _unit(direction)
    turn = rng.uniform(-MAX_TURN, MAX_TURN)
    return se3.from_yaw(float(heading), start), se3.from_yaw(float(heading + turn), start + shift)


def synth_scenes(name: str, meshes: Path | None = None) -> SynthScenes:
    """Set up the recipe of a synthetic set.

    `synth-20` and `synth-20-others` share the categories that there are, in alphabetical order, half and half: of
    ModelNet40's forty, the first and the last twenty.  (The paper does not list its own twenty.)

    Args:
        name: one of SYNTH_SETS.
        meshes: folder of meshes in ModelNet40's layout; None for our own parametric families.

    Raises:
        PairSetError: no such set, or the meshes do not have what it needs.
        RegistrationError: the folder cannot be used.
    """
    if name not in SYNTH_SETS:
        raise PairSetError(unknown_name("set of pairs", name, SYNTH_SETS))
    source = ParametricSource() if meshes is None else FolderSource(meshes)
    return SynthScenes(name, _kinds(name, source.categories), source)


def _kinds(name: str, categories: Sequence[str]) -> tuple[Kind, ...]:
    """Tell what a set scans, of the categories that there are."""
    if name in ("synth-20", "synth-20-others"):
        known = sorted(categories)
        half = (len(known) + 1) // 2
        chosen = known[:half] if name == "synth-20" else known[half:]
        if not chosen:
            raise PairSetError(f"{name} needs meshes of two categories at least, got {', '.join(known) or 'none'}")
        return (Kind(tuple(chosen), ANY_SCALE),)
    cars = _present(CARS, categories, name)
    if name == "synth-cars":
        return (Kind(cars, CAR_SCALE),)
    persons = _present(PERSONS, categories, name)
    return Kind(cars, CAR_SCALE, 1.0 - PERSON_SHARE), Kind(persons, PERSON_SCALE, PERSON_SHARE)


def _present(wanted: Sequence[str], categories: Sequence[str], name: str) -> tuple[str, ...]:
    chosen = tuple(category for category in wanted if category in categories)
    if not chosen:
        raise PairSetError(
            f"{name} needs meshes of the category {' or '.join(wanted)}, got {', '.join(sorted(categories)) or 'none'}"
        )
    return chosen


def _unit(angle: float) -> Point:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def _holds_sensor(mesh: Mesh, T_lidar_obj: Transform) -> bool:
    """Tell whether the sensor is within a mesh's bounding box."""
    lower, upper = mesh.bounds
    sensor = se3.invert(T_lidar_obj)[:3, 3]
    return bool((lower <= sensor).all() and (sensor <= upper).all())
