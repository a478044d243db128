"""Measure what estimators say when a car's speed changes at once, or its box jumps: a table of docs/fused-measured.md.

python -m regmot.sudden_changes [SCENES]

Cars around a sensor that stands, 10 to 45 m away, seen by KITTI's; after 0.9 s all change their speed from one frame to
the next, or their boxes, with all that is in them, are 0.3 or 0.6 m off for one frame.
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.bodies import draw_body
from registration.synthetic.lidar import HDL_64E, PlacedMesh, scan
from registration.types import Points
from tracker.estimators import Estimator, create_estimator
from tracker.estimators.fused import FusedEstimator, FusedSettings
from tracker.types import Segment, VelocityEstimate

from .console import print_table

ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "centroid-kf": partial(create_estimator, "centroid-kf"),
    "adh-3d": partial(create_estimator, "adh-3d"),
    "fused, no look is off": partial(FusedEstimator, settings=FusedSettings(weighs_looks=False)),
    "fused": partial(create_estimator, "fused"),
}
N_CARS = 6  # of a scene, each in a direction of its own
BEFORE, AFTER = 9, 6  # frames
DT, SPEED = 0.1, 15.0
HEIGHT = 1.73  # of the sensor [m]
FEWEST = 10  # points of a car that counts


class Event(NamedTuple):
    """What happens: a change of speed [m/s], or how far boxes are off across for one frame [m]."""

    name: str
    change: float = 0.0
    jump: float = 0.0


EVENTS = (
    Event("nothing"),
    *(Event(f"{SPEED:g} to {SPEED - change:g} m/s", change=change) for change in (2.0, 4.0, 8.0, 12.0)),
    *(Event(f"box off by {jump:g} m", jump=jump) for jump in (0.3, 0.6)),
)
LATER = (1, 2, 3, 5)  # looks after the event, whose errors are shown
HEADER = ("event", "estimator", "n", *(f"look {k}" for k in LATER), "NEES, look 1", "look 2")


def main() -> None:
    """Scan the scenes for each event; print medians, and mean NEES."""
    n_scenes = int(sys.argv[1]) if sys.argv[1:] else 10
    body = []
    for event in EVENTS:
        scenes = [_scene(seed, event) for seed in range(n_scenes)]
        body += [[event.name, name, *_cells(create, scenes, event)] for name, create in ESTIMATORS.items()]
    print_table(list(HEADER), body)


Scene = tuple[list[dict[int, Segment]], Float64[np.ndarray, "cars 2"]]  # frames, and the directions of travel


def _scene(seed: int, event: Event) -> Scene:
    """Scan a scene frame by frame; the cars, and how they drive, are the same for each event."""
    rng = np.random.default_rng(seed)
    meshes = [draw_body("Car", rng).mesh(0.0) for _ in range(N_CARS)]
    bearing = 2.0 * np.pi * (np.arange(N_CARS) + rng.uniform(0.2, 0.8)) / N_CARS
    places = rng.uniform(10.0, 45.0, N_CARS)[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    headings = bearing + rng.uniform(-1.0, 1.0, N_CARS)
    ways = np.column_stack([np.cos(headings), np.sin(headings)])
    frames = []
    for k in range(BEFORE + AFTER):
        gone = DT * (SPEED * k - event.change * max(k - BEFORE + 1, 0))
        poses = [_pose(place + gone * way, yaw) for place, way, yaw in zip(places, ways, headings, strict=True)]
        sweep = scan([PlacedMesh(*placed) for placed in zip(meshes, poses, strict=True)], HDL_64E, rng)
        clouds = [sweep.points_lidar[sweep.object_index == car] for car in range(N_CARS)]
        off = event.jump * (k == BEFORE) * np.column_stack([-ways[:, 1], ways[:, 0], np.zeros(N_CARS)])
        frames.append({car: _segment(car, k, cloud + off[car]) for car, cloud in enumerate(clouds)})
    return frames, ways


def _pose(place: Float64[np.ndarray, "2"], yaw: float) -> Float64[np.ndarray, "4 4"]:
    return se3.from_yaw(yaw, np.array([*place, -0.5 * HEIGHT]))


def _segment(car: int, frame: int, points: Points) -> Segment:
    return Segment(car, "Car", frame, DT * frame, points, -HEIGHT, is_simulated=True)


def _cells(create: Callable[[], Estimator], scenes: list[Scene], event: Event) -> list[str]:
    """Run an estimator; give the number of cars, median errors, and the mean NEES of the first two looks."""
    errors, nees = [], []
    for frames, ways in scenes:
        estimator = create()
        found = [estimator.step(segments, DT * k, np.eye(4)) for k, segments in enumerate(frames)]
        for car, way in enumerate(ways):
            if min(len(segments[car].points_lidar) for segments in frames) >= FEWEST:
                off = [_error(answers[car], (SPEED - event.change) * way) for answers in found[BEFORE:]]
                errors.append([length for length, _ in off])
                nees.append([distance for _, distance in off[:2]])
    medians, means = np.median(errors, axis=0), np.mean(nees, axis=0)
    return [str(len(errors)), *(f"{medians[k - 1]:.2f}" for k in LATER), *(f"{mean:.1f}" for mean in means)]


def _error(estimate: VelocityEstimate, truth: Float64[np.ndarray, "2"]) -> tuple[float, float]:
    off = estimate.velocity - truth
    return float(np.hypot(*off)), float(off @ np.linalg.solve(estimate.covariance, off))


if __name__ == "__main__":
    main()
