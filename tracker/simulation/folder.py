"""Scenes become KITTI tracking folders: scans ray-cast, labels, GPS/IMU records, and the exact truth beside them."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from registration import se3
from registration.synthetic.lidar import HDL_64E, BeamModel, PlacedMesh, Sweep, Turn, scan, twist_between
from registration.synthetic.meshes import Material, Mesh, box_mesh
from registration.types import Point, Transform
from tracker.errors import InputError
from tracker.kitti import writer
from tracker.kitti.truth import format_header, format_truth
from tracker.simulation.jitter import BoxJitter, jittered
from tracker.simulation.recorder import record
from tracker.simulation.recording import TakenFrame
from tracker.simulation.scenes import Actor, Scene
from tracker.types import Box

LABEL_RANGE = 80.0  # boxes farther away get no label, horizontally [m]
STEP = 1e-3  # of differences that stand for derivatives [s]
AIR = 0.05  # that a label leaves on each side and on top, as annotators do; its bottom is the ground [m]

Progress = Callable[[int, int], None]  # called with the number of frames done, and of all


@dataclass(frozen=True)
class Recording:
    """How a scene is recorded.

    Attributes:
        beam_model: the sensor.
        rolling_shutter: a sweep takes its time, and things move meanwhile; otherwise it is taken at one moment.  Labels
            and truth are then of the moment at which the beams meet each object, as people label what they see.
        box_jitter: how far the labels lie off the truth, None for exact ones; `truth` is exact in any case.
    """

    beam_model: BeamModel = HDL_64E
    rolling_shutter: bool = False
    box_jitter: BoxJitter | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """What a simulation's record says of it."""
        return {
            "beam_model": self.beam_model.name,
            "beam_digest": digest(json.dumps(asdict(self.beam_model), default=_plain).encode()),
            "rolling_shutter": self.rolling_shutter,
            "box_jitter": None if self.box_jitter is None else asdict(self.box_jitter),
        }


@dataclass(frozen=True, slots=True)
class SimulatedFrame:
    """One sweep and its labels.

    Attributes:
        sweep: the returns; `object_index` counts the scene's actors, then the background.
        boxes: of the actors that are labelled, in the scene's order; each where the beams meet it.
        box_times: when they do [s].
        T_world_lidar: pose of the sensor when the beams point forward.
    """

    sweep: Sweep
    boxes: tuple[Box, ...]
    box_times: tuple[float, ...]
    T_world_lidar: Transform


def simulate(
    scene: Scene,
    out: Path,
    sequence: str = "0000",
    seed: int = 0,
    progress: Progress | None = None,
    recording: Recording = Recording(),
) -> Path:
    """Ray-cast a scene and write it as a sequence of a KITTI tracking folder.

    Everything lies below `out/training`: `velodyne`, `label_02`, `calib`, `oxts`, `times` as KITTI's, and
    `truth/NNNN.csv` with the exact poses of the centres of all labelled boxes.  The sequence is written beside its
    place and moved there when it is complete; one of the same name from an earlier simulation is replaced.  An
    interrupted run of the same scene, seed and recording goes on where it stopped.

    Args:
        scene: what there is to see.
        out: root of the folder; made where it is missing.
        sequence: name of the sequence in it.
        seed: of the sensor's noise; every frame has random numbers of its own, whatever came before it.
        progress: called after each frame.
        recording: with which sensor, and how it is labelled.

    Returns:
        `out`.

    Raises:
        DataError: `out` holds something that no simulation has written.
        InputError: the sequence's name is no plain word.
        MissingLibraryError: Open3D cannot be imported.
    """
    take = SceneTake(scene, seed, recording)
    told = None if progress is None else lambda name, done, total: progress(done, total)
    return record({sequence: lambda: take}, out, told)


