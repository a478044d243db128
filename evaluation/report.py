"""What a comparison comes to: rows of the table, `results.json`, `estimates.csv` and Markdown."""

import csv
import io
import json
import math
import os
import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from evaluation.compare import Comparison, Scored
from evaluation.velocity_error import score
from tracker.files import write_whole

RESULTS_FORMAT = 1
RANGE_STEP = 10.0  # width of the bins of the breakdown by range [m]

ESTIMATE_COLUMNS = (
    "sequence", "track_id", "frame", "timestamp", "estimator", "smoothing", "frame_name", "x", "y", "vx", "vy",
    "var_vx", "cov_vxvy", "var_vy", "yaw_rate", "range_m", "n_points", "status", "vx_true", "vy_true",
)  # fmt: skip

# column of the tables: (heading, key of a row, how it is printed)
TABLE = (
    ("estimator", "estimator", "{}"),
    ("smoothing", "smoothing", "{}"),
    ("range", "range_m", "< {:g} m"),
    ("n", "n", "{}"),
    ("RMSE v [m/s]", "rmse_velocity", "{:.3f}"),
    ("RMSE speed", "rmse_speed", "{:.3f}"),
    ("median", "median_velocity_error", "{:.3f}"),
    ("abstained", "abstained", "{}"),
    ("NEES", "nees", "{:.2f}"),
    ("95 % cov.", "coverage_95", "{:.1%}"),
    ("ms", "ms_per_transform", "{:.3f}"),
)  # fmt: skip


def rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Give the table's rows: estimator by smoothing by range, over all sequences."""
    config = comparison.config
    return [
        {
            "estimator": estimator,
            "smoothing": smoothing,
            "frame": config.frame,
            "range_m": range_m,
            **_score(parts, [part.range_m < range_m for part in parts]),
            "ms_per_transform": _mean_ms(parts),
        }
        for estimator, smoothing, parts in _groups(comparison)
        for range_m in config.ranges
    ]


def track_rows(comparison: Comparison) -> list[dict[str, Any]]:
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


def range_rows(comparison: Comparison) -> list[dict[str, Any]]:
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


def results(comparison: Comparison) -> dict[str, Any]:
    """Put everything into the structure of `results.json`; its names are a contract."""
    config = comparison.config
    return {
        "format": RESULTS_FORMAT,
        "version": version("regmot"),
        "machine": machine(),
        "seed": config.seed,
        "config": asdict(config),
        "data": {
            "root": str(comparison.root),
            "sequences": [s.name for s in comparison.sequences],
            "classes": list(config.classes),
            "split": config.split,
            "without_scans": list(comparison.without_scans),
            "details": [
                {
                    "sequence": s.name,
                    "n_frames": s.n_frames,
                    "missing_scans": list(s.missing_scans),
                    "clock": s.clock,
                    "ego": s.ego,
                    "n_tracks": s.n_tracks,
                    "n_parked": s.n_parked,
                    "n_without_points": s.n_without_points,
                }
                for s in comparison.sequences
            ],
        },
        "truth": comparison.truth,
        "window": config.window,
        "rows": rows(comparison),
        "ranges": range_rows(comparison),
        "tracks": track_rows(comparison),
        "estimates": "estimates.csv",
    }


def write(comparison: Comparison, out: Path) -> Path:
    """Write `estimates.csv`, `report.md` and last `results.json` into a folder; give the path of the last."""
    out.mkdir(parents=True, exist_ok=True)
    found = results(comparison)
    write_whole(out / "estimates.csv", _estimates_csv(comparison))
    write_whole(out / "report.md", markdown(found))
    path = out / "results.json"
    write_whole(path, json.dumps(without_nan(found), indent=1))
    return path


def markdown(found: dict[str, Any]) -> str:
    """Word the results as a Markdown page: what was compared, the table, the breakdowns."""
    parts = ["# Velocity errors", "", *(f"- {line}" for line in heading(found)), ""]
    parts += _markdown_table([name for name, _, _ in TABLE], [table_cells(row) for row in found["rows"]])
    parts += [
        "",
        "RMSE v: of the velocity vector, RMSE speed: of its magnitude. NEES: 2 is honest, more is overconfident.",
        "",
    ]
    parts += ["## By range, vector RMSE [m/s]", "", *_pivot(found["ranges"], _range_name), ""]
    parts += ["## By track, vector RMSE [m/s]", "", *_pivot(found["tracks"], _track_name), ""]
    return "\n".join(parts)


