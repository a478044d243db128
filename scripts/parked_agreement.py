"""Measure on real scans how far velocities of what stands contradict each other, against what they claim.

python -m regmot.parked_agreement ROOT [SEQUENCE ...]

All that is parked moves as one rigid body relative to the sensor, whatever the ego does.  What velocities leave of the
motion that fits them best is their own error: labels and poses, which tell what is parked, are not in it.  Nor is the
error that all share.  `fused` assumes as much itself, so that its objects agree for that reason too: "each alone" does
not.
"""

import sys
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float64

from evaluation.compare import run_causal
from evaluation.truth import true_velocities
from tracker.errors import InputError
from tracker.estimators import Estimator, create_estimator
from tracker.estimators.fused import FusedEstimator, FusedSettings
from tracker.estimators.fused.sensor import Sensor
from tracker.kitti import open_sequences
from tracker.store import cut_sequence
from tracker.types import SENSOR, WORLD, EstimateStatus, VelocityEstimate

from .console import print_table

CLASSES = ("Car", "Van")
ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "centroid-kf": partial(create_estimator, "centroid-kf"),
    "adh-3d": partial(create_estimator, "adh-3d"),
    "fused": FusedEstimator,
    "fused, each alone": partial(FusedEstimator, settings=FusedSettings(knows_parked=False)),
}
RANGE = 40.0  # objects farther away do not count [m]
FEWEST = 3  # parked objects in a frame for it to count
MOST_LATE = 0.5  # of a step, by which a look comes late, for the step to count

Rows = Float64[np.ndarray, "k d"]


def main() -> None:
    """Run the estimators over all sequences in the sensor's frame, and print what they leave."""
    root, *names = sys.argv[1:]
    left: dict[str, list[tuple[Rows, float, int]]] = {name: [] for name in ESTIMATORS}
    with TemporaryDirectory() as folder:
        for sequence in open_sequences(Path(root), tuple(names)):
            store = cut_sequence(sequence, Path(folder))
            truth = true_velocities(list(store.frames()), WORLD, "smoothed")
            for name, create in ESTIMATORS.items():
                tracklets, _ = run_causal(create(), store, CLASSES, SENSOR)
                parked: dict[int, list[tuple[VelocityEstimate, float]]] = defaultdict(list)
                for tracklet in tracklets:
                    for before, now in zip(tracklet, tracklet[1:], strict=False):
                        true = truth.get((now.track_id, now.frame))
                        is_seen = now.n_points > 0 and now.status is not EstimateStatus.NEW_TRACK
                        if true is not None and true.is_parked and true.range_m < RANGE and is_seen:
                            parked[now.frame].append((now, now.timestamp - before.timestamp))
                frames = [columns(found, sequence.is_swept) for found in parked.values()]
                left[name] += [residuals(*frame) for frame in frames if len(frame[0]) >= FEWEST]
    rows = []
    for name, found in left.items():
        if not found:
            raise InputError(f"{root}: expected frames with {FEWEST} parked objects within {RANGE:g} m, got none")
        off, squared, numbers = zip(*found, strict=True)
        rms = np.sqrt(np.mean(np.sum(np.concatenate(off) ** 2, axis=1)))
        share = sum(squared) / sum(numbers)
        rows.append([name, str(len(found)), str(sum(map(len, off))), f"{rms:.3f}", f"{share:.2f}"])
    print_table(["estimator", "frames", "n", "RMS [m/s]", "squared distance / its expectation"], rows)


def columns(
    found: list[tuple[VelocityEstimate, float]], is_swept: bool
) -> tuple[Rows, Rows, Float64[np.ndarray, "k 2 2"]]:
    """Give places and velocities of a frame's objects, as if all were seen at the time of the frame, and covariances.

    A raw sweep meets an object whose direction changes earlier or later than the one before did; what crosses the
    direction in which sweeps end is left out.
    """
    places, velocities = (np.array([getattr(e, key) for e, _ in found]) for key in ("position", "velocity"))
    covariances = np.array([e.covariance for e, _ in found])
    if not is_swept:
        return places, velocities, covariances
    seconds, sensor = np.array([dt for _, dt in found]), Sensor(np.zeros(2), 0.0)
    took = 1.0 + (sensor.delays(places) - sensor.delays(places - seconds[:, None] * velocities)) / seconds
    kept = np.abs(took - 1.0) < MOST_LATE
    return places[kept], (velocities / took[:, None])[kept], covariances[kept]


def residuals(places: Rows, velocities: Rows, covariances: Float64[np.ndarray, "k 2 2"]) -> tuple[Rows, float, int]:
    """Fit the steps of a rigid motion to velocities, weighed by their covariances.

    A step from p to R p + t is (R - 1) p + t, four numbers, of which all but what is left of the turn is linear.

    Args:
        places: [m] (k, 2).
        velocities: [m/s] (k, 2).
        covariances: of these (k, 2, 2).

    Returns:
        what is left of the velocities (k, 2), its squared distance, and the expectation of that.
    """
    x, y = places.T
    one, none = np.ones_like(x), np.zeros_like(x)
    A = np.stack([np.stack([one, none, x, -y], axis=1), np.stack([none, one, y, x], axis=1)], axis=1)  # (k, 2, 4)
    weighed = np.linalg.inv(covariances) @ A
    H, b = np.einsum("kdi,kdj->ij", A, weighed), np.einsum("kdi,kd->i", weighed, velocities)
    off = velocities - A @ np.linalg.solve(H, b)
    squared = float(np.einsum("kd,kde,ke->", off, np.linalg.inv(covariances), off))
    return off, squared, 2 * len(places) - A.shape[2]


if __name__ == "__main__":
    main()