@dataclass(frozen=True)
class SceneTake:
    """A scene as a sequence to be written."""

    scene: Scene
    seed: int
    recording: Recording

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"expected a seed >= 0, got {self.seed}")

    @property
    def n_frames(self) -> int:
        """Number of its frames."""
        return self.scene.n_frames

    @property
    def settings(self) -> dict[str, Any]:
        """All that decides what it looks like."""
        content = {"scene": self.scene.name, "scene_digest": _fingerprint(self.scene), "n_frames": self.n_frames}
        return {**content, "seed": self.seed, **self.recording.settings}

    @property
    def heads(self) -> dict[str, str]:
        """How each of its text files starts."""
        calib = writer.format_calib(self.scene.calibration)
        return {"calib": calib, "truth": format_header(has_world=True), "label_02": "", "oxts": "", "times": ""}

    def frame(self, index: int) -> TakenFrame:
        """Make one frame."""
        recording, time = self.recording, index * self.scene.period
        simulated = simulate_frame(self.scene, index, self.seed, recording.beam_model, recording.rolling_shutter)
        labels = label_boxes(simulated.boxes, index, recording.box_jitter, (self.seed,))
        rows = {
            "label_02": "".join(writer.format_label(box, index, self.scene.calibration) for box in labels),
            "truth": "".join(
                format_truth(index, [box], self.scene.T_world_lidar(met))
                for box, met in zip(simulated.boxes, simulated.box_times, strict=True)
            ),
            "oxts": writer.format_oxts(ego_state(self.scene, time)),
            "times": writer.format_time(round(time * 1e9)),
        }
        return TakenFrame(simulated.sweep.points_lidar, simulated.sweep.intensity, rows)


def label_boxes(boxes: tuple[Box, ...], frame: int, jitter: BoxJitter | None, seed: tuple[int, ...]) -> tuple[Box, ...]:
    """Give the boxes that become labels: the exact ones, or what a person would draw."""
    return boxes if jitter is None else tuple(jittered(box, frame, jitter, seed) for box in boxes)


def simulate_frame(
    scene: Scene, frame: int, seed: int = 0, beam_model: BeamModel = HDL_64E, rolling_shutter: bool = False
) -> SimulatedFrame:
    """Ray-cast one sweep of a scene, and box what it sees.

    Args:
        scene: what there is to see.
        frame: number of the sweep.
        seed: of the sensor's noise.
        beam_model: the sensor.
        rolling_shutter: let the actors and the sensor move during the sweep.
    """
    t = frame * scene.period
    T_world_lidar = scene.T_world_lidar(t)
    T_lidar_world = se3.invert(T_world_lidar)
    objects = [PlacedMesh(actor.mesh(t), T_lidar_world @ actor.T_world_obj(t)) for actor in scene.actors]
    objects.append(PlacedMesh(scene.background, T_lidar_world))
    if rolling_shutter:
        objects = _moving(scene, objects, t)
    rng = np.random.default_rng([seed, frame])
    sweep = scan(objects, beam_model, rng, _ground(scene, T_world_lidar, beam_model))
    n_returns = np.bincount(sweep.object_index[sweep.object_index >= 0], minlength=len(objects))
    met = [_time_met(scene, actor, t, beam_model) if rolling_shutter else t for actor in scene.actors]
    boxes = [_box(actor, at, se3.invert(scene.T_world_lidar(at))) for actor, at in zip(scene.actors, met, strict=True)]
    labelled = [
        i
        for i, box in enumerate(boxes)  # the background, the last of all, has returns but no box
        if n_returns[i] > 0 and np.hypot(*box.center_lidar[:2]) < LABEL_RANGE
    ]
    return SimulatedFrame(sweep, tuple(boxes[i] for i in labelled), tuple(met[i] for i in labelled), T_world_lidar)


def time_passed(beam_model: BeamModel, center_lidar: Point) -> float:
    """Tell when the beams pass a place, after the moment at which they point forward [s]."""
    sense = -1.0 if beam_model.turn is Turn.CLOCKWISE else 1.0
    return float(sense * np.arctan2(center_lidar[1], center_lidar[0])) / (2.0 * np.pi) * beam_model.period


