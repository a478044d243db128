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
from tracker.ego_motion.modes import EgoConfig, with_ego
from tracker.errors import InputError
from tracker.estimators import Estimator, create_estimator
from tracker.estimators.fused import FusedEstimator, FusedSettings
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

Rows = Float64[np.ndarray, "k d"]


def main() -> None:
    """Run the estimators over all sequences in the sensor's frame, and print what they leave."""
    root, *names = sys.argv[1:]
    left: dict[str, list[tuple[Rows, float, int]]] = {name: [] for name in ESTIMATORS}
    with TemporaryDirectory() as folder:
        for sequence in open_sequences(Path(root), tuple(names)):
            # what stands moves as one over the times of looks only
            looked_at = with_ego(sequence, EgoConfig(deskew=sequence.is_swept), in_world=False)
            store = cut_sequence(looked_at, Path(folder))
            truth = true_velocities(list(store.frames()), WORLD, "smoothed")
            for name, create in ESTIMATORS.items():
                tracklets, _ = run_causal(create(), store, CLASSES, SENSOR)
                parked: dict[int, list[VelocityEstimate]] = defaultdict(list)
                for estimate in (e for tracklet in tracklets for e in tracklet):
                    true = truth.get((estimate.track_id, estimate.frame))
                    is_told = estimate.status not in (EstimateStatus.NEW_TRACK, EstimateStatus.NO_POINTS)
                    if true is not None and true.is_parked and true.range_m < RANGE and is_told:
                        parked[estimate.frame].append(estimate)
                left[name] += [residuals(*columns(found)) for found in parked.values() if len(found) >= FEWEST]
    rows = []
    for name, found in left.items():
        if not found:
            raise InputError(f"{root}: expected frames with {FEWEST} parked objects within {RANGE:g} m, got none")
        off, squared, numbers = zip(*found, strict=True)
        rms = np.sqrt(np.mean(np.sum(np.concatenate(off) ** 2, axis=1)))
        share = sum(squared) / sum(numbers)
        rows.append([name, str(len(found)), str(sum(map(len, off))), f"{rms:.3f}", f"{share:.2f}"])
    print_table(["estimator", "frames", "n", "RMS [m/s]", "squared distance / its expectation"], rows)


def columns(found: list[VelocityEstimate]) -> tuple[Rows, Rows, Float64[np.ndarray, "k 2 2"]]:
    """Put places, velocities and covariances of a frame's objects side by side."""
    places, velocities = (np.array([getattr(e, key) for e in found]) for key in ("position", "velocity"))
    return places, velocities, np.array([e.covariance for e in found])


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
