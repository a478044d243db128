"""Labelled sequences, played again by meshes: KITTI's traffic with scans where it has none, and with exact truth."""

import logging
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.errors import unknown_name
from registration.libraries import load_open3d
from registration.synthetic.bodies import Body, draw_body
from registration.synthetic.lidar import BeamModel, PlacedMesh, Sweep, pose_after, scan
from registration.synthetic.meshes import Mesh
from registration.types import Transform
from tracker.errors import DataError, InputError, MissingDataError
from tracker.kitti import writer
from tracker.kitti.calib import Calibration, read_projection, read_tracking_calib
from tracker.kitti.sequence import KittiSequence
from tracker.kitti.text import read_lines
from tracker.kitti.tracking import open_tracking, sequence_names, training_folder
from tracker.kitti.truth import format_header, format_truth
from tracker.simulation.folder import AIR, Recording, digest, label_boxes, time_passed
from tracker.simulation.occluders import Hiding, draw_hiding, occluders
from tracker.simulation.recorder import Progress, record
from tracker.simulation.recording import TakenFrame
from tracker.simulation.smoothed_tracks import Stretch, Track, smoothed_tracks
from tracker.simulation.uneven_ground import ground_mesh
from tracker.types import Box

# What stands for each class of KITTI's labels; the tracking benchmark's Person is one that sits.
BODIES = {name: name for name in ("Car", "Van", "Truck", "Tram", "Bus", "Cyclist", "Pedestrian", "Misc")} | {
    "Person": "Person_sitting",
    "Person_sitting": "Person_sitting",
}
_BODY, _HIDING, _SCAN = range(3)  # streams of random numbers
_MIN_SHARE = 0.8  # of a label's size that a mesh has, however much air there is

