"""The picture of how real simulated segments are: both sides over range, and what registration makes of them."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only: no screen is needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from evaluation.realism import METHODS, RANGES, Key, Side
from evaluation.realism import quantities as all_quantities

COLORS = {"real": "#D55E00", "simulated": "#0072B2"}  # of Okabe & Ito's palette
OVER_RANGE = ("points", "points per ring", "missing returns", "roughness [m]")
LOGARITHMIC = ("points", "points per ring", "roughness [m]")


def draw(real: Side, simulated: Side, out: Path) -> Path:
    """Draw `out/realism.png`: every segment of both sides against range with the bins' medians, and error curves."""
    figure, axes = plt.subplots(2, 3, figsize=(13, 7.5), layout="constrained")
    panels = list(axes.flat)
    for axis, name in zip(panels, OVER_RANGE, strict=False):
        for label, side in (("real", real), ("simulated", simulated)):
            _against_range(axis, side, name, label)
        axis.set(title=name, xlabel="range [m]", xlim=(0.0, None))
        if name in LOGARITHMIC:
            axis.set_yscale("log")
    if panels[0].get_legend_handles_labels()[0]:  # else there is nothing in range
        panels[0].legend()
    for axis, method in zip(panels[len(OVER_RANGE) :], METHODS, strict=True):
        for label, side in (("real", real), ("simulated", simulated)):
            errors = np.sort(list(side.errors[method].values()))
            axis.plot(errors, (np.arange(len(errors)) + 1.0) / max(len(errors), 1), color=COLORS[label], label=label)
        axis.set(
            title=f"{method}: share of steps", xlabel="velocity error below [m/s]", xscale="log", xlim=(0.01, 20.0)
        )
        axis.grid(alpha=0.3)
    path = out / "realism.png"
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)
    return path


def _against_range(axis: Axes, side: Side, name: str, label: str) -> None:
    value = all_quantities()[name]
    keys: list[Key] = sorted(side.looks)
    range_m = np.array([side.looks[key].range_m for key in keys])
    values = np.array([value(side, key) for key in keys], dtype=np.float64)
    axis.plot(range_m, values, ".", ms=2.5, alpha=0.35, color=COLORS[label])
    for low, high in zip(RANGES[:-1], RANGES[1:], strict=True):
        inside = values[(low <= range_m) & (range_m < high)]
        if np.isfinite(inside).any():
            middle = float(np.nanmedian(inside))
            top = min(high, float(range_m.max()) + 2.0)
            axis.plot([low, top], [middle, middle], color=COLORS[label], lw=2.0, label=label if low == 0.0 else None)