def heading(found: dict[str, Any]) -> list[str]:
    """Say what a table was made of, line by line."""
    data = found["data"]
    frame = found["rows"][0]["frame"]
    details = data["details"]
    lines = [
        f"data: {data['root']}, sequences {', '.join(data['sequences'])}, {'+'.join(data['classes'])}",
        f"split: {data['split']}",
        f"velocities in the {frame} frame, truth: {found['truth']}; window: +-{found['window']} frames",
        f"clock: {_distinct(d['clock'] for d in details)}; ego poses: {_distinct(d['ego'] for d in details)}",
        f"tracks: {sum(d['n_tracks'] for d in details)}, of them parked: {sum(d['n_parked'] for d in details)}",
    ]
    n_missing = sum(len(d["missing_scans"]) for d in details)
    n_without = sum(d["n_without_points"] for d in details)
    if data["without_scans"]:
        lines.append(f"sequences without scans, passed over: {', '.join(data['without_scans'])}")
    if n_missing:
        lines.append(f"frames whose scan is missing, skipped: {n_missing}")
    if n_without:
        lines.append(f"steps left out because the box is empty at one end: {n_without}")
    lines.append(f"regmot {found['version']}, seed {found['seed']}, {found['machine']}")
    return lines


def table_cells(row: dict[str, Any], table: Sequence[tuple[str, str, str]] = TABLE) -> list[str]:
    """Print a row of a table; an undefined figure is a dash."""
    cells = []
    for _, key, form in table:
        value = row[key]
        undefined = value is None or (isinstance(value, float) and math.isnan(value))
        cells.append("-" if undefined else form.format(value))
    return cells


def machine() -> str:
    """Name what the timings were taken on."""
    return f"{platform.machine()} {platform.system()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def _groups(comparison: Comparison) -> Iterator[tuple[str, str, list[Scored]]]:
    for estimator in comparison.config.estimators:
        for smoothing in comparison.config.smoothing:
            parts = [p for p in comparison.scored if (p.estimator, p.smoothing) == (estimator, smoothing)]
            yield estimator, smoothing, parts


def _score(parts: Sequence[Scored], masks: Sequence[Bool[np.ndarray, " _"]]) -> dict[str, Any]:
    def gather(column: str) -> np.ndarray:
        return np.concatenate([getattr(part, column)[mask] for part, mask in zip(parts, masks, strict=True)])

    abstained = np.concatenate(
        [
            np.array([e.abstained for e in part.estimates], dtype=bool)[mask]
            for part, mask in zip(parts, masks, strict=True)
        ]
    )
    return asdict(score(gather("velocity"), gather("true"), gather("covariance"), abstained))


def _mean_ms(parts: Sequence[Scored]) -> float:
    n = sum(len(part.velocity) for part in parts)
    return sum(part.ms_per_transform * len(part.velocity) for part in parts) / n if n else float("nan")


def _estimates_csv(comparison: Comparison) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(ESTIMATE_COLUMNS)
    for part in comparison.scored:
        for e, true, range_m in zip(part.estimates, part.true, part.range_m, strict=True):
            (var_vx, cov_vxvy), (_, var_vy) = e.covariance
            numbers = (*e.position, *e.velocity, var_vx, cov_vxvy, var_vy, e.yaw_rate, range_m)
            writer.writerow(
                [part.sequence, e.track_id, e.frame, f"{e.timestamp:.6f}", part.estimator, part.smoothing, e.frame_name]
                + [f"{number:.6g}" for number in numbers]
                + [e.n_points, str(e.status), *(f"{number:.6g}" for number in true)]
            )
    return text.getvalue()


def without_nan(value: Any) -> Any:
    """Replace NaN by null: JSON knows no NaN."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _markdown_table(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(cells)} |" for cells in (header, *body)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:]]


def _pivot(found: Sequence[dict[str, Any]], name: Any) -> list[str]:
    """Lay a breakdown out: a line a bin, a column an estimator and smoothing."""
    columns = list(dict.fromkeys((row["estimator"], row["smoothing"]) for row in found))
    cells: dict[str, dict[tuple[str, str], str]] = {}
    counts: dict[str, int] = {}
    for row in found:
        key = (row["estimator"], row["smoothing"])
        cells.setdefault(name(row), {})[key] = f"{row['rmse_velocity']:.3f}"
        counts[name(row)] = row["n"]
    header = ["", "n", *(f"{estimator} {smoothing}" for estimator, smoothing in columns)]
    body = [[key, str(counts[key]), *(line.get(c, "-") for c in columns)] for key, line in cells.items()]
    return _markdown_table(header, body)


def _range_name(row: dict[str, Any]) -> str:
    return f"{row['from_m']:g}-{row['to_m']:g} m"


def _track_name(row: dict[str, Any]) -> str:
    return f"{row['sequence']} track {row['track_id']}"


def _distinct(values: Any) -> str:
    return ", ".join(dict.fromkeys(values))
