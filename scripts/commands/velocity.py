"""Commands that end in velocities: the demo, the comparison of estimators, the tracker."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .available import ready
from .options import (
    BeamAngles,
    Classes,
    Clock,
    Deskew,
    Ego,
    FrameName,
    Ranges,
    Root,
    Sequences,
    Split,
    names_in,
    numbers_in,
)


def demo(
    out: Annotated[Path, typer.Option(help="where the scene, the tables and the pictures go")] = Path("demo-out"),
    frames: Annotated[int, typer.Option(help="length of the simulated scene")] = 100,
    seed: Annotated[int, typer.Option(help="of the scene and its noise")] = 0,
) -> None:
    """Run the main job on the embedded default: simulate a street, track it, compare estimators, draw.

    Example: regmot demo --out demo-out
    """
    root = _simulate(out / "street", "street", frames, seed)
    estimators = ("centroid-kf", *ready(("adh-3d", "icp", "alignnet", "fused")))
    _compare(root, out, {"seed": seed, "estimators": estimators})


def compare(
    root: Root,
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    classes: Classes = "Car,Van",
    estimators: Annotated[str, typer.Option(help="names, comma-separated: see `regmot methods`")] = "centroid-kf,icp",
    smoothing: Annotated[str, typer.Option(help="of causal, window, rts, lag1, lag2, lag3")] = "causal,window,rts",
    window: Annotated[int, typer.Option(help="half width of the window mean [frames]; the paper's is 1")] = 1,
    frame: FrameName = "world",
    truth: Annotated[str, typer.Option(help="labels, smoothed, exact; auto: exact where it is there")] = "auto",
    ranges: Ranges = "80,20,5",
    split: Split = "all",
    clock: Clock = "auto",
    ego: Ego = "auto",
    deskew: Deskew = False,
    correct_beam_angles: BeamAngles = False,
    seed: Annotated[int, typer.Option(help="for methods that draw random numbers")] = 0,
    out: Annotated[Path, typer.Option(help="where tables, pictures and cut segments go")] = Path("out"),
) -> None:
    """Score velocity estimators on the same steps of KITTI tracklets, in one fair table.

    Example: regmot compare kitti/tracking --sequence 0000 --frame world --truth smoothed --out out

    Example: regmot compare drives/2011_09_26 --ego refined --deskew --out out
    """
    settings = {
        "sequences": names_in(",".join(sequence)),
        "classes": names_in(classes),
        "estimators": names_in(estimators),
        "smoothing": names_in(smoothing),
        "window": window,
        "frame": frame,
        "truth": truth,
        "ranges": numbers_in("--range", ranges),
        "split": split,
        "clock": clock,
        "seed": seed,
        "ego": ego,
        "deskew": deskew,
        "correct_beam_angles": correct_beam_angles,
    }
    _compare(root, out, settings)


def track(
    root: Root,
    estimator: Annotated[str, typer.Option(help="see `regmot methods`")] = "icp",
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    classes: Classes = "Car,Van",
    frame: FrameName = "world",
    clock: Clock = "auto",
    ego: Ego = "auto",
    deskew: Deskew = False,
    correct_beam_angles: BeamAngles = False,
    out: Annotated[Path, typer.Option(help="one CSV a sequence is written here")] = Path("tracks"),
) -> None:
    """Follow the objects of KITTI sequences frame by frame and write their velocities.

    Example: regmot track kitti/tracking --sequence 0000 --estimator icp --out tracks
    """
    from tracker.run import TrackConfig, track_sequences

    from ..console import messages, progress_bars

    config = TrackConfig(
        estimator=estimator,
        sequences=names_in(",".join(sequence)),
        classes=names_in(classes),
        frame=frame,
        clock=clock,
        ego=ego,
        deskew=deskew,
        correct_beam_angles=correct_beam_angles,
    )
    with progress_bars() as progress:
        paths = track_sequences(root, config, out, progress)
    for path, n_rows in paths:
        messages.print(f"{n_rows} velocities in {path}")


def _simulate(out: Path, scene: str, frames: int, seed: int) -> Path:
    from tracker.simulation import Recording

    from .. import simulations
    from ..console import messages, progress_bars

    with progress_bars() as progress:
        simulations.play_scene(out, scene, frames, seed, progress, ("0000", Recording()))
    messages.print(f"scans, labels and exact truth in {out}")
    return out


def _compare(root: Path, out: Path, settings: dict[str, Any]) -> None:
    from evaluation import report
    from evaluation.compare import CompareConfig
    from evaluation.compare import compare as run_comparison

    from ..console import messages, print_table, progress_bars

    config = CompareConfig(**settings)
    with progress_bars() as progress:
        comparison = run_comparison(root, config, out / "tracklets", progress)
    path = report.write(comparison, out)
    found = report.results(comparison)
    for line in report.heading(found):
        messages.print(line, highlight=False)
    for table, body in ((report.TABLE, found["rows"]), (report.USE_TABLE, report.use_rows(found, is_brief=True))):
        print_table([name for name, _, _ in table], [report.table_cells(row, table) for row in body])
    messages.print(f"tables: {path}, {out / 'report.md'}, {out / 'estimates.csv'}")
    from evaluation import plots  # matplotlib takes half a second to load: errors are told without

    for picture in plots.draw(comparison, out):
        messages.print(f"picture: {picture}")
