"""What `regmot simulate` does: scenes of our own, and real labels played again."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from registration.synthetic.lidar import beam_model
from tracker.simulation import BoxJitter, LabelPlay, Recording, create_scene, simulate, simulate_labels

DEFAULT_SCENE, DEFAULT_FRAMES = "urban", 100

Progress = Callable[[str, int, int | None], None]


def recording_of(beams: str, rolling_shutter: bool, box_jitter: bool) -> Recording:
    """Choose how something is recorded: with which sensor, and how it is labelled."""
    return Recording(beam_model(beams), rolling_shutter, BoxJitter() if box_jitter else None)


def play_scene(
    out: Path, scene: str | None, frames: int | None, seed: int, progress: Progress, written: tuple[str, Recording]
) -> None:
    """Write a scene of our own; `written` is the name of its sequence, and how it is recorded."""
    name = DEFAULT_SCENE if scene is None else scene
    staged = create_scene(name, seed, DEFAULT_FRAMES if frames is None else frames)
    sequence, recording = written
    simulate(staged, out, sequence, seed, partial(progress, f"{name}: casting rays"), recording)


def play_labels(
    out: Path, root: Path, names: tuple[str, ...], play: LabelPlay, progress: Progress, n_jobs: int
) -> None:
    """Play labels again, by as many processes as are asked for, or as there are cores (0)."""

    def told(name: str, done: int, total: int) -> None:
        progress(f"{name}: casting rays", done, total)

    simulate_labels(root, out, names, play, told, n_jobs or os.cpu_count() or 1)
