"""Measure what each ingredient of the estimator `fused` buys, for the table of docs/fused-measured.md.

python -m regmot.fused_ablation ROOT OUT [world|sensor] [SEQUENCE ...]

Truth is the simulator's where the sequences have it, else smoothed labels; cars and vans, causal.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from evaluation.compare import run_causal
from evaluation.truth import TrueVelocity, true_velocities
from evaluation.velocity_error import score
from tracker.estimators import Estimator, create_estimator
from tracker.estimators.fused import FusedEstimator, FusedSettings
from tracker.kitti import KittiSequence, open_sequences
from tracker.kitti.truth import read_truth
from tracker.store import SegmentStore, cut_sequence
from tracker.types import SENSOR, EstimateStatus, VelocityEstimate

from .console import print_table

CLASSES = ("Car", "Van")
RANGES = (80.0, 20.0, 5.0)
HEADER = ("without", *(f"< {r:g} m" for r in RANGES), "median", "99 %", "NEES", "95 % cov.", "ms")

Steps = Float64[np.ndarray, "n 8"]  # range, velocity (2), truth (2), covariance xx, xy, yy
Part = tuple[SegmentStore, dict[tuple[int, int], TrueVelocity]]


def variants() -> dict[str, FusedSettings]:
    """Take one ingredient at a time out of the estimator."""
    whole = FusedSettings()
    motion, turn = (replace(model, tails=(0.0, 0.0)) for model in (whole.motion, whole.turn))
    return {
        "(nothing)": whole,
        "the network": replace(whole, learned_lags=()),
        "shapes": replace(whole, shape_lags=()),
        "earlier looks than the last": replace(whole, shape_lags=(1,), learned_lags=(1,)),
        "where planes end": replace(whole, planes=replace(whole.planes, patch_share=math.inf)),
        "rings beside rings": replace(whole, planes=replace(whole.planes, line_neighbours=0)),
        "accelerations that last": replace(whole, motion=replace(whole.motion, change=math.inf)),
        "heavy tails": replace(whole, motion=motion, turn=turn),
        "doubt where looks differ": replace(whole, shape_changed=0.0, learned_changed=0.0),
        "doubt of few points": replace(whole, single_point=0.0),
        "doubt of long ways": replace(whole, shape_moved=0.0),
        "doubt of other sides": replace(whole, shape_turned=0.0, learned_turned=0.0),
        "how well all agree": replace(whole, motion=replace(whole.motion, claimed=math.inf)),
        "looks that are off": replace(whole, weighs_looks=False),
        "motion during a sweep": replace(whole, undoes_sweep=False),
        "when each laser fires": replace(whole, knows_lasers=False),
        "steady axes": replace(whole, turns_axes=False),
        "the centre": replace(whole, refers_to_center=False),
        "what stands": replace(whole, knows_parked=False),
    }


def main() -> None:
    """Cut segments, run every variant, print."""
    root, out, *rest = sys.argv[1:]
    frame_name, *names = rest or [SENSOR]
    parts = [_part(sequence, Path(out), frame_name) for sequence in open_sequences(Path(root), tuple(names))]
    body = [_row("(adh-3d)", lambda: create_estimator("adh-3d"), parts, frame_name)]
    for name, settings in variants().items():
        body.append(_row(name, partial(FusedEstimator, settings=settings), parts, frame_name))
    print_table(list(HEADER), body)


def _part(sequence: KittiSequence, out: Path, frame_name: str) -> Part:
    store = cut_sequence(sequence, out / "tracklets")
    path = sequence.truth_path
    exact = read_truth(path) if path is not None and path.is_file() else None
    truth = "smoothed" if exact is None else "exact"
    return store, true_velocities(list(store.frames()), frame_name, truth, exact)


def _row(name: str, create: Callable[[], Estimator], parts: list[Part], frame_name: str) -> list[str]:
    steps, seconds, n = [], 0.0, 0
    for store, truth in parts:
        tracklets, took = run_causal(create(), store, CLASSES, frame_name)
        seconds += took
        for estimate in (e for tracklet in tracklets for e in tracklet):
            n += estimate.status is not EstimateStatus.NEW_TRACK
            true = truth.get((estimate.track_id, estimate.frame))
            if true is not None and estimate.status is not EstimateStatus.NEW_TRACK and estimate.n_points:
                steps.append(_step(estimate, true))
    return [name, *_cells(np.array(steps)), f"{1e3 * seconds / max(n, 1):.2f}"]


def _step(estimate: VelocityEstimate, true: TrueVelocity) -> list[float]:
    (xx, xy), (_, yy) = estimate.covariance
    return [true.range_m, *estimate.velocity, *true.velocity, xx, xy, yy]


def _cells(steps: Steps) -> list[str]:
    within = [steps[steps[:, 0] < r] for r in RANGES]
    scores = [score(s[:, 1:3], s[:, 3:5], s[:, [5, 6, 6, 7]].reshape(-1, 2, 2), np.zeros(len(s), bool)) for s in within]
    first = scores[0]
    return [
        *(f"{s.rmse_velocity:.3f}" for s in scores),
        f"{first.median_velocity_error:.3f}",
        f"{first.p99_velocity_error:.3f}",
        f"{first.nees:.2f}",
        f"{100 * first.coverage_95:.1f} %",
    ]


if __name__ == "__main__":
    main()
