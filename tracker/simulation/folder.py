"""Scenes become KITTI tracking folders: scans ray-cast, labels, GPS/IMU records, and the exact truth beside them."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np

from registration import se3
from registration.errors import unknown_name
from registration.synthetic.lidar import HDL_64E, BeamModel, PlacedMesh, Sweep, scan
from registration.synthetic.meshes import Material, box_mesh
from registration.types import Transform
from tracker.errors import DataError, InputError
from tracker.files import UNFINISHED, write_whole
from tracker.kitti import writer
from tracker.kitti.truth import COLUMNS
from tracker.simulation.scenes import Actor, Scene
from tracker.simulation.street import street_scene
from tracker.types import Box

FORMAT = 1
RECORD = "simulation.json"  # says that a folder is ours, and what is in it
LABEL_RANGE = 80.0  # boxes farther away get no label, horizontally [m]
AIR = 0.05  # that a label leaves on each side and on top, as annotators do; its bottom is the ground [m]
TRUTH_HEADER = ",".join(COLUMNS) + "\n"

# A scene by name: a function of a seed and a number of frames.
SCENES: dict[str, Callable[[int, int], Scene]] = {"street": street_scene}

Progress = Callable[[int, int], None]  # called with the number of frames done, and of all


@dataclass(frozen=True, slots=True)
class SimulatedFrame:
    """One sweep and its labels.

    Attributes:
        sweep: the returns; `object_index` counts the scene's actors, then the background.
        boxes: of the actors that are labelled, in the scene's order.
        T_world_lidar: pose of the sensor.
    """

    sweep: Sweep
    boxes: tuple[Box, ...]
    T_world_lidar: Transform


def create_scene(name: str = "street", seed: int = 0, n_frames: int = 100) -> Scene:
    """Set one of the scenes that we have.

    Raises:
        InputError: no scene has this name, or the scene is not that long.
    """
    if name not in SCENES:
        raise InputError(unknown_name("scene", name, SCENES))
    return SCENES[name](seed, n_frames)


def simulate(
    scene: Scene,
    out: Path,
    sequence: str = "0000",
    seed: int = 0,
    progress: Progress | None = None,
    beam_model: BeamModel = HDL_64E,
) -> Path:
    """Ray-cast a scene and write it as a sequence of a KITTI tracking folder.

    Everything lies below `out/training`: `velodyne`, `label_02`, `calib`, `oxts`, `times` as KITTI's, and
    `truth/NNNN.csv` with the exact poses of the centres of all labelled boxes.  The sequence is written beside its
    place and moved there when it is complete; one of the same name from an earlier simulation is replaced.

    Args:
        scene: what there is to see.
        out: root of the folder; made where it is missing.
        sequence: name of the sequence in it.
        seed: of the sensor's noise; every frame has random numbers of its own, whatever came before it.
        progress: called after each frame.
        beam_model: the sensor.

    Returns:
        `out`.

    Raises:
        DataError: `out` holds something that no simulation has written.
        InputError: the sequence's name is no plain word.
        MissingLibraryError: Open3D cannot be imported.
    """
    if not sequence.replace("-", "").replace("_", "").isalnum():
        raise InputError(f"a sequence's name is made of letters and digits, got {sequence!r}")
    sequences = _open_record(out)
    unfinished = out / f"{UNFINISHED}-{sequence}"
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        _write_sequence(scene, unfinished, sequence, seed, progress, beam_model)
        _move_into_place(unfinished, out / "training")
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    sequences[sequence] = {
        "scene": scene.name, "n_frames": scene.n_frames, "seed": seed, "beam_model": beam_model.name,
    }  # fmt: skip
    _write_record(out, sequences)
    return out


def simulate_frame(scene: Scene, frame: int, seed: int = 0, beam_model: BeamModel = HDL_64E) -> SimulatedFrame:
    """Ray-cast one sweep of a scene, and box what it sees.

    Args:
        scene: what there is to see.
        frame: number of the sweep.
        seed: of the sensor's noise.
        beam_model: the sensor.
    """
    t = frame * scene.period
    T_world_lidar = scene.T_world_lidar(t)
    T_lidar_world = se3.invert(T_world_lidar)
    objects = [PlacedMesh(actor.mesh(t), T_lidar_world @ actor.T_world_obj(t)) for actor in scene.actors]
    objects.append(PlacedMesh(scene.background, T_lidar_world))
    rng = np.random.default_rng([seed, frame])
    sweep = scan(objects, beam_model, rng, _ground(scene, T_world_lidar, beam_model))
    n_returns = np.bincount(sweep.object_index[sweep.object_index >= 0], minlength=len(objects))
    boxes = [_box(actor, t, T_lidar_world) for actor in scene.actors]
    labelled = tuple(
        box
        for box, n in zip(boxes, n_returns, strict=False)  # the background has returns, but no box
        if n > 0 and np.hypot(*box.center_lidar[:2]) < LABEL_RANGE
    )
    return SimulatedFrame(sweep, labelled, T_world_lidar)


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
    step = 1e-3
    before, now, after = (scene.T_world_imu(t + dt) for dt in (-step, 0.0, step))
    turn = (before[:3, :3].T @ after[:3, :3]) / (2.0 * step)
    return writer.EgoState(
        T_world_imu=now,
        velocity_world=(after[:3, 3] - before[:3, 3]) / (2.0 * step),
        acceleration_world=(after[:3, 3] - 2.0 * now[:3, 3] + before[:3, 3]) / step**2,
        rate_imu=0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]),
    )


def _write_sequence(
    scene: Scene, folder: Path, sequence: str, seed: int, progress: Progress | None, beam_model: BeamModel
) -> None:
    """Write all files of a sequence below `folder`."""
    labels, truth, records, times = [], [TRUTH_HEADER], [], []
    for frame in range(scene.n_frames):
        simulated = simulate_frame(scene, frame, seed, beam_model)
        path = folder / "velodyne" / sequence / f"{frame:06d}.bin"
        writer.write_scan(path, simulated.sweep.points_lidar, simulated.sweep.intensity)
        labels += [writer.format_label(box, frame, scene.calibration) for box in simulated.boxes]
        truth += [_truth_row(frame, box, simulated.T_world_lidar) for box in simulated.boxes]
        records.append(writer.format_oxts(ego_state(scene, frame * scene.period)))
        times.append(writer.format_time(round(frame * scene.period * 1e9)))
        if progress is not None:
            progress(frame + 1, scene.n_frames)
    texts = {"label_02": labels, "oxts": records, "times": times}
    for name, rows in texts.items():
        write_whole(folder / name / f"{sequence}.txt", "".join(rows))
    write_whole(folder / "calib" / f"{sequence}.txt", writer.format_calib(scene.calibration))
    write_whole(folder / "truth" / f"{sequence}.csv", "".join(truth))


def _truth_row(frame: int, box: Box, T_world_lidar: Transform) -> str:
    """Write where a box exactly is, in the world and for the sensor; every digit of the numbers."""
    T_world_box = T_world_lidar @ box.T_lidar_obj
    pose = [*T_world_box[:3, 3], se3.yaw(T_world_box), *box.center_lidar, box.yaw_lidar]
    return f"{frame},{box.track_id},{box.class_name},{','.join(repr(float(value)) for value in pose)}\n"


def _open_record(out: Path) -> dict[str, object]:
    """Read what simulations have left in a folder, by sequence, or start a record in an empty one."""
    path = out / RECORD
    if path.is_file():
        try:
            record = json.loads(path.read_text())
        except ValueError as error:
            raise DataError(path, f"expected a simulation's record (JSON), got {error}") from None
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise DataError(path, f"expected a simulation's record of format {FORMAT}")
        return dict(record.get("sequences", {}))
    leftover = RECORD + UNFINISHED  # of a run that was killed
    if out.exists() and (not out.is_dir() or any(path.name != leftover for path in out.iterdir())):
        raise DataError(out, "holds something that no simulation has written; choose an empty folder")
    _write_record(out, {})
    return {}


def _write_record(out: Path, sequences: dict[str, object]) -> None:
    record = {"format": FORMAT, "version": metadata.version("regmot"), "sequences": sequences}
    write_whole(out / RECORD, json.dumps(record, indent=1, sort_keys=True) + "\n")


def _move_into_place(unfinished: Path, training: Path) -> None:
    """Move a complete sequence to where readers look, the labels last: they make it a sequence."""
    for piece in sorted(unfinished.glob("*/*"), key=lambda piece: piece.parent.name == "label_02"):
        target = training / piece.parent.name / piece.name
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            shutil.rmtree(target)
        os.replace(piece, target)