Twist = Float64[np.ndarray, "6"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LabelPlay:
    """How labelled sequences are played again.

    Attributes:
        seed: of shapes, of what hides them, and of the sensor's noise.
        n_frames: number of frames from the start of each sequence; None for all.
        with_occluders: put panels where labels say that something without a label hides an object.
        recording: with which sensor, and how it is labelled.
    """

    seed: int = 0
    n_frames: int | None = None
    with_occluders: bool = True
    recording: Recording = field(default_factory=lambda: Recording(rolling_shutter=True))

    def __post_init__(self) -> None:
        if self.n_frames is not None and self.n_frames < 1:
            raise InputError(f"a sequence needs at least 1 frame, got {self.n_frames}")
        if self.seed < 0:
            raise InputError(f"expected a seed >= 0, got {self.seed}")


def simulate_labels(
    root: Path,
    out: Path,
    names: Sequence[str] = (),
    play: LabelPlay = LabelPlay(),
    progress: Progress | None = None,
    n_jobs: int = 1,
) -> Path:
    """Replace the labelled objects of KITTI tracking sequences by meshes, and write what the sensor sees of them.

    Labels and calibration are enough.  Each object becomes a mesh of its class and size on its smoothed trajectory
    relative to the sensor; it stands at its own height, and the ground under it is made to fit.  There is no world:
    the ego's motion is not known, so `truth/NNNN.csv` has poses in the sensor's axes only, and no poses are written.
    Objects of an unknown class are left out, with a warning.  An interrupted run with the same labels and settings
    goes on where it stopped; sequences become visible one by one, each when it is whole.

    Args:
        root: a KITTI tracking folder with `label_02` and `calib`.
        out: root of the folder to write; made where it is missing.
        names: sequences of `root`; none for all.
        play: how they are played.
        progress: told of a sequence's name, the number of its frames done, and of all its frames.
        n_jobs: number of processes; what is written does not depend on it.  More than one start Python anew, so a
            script that asks for them must be importable (`if __name__ == "__main__"`).

    Returns:
        `out`.

    Raises:
        MissingDataError: no labels, or no calibration.
        DataError: a label file is malformed or empty, or `out` holds something that no simulation has written.
        InputError: no such sequence.
        MissingLibraryError: Open3D cannot be imported.
    """
    folder = training_folder(root)
    if folder is None:
        raise MissingDataError(f"{root}: expected a KITTI tracking folder with label_02 (or the same below training)")
    known = sequence_names(folder)
    if not known:
        raise MissingDataError(f"{folder / 'label_02'}: expected a label file NNNN.txt for each sequence, got none")
    for name in names:
        if name not in known:
            raise InputError(f"{root}: {unknown_name('sequence', name, known)}")
    load_open3d("the LiDAR simulator")  # before any work, not after it
    recipes = {name: partial(LabelTake.open, folder, name, play) for name in names or known}
    return record(recipes, out, progress, n_jobs)


@dataclass(frozen=True)
class LabelTake:
    """A labelled sequence as a sequence to be written.

    Attributes:
        name: of the sequence.
        play: how it is played.
        n_frames: number of its frames.
        tracks: its objects, of known classes.
        calib_text: its calibration file.
        times_text: its times, one line a frame.
        times: the same [s].
        source_digest: of the files that it is made from.
    """

    name: str
    play: LabelPlay
    n_frames: int
    tracks: tuple[Track, ...]
    calibration: Calibration
    projection: Float64[np.ndarray, "3 4"] | None
    calib_text: str
    times_text: tuple[str, ...]
    source_digest: str

    @staticmethod
    def open(folder: Path, name: str, play: LabelPlay) -> "LabelTake":
        """Read a sequence's labels, calibration and, where there are any, times.

        Raises:
            MissingDataError, DataError: a file is not there, is malformed, or holds no label.
        """
        sequence = open_tracking(folder, folder, name)
        if not sequence.class_names:
            raise DataError(folder / "label_02" / f"{name}.txt", "expected labels of objects, got none")
        n_frames = min(len(sequence), play.n_frames or len(sequence))
        calib_path = folder / "calib" / f"{name}.txt"
        is_swept = play.recording.rolling_shutter and sequence.is_swept
        seen_after = partial(time_passed, play.recording.beam_model) if is_swept else None
        tracks = smoothed_tracks(map(sequence.boxes_of, range(len(sequence))), sequence.timestamps, seen_after)
        return LabelTake(
            name=name,
            play=play,
            n_frames=n_frames,
            tracks=tuple(_known(tracks, name)),
            calibration=read_tracking_calib(calib_path),
            projection=read_projection(calib_path),
            calib_text=calib_path.read_text(),
            times_text=_times_text(sequence, folder, n_frames),
            source_digest=digest(*(path.read_bytes() for path in sequence.sources)),
        )

    @property
    def settings(self) -> dict[str, Any]:
        """All that decides what it looks like."""
        play = self.play
        content = {"from_labels": self.name, "source_digest": self.source_digest, "n_frames": self.n_frames}
        return {**content, "seed": play.seed, "with_occluders": play.with_occluders, **play.recording.settings}

    @property
    def heads(self) -> dict[str, str]:
        """How each of its text files starts."""
        return {"calib": self.calib_text, "truth": format_header(has_world=False), "label_02": "", "times": ""}

    def frame(self, index: int) -> TakenFrame:
        """Make one frame."""
        present = self._present(index)
        boxes = tuple(_box(track, stretch, index) for track, stretch in present)
        sweep = self._sweep(index, present, boxes)
        labels = label_boxes(boxes, index, self.play.recording.box_jitter, self._entropy())
        rows = {
            "label_02": "".join(writer.format_label(b, index, self.calibration, self.projection) for b in labels),
            "truth": format_truth(index, boxes, None),
            "times": self.times_text[index],
        }
        return TakenFrame(sweep.points_lidar, sweep.intensity, rows)

    def _present(self, index: int) -> list[tuple[Track, Stretch]]:
        """List the tracks that a frame has labels of."""
        found = ((track, track.stretch(index)) for track in self.tracks)
        return [(track, stretch) for track, stretch in found if stretch is not None]

    def _sweep(self, index: int, present: list[tuple[Track, Stretch]], boxes: tuple[Box, ...]) -> Sweep:
        """Let the sensor see the objects of a frame, what hides them, and the ground around them."""
        recording = self.play.recording
        placed = []
        for (track, stretch), box in zip(present, boxes, strict=True):
            k = index - stretch.first
            mesh = self._bodies[track.track_id].mesh(float(self._ways[track.track_id, stretch.first][k]))
            T_box_obj = se3.from_yaw(0.0, np.array([0.0, 0.0, -0.5 * track.size[2]]))
            pieces = [(mesh, box.T_lidar_obj @ T_box_obj)]
            if self.play.with_occluders:
                pieces += occluders(box, boxes, self._hidings[track.track_id].at(index))
            twist = stretch.twist(float(stretch.times[k])) if recording.rolling_shutter else None
            placed += [_met(piece, T_lidar_piece, twist, recording.beam_model, box) for piece, T_lidar_piece in pieces]
        ground = PlacedMesh(ground_mesh(boxes, recording.beam_model.height), np.eye(4)) if boxes else None
        rng = np.random.default_rng(self._entropy(_SCAN, index))
        return scan(placed, recording.beam_model, rng, ground)

    @cached_property
    def _bodies(self) -> dict[int, Body]:
        """What each track looks like, by its id: a little smaller than its label, as annotators leave some air."""
        bodies = {}
        for track in self.tracks:
            size = np.maximum(track.size - AIR * np.array([2.0, 2.0, 1.0]), _MIN_SHARE * track.size)
            rng = np.random.default_rng(self._entropy(_BODY, track.track_id))
            bodies[track.track_id] = draw_body(BODIES[track.class_name], rng, size)
        return bodies

    @cached_property
    def _hidings(self) -> Mapping[int, Hiding]:
        return {
            track.track_id: draw_hiding(track, np.random.default_rng(self._entropy(_HIDING, track.track_id)))
            for track in self.tracks
        }

    @cached_property
    def _ways(self) -> dict[tuple[int, int], np.ndarray]:
        """Ways of each track, by its id and the first frame of the stretch."""
        return {
            (track.track_id, stretch.first): stretch.ways(track.class_name)
            for track in self.tracks
            for stretch in track.stretches
        }

    def _entropy(self, *stream: int) -> tuple[int, ...]:
        """Seed a stream of random numbers of this sequence."""
        return (self.play.seed, zlib.crc32(self.name.encode()), *stream)


def _met(mesh: Mesh, T_lidar_obj: Transform, twist: Twist | None, beam_model: BeamModel, box: Box) -> PlacedMesh:
    """Place a mesh so that it is at a pose when the beams meet its object, and moves before and after that.

    Labels say where people saw an object in the scan, and that is where the beams met it.
    """
    if twist is None:
        return PlacedMesh(mesh, T_lidar_obj)
    return PlacedMesh(mesh, pose_after(twist, -time_passed(beam_model, box.center_lidar)) @ T_lidar_obj, twist)


def _known(tracks: Sequence[Track], name: str) -> list[Track]:
    """Leave out the tracks whose class nobody can draw, and say so."""
    unknown = sorted({track.class_name for track in tracks if track.class_name not in BODIES})
    if unknown:
        _log.warning("sequence %s: left out objects of unknown classes: %s", name, ", ".join(unknown))
    return [track for track in tracks if track.class_name in BODIES]


def _times_text(sequence: KittiSequence, folder: Path, n_frames: int) -> tuple[str, ...]:
    """Copy the times of frames, or write those of the nominal rate."""
    path = folder / "times" / f"{sequence.name}.txt"
    if path in sequence.sources:
        return tuple(f"{line}\n" for line in read_lines(path)[:n_frames])
    return tuple(writer.format_time(round(1e9 * float(time))) for time in sequence.timestamps[:n_frames])


def _box(track: Track, stretch: Stretch, index: int) -> Box:
    """Give a track's exact box at a frame."""
    T_lidar_obj = stretch.pose(float(stretch.times[index - stretch.first]))
    return Box(
        track.track_id, track.class_name, T_lidar_obj, track.size, truncation=0, occlusion=track.occlusion[index]
    )