def _time_met(scene: Scene, actor: Actor, t: float, beam_model: BeamModel) -> float:
    """Tell when the beams of the sweep at t meet an actor [s]."""
    met = t
    for _ in range(2):  # it moves on while they turn to it, but little
        T_lidar_obj = se3.invert(scene.T_world_lidar(met)) @ actor.T_world_obj(met)
        met = t + time_passed(beam_model, T_lidar_obj[:3, 3])
    return met


def _moving(scene: Scene, objects: list[PlacedMesh], t: float) -> list[PlacedMesh]:
    """Give the scene's objects, of which the background is the last, their motions relative to the sensor."""
    T_before, T_after = (se3.invert(scene.T_world_lidar(t + dt)) for dt in (-STEP, STEP))
    poses = [(actor.T_world_obj(t - STEP), actor.T_world_obj(t + STEP)) for actor in scene.actors]
    poses.append((np.eye(4), np.eye(4)))
    twists = [twist_between(T_before @ before, T_after @ after, 2.0 * STEP) for before, after in poses]
    return [placed._replace(twist_lidar=twist) for placed, twist in zip(objects, twists, strict=True)]


def _ground(scene: Scene, T_world_lidar: Transform, beam_model: BeamModel) -> PlacedMesh:
    """Lay the ground around the sensor, as far as it sees."""
    side = 2.5 * beam_model.max_range
    slab = box_mesh(np.array([side, side, 1.0]), Material.ASPHALT)
    x, y, _ = T_world_lidar[:3, 3]
    T_world_slab = se3.from_yaw(0.0, np.array([x, y, scene.ground_z - 1.0]))
    return PlacedMesh(slab, se3.invert(T_world_lidar) @ T_world_slab)


def _box(actor: Actor, t: float, T_lidar_world: Transform) -> Box:
    """Put an actor's label box around it: exact pose, and some air."""
    size = actor.body.size + AIR * np.array([2.0, 2.0, 1.0])
    T_obj_box = se3.from_yaw(0.0, np.array([0.0, 0.0, 0.5 * size[2]]))
    T_lidar_box = T_lidar_world @ actor.T_world_obj(t) @ T_obj_box
    return Box(actor.track_id, actor.class_name, T_lidar_box, size, truncation=0, occlusion=0)


def ego_state(scene: Scene, t: float) -> writer.EgoState:
    """Measure the ego car's motion at time t, by central differences of its pose."""
    before, now, after = (scene.T_world_imu(t + dt) for dt in (-STEP, 0.0, STEP))
    turn = (before[:3, :3].T @ after[:3, :3]) / (2.0 * STEP)
    return writer.EgoState(
        T_world_imu=now,
        velocity_world=(after[:3, 3] - before[:3, 3]) / (2.0 * STEP),
        acceleration_world=(after[:3, 3] - 2.0 * now[:3, 3] + before[:3, 3]) / STEP**2,
        rate_imu=0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]),
    )


def digest(*contents: bytes) -> str:
    """Give a short name to contents: other ones have another, for all that is likely."""
    total = hashlib.sha256()
    for content in contents:
        total.update(hashlib.sha256(content).digest())
    return total.hexdigest()[:16]


def _plain(array: np.ndarray) -> list[Any]:
    return array.tolist()


def _fingerprint(scene: Scene) -> str:
    """Tell scenes apart by what they show at their start, their middle and their end."""
    contents = [_mesh_bytes(scene.background)]
    for t in np.array([0.0, 0.5, 1.0]) * (scene.n_frames - 1) * scene.period:
        contents.append(scene.T_world_imu(float(t)).tobytes())
        for actor in scene.actors:
            place = actor.T_world_obj(float(t)).tobytes()
            contents += [f"{actor.track_id} {actor.class_name}".encode(), place, _mesh_bytes(actor.mesh(float(t)))]
    return digest(*contents)


def _mesh_bytes(mesh: Mesh) -> bytes:
    return mesh.vertices.tobytes() + mesh.triangles.tobytes() + mesh.material.tobytes()
