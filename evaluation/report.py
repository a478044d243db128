"""What a comparison comes to: rows of the table, `results.json`, `estimates.csv` and Markdown."""

import csv
import io
import json
import math
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from evaluation.compare import Comparison
from evaluation.tables import class_rows, range_rows, rows, track_rows
from tracker.estimators import CAUSAL
from tracker.files import write_whole

RESULTS_FORMAT = 1

ESTIMATE_COLUMNS = (
    "sequence", "track_id", "frame", "timestamp", "estimator", "smoothing", "frame_name", "x", "y", "vx", "vy",
    "var_vx", "cov_vxvy", "var_vy", "yaw_rate", "range_m", "n_points", "status", "vx_true", "vy_true",
)  # fmt: skip

Column = tuple[str, str, str]  # of a table: heading, key of a row, how it is printed
_Print = Callable[[dict[str, Any]], str]

TABLE = (
    ("estimator", "estimator", "{}"),
    ("smoothing", "smoothing", "{}"),
    ("range", "range_m", "< {:g} m"),
    ("n", "n", "{}"),
    ("RMSE v", "rmse_velocity", "{:.3f}"),
    ("RMSE speed", "rmse_speed", "{:.3f}"),
    ("median", "median_velocity_error", "{:.3f}"),
    ("99 %", "p99_velocity_error", "{:.3f}"),
    ("abstained", "abstained", "{}"),
    ("NEES", "nees", "{:.2f}"),
    ("95 % cov.", "coverage_95", "{:.1%}"),
    ("ms", "ms_per_transform", "{:.3f}"),
)  # fmt: skip

# The second table: may the figures be relied on?
USE_TABLE = (
    ("estimator", "estimator", "{}"),
    ("smoothing", "smoothing", "{}"),
    ("class", "class_name", "{}"),
    ("range", "range_m", "< {:g} m"),
    ("n", "n", "{}"),
    ("NEES", "nees", "{:.2f}"),
    ("95 % cov.", "coverage_95", "{:.1%}"),
    ("false motion", "false_motion", "{:.1%}"),
    ("tracks", "n_tracks", "{}"),
    ("lost", "lost_tracks", "{}"),
    ("steps", "n_delays", "{}"),
    ("delay [s]", "delay_s", "{:.2f}"),
)  # fmt: skip


TABLE_NOTE = """\
RMSE v: of the velocity vector, RMSE speed: of its magnitude; median and 99 %: percentiles of the vector error [m/s].
NEES: 2 is honest, more is overconfident."""
USE_NOTE = """\
False motion: share of the steps of parked objects with a speed above 0.3 m/s; in the sensor's frame it means nothing.
Lost: tracks of more than five frames whose error stays above 2 m/s in every frame after the fifth.  Delay: after steps
of the true acceleration of 1.5 m/s^2 or more that last 0.5 s, the median shift in time between truth and estimate; it
needs exact truth."""


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
                    "flagged_poses": list(s.flagged_poses),
                    "n_tracks": s.n_tracks,
                    "n_parked": s.n_parked,
                    "n_without_points": s.n_without_points,
                }
                for s in comparison.sequences
            ],
        },
        "ego": ", ".join(dict.fromkeys(s.ego for s in comparison.sequences)),
        "deskew": config.deskew,
        "truth": comparison.truth,
        "window": config.window,
        "rows": rows(comparison),
        "ranges": range_rows(comparison),
        "classes": class_rows(comparison),
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
    """Word the results as a Markdown page: what was compared, the tables, the breakdowns."""
    parts = ["# Velocity errors", "", *(f"- {line}" for line in heading(found)), ""]
    parts += [*markdown_table(TABLE, found["rows"]), "", TABLE_NOTE, ""]
    parts += ["## In use", "", *markdown_table(USE_TABLE, use_rows(found)), "", USE_NOTE, ""]
    parts += ["## By range, vector RMSE [m/s]", "", *_pivot(found["ranges"], _range_name, _rmse), ""]
    parts += ["## By range, NEES (95 % coverage)", "", *_pivot(found["ranges"], _range_name, _calibration), ""]
    parts += ["## By track, vector RMSE [m/s]", "", *_pivot(found["tracks"], _track_name, _rmse), ""]
    return "\n".join(parts)


def use_rows(found: dict[str, Any], is_brief: bool = False) -> list[dict[str, Any]]:
    """Give the rows of the second table: all classes by range, then each class, where there are several, at any range.

    Args:
        found: what `results` gives.
        is_brief: only what a live user would see, `causal` (where that was not asked for, the first smoothing), and
            no ranges without a step.
    """
    widest = max(row["range_m"] for row in found["rows"])
    names = list(dict.fromkeys((row["estimator"], row["smoothing"]) for row in found["rows"]))
    smoothings = [smoothing for _, smoothing in names]
    shown = CAUSAL if CAUSAL in smoothings else smoothings[0]
    body = []
    for name in names:
        if is_brief and name[1] != shown:
            continue
        every, each = (
            [row for row in found[part] if (row["estimator"], row["smoothing"]) == name] for part in ("rows", "classes")
        )
        body += [{**row, "class_name": "all"} for row in every if row["n"] or not is_brief]
        if len({row["class_name"] for row in each}) > 1:
            body += [row for row in each if row["range_m"] == widest]
    return body


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


def table_cells(row: dict[str, Any], table: Sequence[Column] = TABLE) -> list[str]:
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


def markdown_table(table: Sequence[Column], body: Sequence[dict[str, Any]]) -> list[str]:
    """Print rows as lines of a Markdown table, as the README shows them."""
    return _lines([name for name, _, _ in table], [table_cells(row, table) for row in body])


def _lines(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(cells)} |" for cells in (header, *body)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:]]


def _pivot(found: Sequence[dict[str, Any]], name: _Print, cell: _Print) -> list[str]:
    """Lay a breakdown out: a line a bin, a column an estimator and smoothing."""
    columns = list(dict.fromkeys((row["estimator"], row["smoothing"]) for row in found))
    cells: dict[str, dict[tuple[str, str], str]] = {}
    counts: dict[str, int] = {}
    for row in found:
        cells.setdefault(name(row), {})[row["estimator"], row["smoothing"]] = cell(row)
        counts[name(row)] = row["n"]
    header = ["", "n", *(f"{estimator} {smoothing}" for estimator, smoothing in columns)]
    body = [[key, str(counts[key]), *(line.get(c, "-") for c in columns)] for key, line in cells.items()]
    return _lines(header, body)


def _rmse(row: dict[str, Any]) -> str:
    return f"{row['rmse_velocity']:.3f}"


def _calibration(row: dict[str, Any]) -> str:
    return f"{row['nees']:.2f} ({row['coverage_95']:.1%})"


def _range_name(row: dict[str, Any]) -> str:
    return f"{row['from_m']:g}-{row['to_m']:g} m"


def _track_name(row: dict[str, Any]) -> str:
    return f"{row['sequence']} track {row['track_id']}"


def _distinct(values: Any) -> str:
    return ", ".join(dict.fromkeys(values))
