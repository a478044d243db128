"""Rows of a comparison's tables: by range, by class, by track."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Bool

from evaluation.compare import Comparison
from evaluation.dependability import SETTLED, false_motion
from evaluation.scored import Scored
from evaluation.velocity_error import score
from tracker.types import WORLD

RANGE_STEP = 10.0  # width of the bins of the breakdown by range [m]

Row = dict[str, Any]
Masks = Sequence[Bool[np.ndarray, " _"]]  # which steps of each part are meant


def rows(comparison: Comparison) -> list[Row]:
    """Give the table's rows: estimator by smoothing by range, over all sequences."""
    return [
        {
            "estimator": estimator,
            "smoothing": smoothing,
            "frame": comparison.config.frame,
            "range_m": range_m,
            **_score(parts, masks),
            "ms_per_transform": _mean_ms(parts),
            **_in_use(comparison, parts, masks),
        }
        for estimator, smoothing, parts in _groups(comparison)
        for range_m, masks in _ranges(comparison, parts)
    ]


def class_rows(comparison: Comparison) -> list[Row]:
    """Give the same by class too; classes that do not occur at a range are left out."""
    found = []
    for estimator, smoothing, parts in _groups(comparison):
        names = [np.array(part.class_name, dtype=object) for part in parts]
        for class_name in sorted({name for part in parts for name in part.class_name}):
            for range_m, within in _ranges(comparison, parts):
                masks = [mask & (name == class_name) for mask, name in zip(within, names, strict=True)]
                if any(mask.any() for mask in masks):
                    named = {"estimator": estimator, "smoothing": smoothing, "frame": comparison.config.frame}
                    place = {"class_name": class_name, "range_m": range_m}
                    found.append({**named, **place, **_score(parts, masks), **_in_use(comparison, parts, masks)})
    return found


def track_rows(comparison: Comparison) -> list[Row]:
    """Break the errors down by track, over all its ranges."""
    return [
        {
            "sequence": part.sequence,
            "track_id": int(track_id),
            "estimator": part.estimator,
            "smoothing": part.smoothing,
            **_score([part], [part.track_id == track_id]),
        }
        for part in comparison.scored
        for track_id in np.unique(part.track_id)
    ]


def range_rows(comparison: Comparison) -> list[Row]:
    """Break the errors down into bins of range; empty bins are left out."""
    last = max(comparison.config.ranges)
    found = []
    for estimator, smoothing, parts in _groups(comparison):
        for low in np.arange(0.0, last, RANGE_STEP):
            high = min(low + RANGE_STEP, last)
            row = _score(parts, [(part.range_m >= low) & (part.range_m < high) for part in parts])
            if row["n"]:
                named = {"estimator": estimator, "smoothing": smoothing, "from_m": float(low), "to_m": float(high)}
                found.append({**named, **row})
    return found


def _groups(comparison: Comparison) -> Iterator[tuple[str, str, list[Scored]]]:
    for estimator in comparison.config.estimators:
        for smoothing in comparison.config.smoothing:
            parts = [p for p in comparison.scored if (p.estimator, p.smoothing) == (estimator, smoothing)]
            yield estimator, smoothing, parts


def _ranges(comparison: Comparison, parts: Sequence[Scored]) -> Iterator[tuple[float, Masks]]:
    for range_m in comparison.config.ranges:
        yield range_m, [part.range_m < range_m for part in parts]


def _score(parts: Sequence[Scored], masks: Masks) -> Row:
    def gather(column: str) -> np.ndarray:
        return np.concatenate([getattr(part, column)[mask] for part, mask in zip(parts, masks, strict=True)])

    abstained = np.concatenate(
        [
            np.array([e.abstained for e in part.estimates], dtype=bool)[mask]
            for part, mask in zip(parts, masks, strict=True)
        ]
    )
    return asdict(score(gather("velocity"), gather("true"), gather("covariance"), abstained))


def _in_use(comparison: Comparison, parts: Sequence[Scored], masks: Masks) -> Row:
    """Say how far the velocities of some steps can be relied on.

    A track counts where it has a step after its fifth frame, and a step of the acceleration where its middle is;
    what is not defined is NaN, with a count of 0: false motion in the sensor's frame, delays without exact truth.
    """
    both = list(zip(parts, masks, strict=True))
    has_parked, has_delays = comparison.config.frame == WORLD, comparison.truth == "exact"
    parked = np.concatenate([part.velocity[mask & part.is_parked & has_parked] for part, mask in both])
    settled = [np.unique(part.tracklet[mask & (part.age >= SETTLED)]) for part, mask in both]
    late = [delay.seconds for part, mask in both if has_delays for delay in part.delays if mask[delay.row]]
    return {
        "n_parked": len(parked),
        "false_motion": false_motion(parked),
        "n_tracks": sum(len(numbers) for numbers in settled),
        "lost_tracks": sum(
            len(np.intersect1d(numbers, part.lost)) for numbers, part in zip(settled, parts, strict=True)
        ),
        "n_delays": len(late),
        "delay_s": float(np.median(late)) if late else float("nan"),
    }


def _mean_ms(parts: Sequence[Scored]) -> float:
    n = sum(len(part.velocity) for part in parts)
    return sum(part.ms_per_transform * len(part.velocity) for part in parts) / n if n else float("nan")
