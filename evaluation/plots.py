"""Pictures of a comparison: error against range, speed over time, a bird's-eye view with velocity arrows."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # files only: no screen is needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from evaluation.compare import Comparison, SequenceSummary
from evaluation.scored import Scored
from evaluation.tables import range_rows
from tracker.estimators import CAUSAL

# Okabe & Ito's palette, told apart by colour-blind readers too; black is the truth.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C564B")
MARKERS = ("o", "s", "^", "D")  # of estimators that share a colour
LINES = {
    "causal": "-",
    "window": "--",
    "lag1": "-.",
    "lag2": (0, (5, 1, 1, 1, 1, 1)),
    "lag3": (0, (5, 1, 1, 1, 1, 1, 1, 1)),
    "rts": ":",
}
MAX_TRACKS = 9  # panels of the picture of speeds
ARROW_FRAMES = 10  # an arrow every so many frames, ...
ARROW_SECONDS = 1.0  # ... as long as the way driven in this time: at 10 Hz true arrows touch and do not overlap


def draw(comparison: Comparison, out: Path) -> list[Path]:
    """Draw all pictures of a comparison into a folder, as PNG; give their paths."""
    out.mkdir(parents=True, exist_ok=True)
    found = range_rows(comparison)
    pictures = {"error_against_range": _error_against_range(comparison, found)} if found else {}
    for sequence in comparison.sequences:
        parts = [part for part in comparison.scored if part.sequence == sequence.name and len(part.velocity)]
        if parts:
            shown = _one_smoothing(parts)
            pictures[f"speed_{sequence.name}"] = _speed_over_time(shown, comparison, sequence)
            pictures[f"birds_eye_{sequence.name}"] = _birds_eye_view(shown, comparison, sequence)
    paths = []
    for name, figure in pictures.items():
        path = out / f"{name}.png"
        figure.savefig(path, dpi=130, bbox_inches="tight")
        plt.close(figure)
        paths.append(path)
    return paths


def _one_smoothing(parts: Sequence[Scored]) -> list[Scored]:
    """Show what a live user would see; where that was not asked for, the first smoothing."""
    smoothing = CAUSAL if any(part.smoothing == CAUSAL for part in parts) else parts[0].smoothing
    return [part for part in parts if part.smoothing == smoothing]


def _color(comparison: Comparison, estimator: str) -> str:
    return COLORS[comparison.config.estimators.index(estimator) % len(COLORS)]


def _marker(comparison: Comparison, estimator: str) -> str:
    return MARKERS[comparison.config.estimators.index(estimator) // len(COLORS) % len(MARKERS)]


def _error_against_range(comparison: Comparison, found: Sequence[dict[str, Any]]) -> Figure:
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 6), sharex=True, height_ratios=(4, 1), layout="constrained")
    for estimator in comparison.config.estimators:
        for smoothing in comparison.config.smoothing:
            line = [r for r in found if (r["estimator"], r["smoothing"]) == (estimator, smoothing)]
            middle = [0.5 * (r["from_m"] + r["to_m"]) for r in line]
            errors = [r["rmse_velocity"] for r in line]
            marker, color = _marker(comparison, estimator), _color(comparison, estimator)
            top.plot(middle, errors, ls=LINES.get(smoothing, "-."), color=color, marker=marker, ms=4)
    top.set(ylabel="RMSE of the velocity vector [m/s]", yscale="log")
    top.set_title(f"Velocity error against range ({comparison.config.frame} frame, truth: {comparison.truth})")
    top.yaxis.set_minor_locator(ticker.LogLocator(subs=(2.0, 3.0, 5.0)))
    for axis_ticks in (top.yaxis.set_major_formatter, top.yaxis.set_minor_formatter):
        axis_ticks(ticker.FormatStrFormatter("%.2g"))
    top.grid(True, which="both", alpha=0.3)
    handles = [
        Line2D([], [], color=_color(comparison, name), marker=_marker(comparison, name), ms=4, label=name)
        for name in comparison.config.estimators
    ]
    handles += [
        Line2D([], [], color="0.4", ls=LINES.get(name, "-."), label=name) for name in comparison.config.smoothing
    ]
    figure.legend(handles=handles, fontsize=8, loc="outside right upper")
    first = [r for r in found if (r["estimator"], r["smoothing"]) == (found[0]["estimator"], found[0]["smoothing"])]
    bottom.bar(
        [0.5 * (r["from_m"] + r["to_m"]) for r in first],
        [r["n"] for r in first],
        width=[0.9 * (r["to_m"] - r["from_m"]) for r in first],
        color="0.6",
    )
    bottom.set(xlabel="range [m]", ylabel="steps", xlim=(0.0, max(r["to_m"] for r in found)))
    return figure


def _speed_over_time(parts: Sequence[Scored], comparison: Comparison, sequence: SequenceSummary) -> Figure:
    """Show the tracks with most steps, one panel each, sharing the scale of time."""
    ids, counts = np.unique(parts[0].track_id, return_counts=True)
    shown = sorted(ids[np.argsort(-counts, kind="stable")][:MAX_TRACKS].tolist())
    n_columns = min(3, len(shown))
    n_rows = -(-len(shown) // n_columns)
    size = (4.2 * n_columns + 0.5, 2.4 * n_rows + 1.0)
    figure, axes = plt.subplots(n_rows, n_columns, figsize=size, squeeze=False, layout="constrained")
    start = min(e.timestamp for e in parts[0].estimates)
    for ax, track_id in zip(axes.flat, shown, strict=False):
        _speed_panel(ax, parts, comparison, track_id, start)
    for ax in axes.flat[len(shown) :]:
        ax.set_visible(False)
    figure.supxlabel("time [s]")
    figure.supylabel("speed [m/s]")
    axes[0, 0].legend(fontsize=8, loc="lower right")
    figure.suptitle(f"Sequence {sequence.name}: speed over time, {parts[0].smoothing}", fontsize=11)
    return figure


def _speed_panel(ax: Axes, parts: Sequence[Scored], comparison: Comparison, track_id: int, start: float) -> None:
    for part in parts:
        rows = np.flatnonzero(part.track_id == track_id)
        time = np.array([part.estimates[i].timestamp for i in rows]) - start
        time, speed, true = _broken_at_gaps(
            [part.estimates[i].frame for i in rows],
            time,
            np.hypot(*part.velocity[rows].T),
            np.hypot(*part.true[rows].T),
        )
        if part is parts[0]:
            ax.plot(time, true, color="black", lw=2.2, label="truth")
        ax.plot(time, speed, color=_color(comparison, part.estimator), lw=1.1, label=part.estimator)
    rows = np.flatnonzero(parts[0].track_id == track_id)
    near = parts[0].range_m[rows].min()
    ax.set_title(f"track {track_id}, {near:.0f} m at its nearest", fontsize=9)
    top = max(3.0, 1.3 * np.hypot(*parts[0].true[rows].T).max() + 1.0)
    ax.set_ylim(0.0, top)  # an estimator that leaves the panel is far off: the table says how far
    ax.grid(True, alpha=0.3)


def _broken_at_gaps(frames: Sequence[int], *columns: np.ndarray) -> list[np.ndarray]:
    """Put a NaN where frames are missing, so that no line is drawn across."""
    gaps = np.flatnonzero(np.diff(frames) > 1) + 1
    return [np.insert(column.astype(float), gaps, np.nan) for column in columns]


def _birds_eye_view(parts: Sequence[Scored], comparison: Comparison, sequence: SequenceSummary) -> Figure:
    """Draw a panel an estimator: each track's way, with true and estimated velocities once a second."""
    positions = [np.array([e.position for e in part.estimates]) for part in parts]
    low, high = np.min([p.min(axis=0) for p in positions], axis=0), np.max([p.max(axis=0) for p in positions], axis=0)
    width, height = np.maximum(high - low, 10.0)
    stacked = width > height  # long streets one above the other, tall ones side by side
    shape = (len(parts), 1) if stacked else (1, len(parts))
    panel = (11.0, np.clip(11.0 * height / width, 2.5, 8.0) + 0.5) if stacked else (5.5, 8.5)
    figure, axes = plt.subplots(
        *shape, figsize=(panel[0] * shape[1], panel[1] * shape[0]), squeeze=False, layout="constrained"
    )
    for ax, part, position in zip(axes.flat, parts, positions, strict=True):
        _draw_ego(ax, sequence)
        _draw_ways(ax, part, position)
        every = np.array([e.frame % ARROW_FRAMES == 0 for e in part.estimates])
        _draw_arrows(ax, position[every], part.true[every], "black", 0.005, "truth")
        color = _color(comparison, part.estimator)
        _draw_arrows(ax, position[every], part.velocity[every], color, 0.0025, part.estimator)
        ax.set_aspect("equal", adjustable="box")
        ax.set(xlim=(low[0] - 4.0, high[0] + 4.0), ylim=(low[1] - 4.0, high[1] + 4.0), xlabel="x [m]", ylabel="y [m]")
        ax.legend(loc="best", fontsize=8)
        ax.grid(True, alpha=0.3)
    figure.suptitle(
        f"Sequence {sequence.name} from above ({comparison.config.frame} frame, {parts[0].smoothing}): "
        f"an arrow is the way of {ARROW_SECONDS:g} s",
        fontsize=11,
    )
    return figure


def _draw_ego(ax: Axes, sequence: SequenceSummary) -> None:
    if len(sequence.ego_path) > 1:
        ax.plot(*sequence.ego_path.T, color="0.8", lw=6, solid_capstyle="round", label="ego", zorder=1)
    else:
        ax.plot(0.0, 0.0, "^", color="0.4", ms=10, label="ego")


def _draw_ways(ax: Axes, part: Scored, position: np.ndarray) -> None:
    for track_id in np.unique(part.track_id):
        way = position[part.track_id == track_id]
        ax.plot(*way.T, ".", color="0.75", ms=3, zorder=1)
        ax.annotate(str(track_id), way[-1], fontsize=8, xytext=(3, 3), textcoords="offset points")


def _draw_arrows(ax: Axes, position: np.ndarray, velocity: np.ndarray, color: str, width: float, label: str) -> None:
    x, y = position.T
    vx, vy = ARROW_SECONDS * velocity.T
    ax.quiver(x, y, vx, vy, angles="xy", scale_units="xy", scale=1.0, color=color, width=width, label=label, zorder=3)
