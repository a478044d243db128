"""Commands that simulate: traffic as a KITTI folder, and how real it is."""

from pathlib import Path
from typing import Annotated

import typer

from .options import Classes, names_in


def simulate(
    out: Annotated[Path, typer.Argument(help="the KITTI tracking folder to write")],
    scene: Annotated[
        str | None,
        typer.Option(help="a scene: urban (the default), highway, crossing, parked-row, roundabout, crowd, braking"),
    ] = None,
    from_labels: Annotated[
        Path | None, typer.Option(metavar="ROOT", help="play the labels of a KITTI tracking folder again instead")
    ] = None,
    sequence: Annotated[
        list[str], typer.Option(help="of ROOT, names with commas, may be repeated; default: all. Of a scene: its name")
    ] = [],  # noqa: B006 - typer makes a new list of it
    frames: Annotated[int | None, typer.Option(help="length, at 10 Hz; default: 100, with labels all")] = None,
    seed: Annotated[int, typer.Option(min=0, help="of shapes, scene and noise")] = 0,
    beams: Annotated[str, typer.Option(help="the sensor: name of a beam model, or a table (.csv)")] = "HDL-64E",
    box_jitter: Annotated[bool, typer.Option(help="let labels jitter like KITTI's; truth stays exact")] = False,
    rolling_shutter: Annotated[
        bool | None, typer.Option(help="let things move during a sweep; default: with labels, not in scenes")
    ] = None,
    occluders: Annotated[bool, typer.Option(help="hide objects whose labels say they are occluded")] = True,
    jobs: Annotated[int, typer.Option(help="processes, with --from-labels; 0: one a core")] = 0,
) -> None:
    """Ray-cast traffic into a KITTI tracking folder with exact truth: a scene of our own, or real labels.

    A run that was interrupted goes on when the same command is run again.

    Example: regmot simulate street-out --scene urban --frames 100 --seed 1
    Example: regmot simulate kitti-sim --from-labels kitti/tracking --sequence 0006,0010
    """
    from tracker.simulation import LabelPlay

    from .. import simulations
    from ..console import messages, progress_bars

    names, is_scene = names_in(",".join(sequence)), from_labels is None
    if scene is not None and not is_scene:
        raise typer.BadParameter("--scene and --from-labels exclude each other")
    if is_scene and len(names) > 1:
        raise typer.BadParameter("a scene makes one --sequence")
    is_rolling = not is_scene if rolling_shutter is None else rolling_shutter
    recording = simulations.recording_of(beams, is_rolling, box_jitter)
    with progress_bars() as progress:
        if from_labels is None:
            simulations.play_scene(out, scene, frames, seed, progress, ((*names, "0000")[0], recording))
        else:
            play = LabelPlay(seed, frames, occluders, recording)
            simulations.play_labels(out, from_labels, names, play, progress, jobs)
    messages.print(f"scans, labels and exact truth in {out}")


def realism(
    root: Annotated[Path, typer.Argument(help="a KITTI tracking folder with labels and scans")],
    sequence: Annotated[str, typer.Option(help="name of the sequence")] = "0000",
    classes: Classes = "Car,Van",
    simulated: Annotated[Path | None, typer.Option(help="the same sequence, simulated; default: made in OUT")] = None,
    seed: Annotated[int, typer.Option(help="of the simulation")] = 0,
    out: Annotated[Path, typer.Option(help="where the table, the picture and the simulation go")] = Path("realism"),
) -> None:
    """Compare real segments with simulated ones in the same boxes: points, rings, noise, gaps, registration errors.

    Example: regmot realism kitti/tracking --sequence 0000 --out realism
    """
    from evaluation import realism as report
    from evaluation.report import table_cells

    from ..console import messages, print_table, progress_bars
    from ..simulations import LabelPlay, play_labels

    with progress_bars() as progress:
        if simulated is None:
            simulated = out / "simulated"
            play_labels(simulated, root, (sequence,), LabelPlay(seed), progress, 1)
        sides = report.compare_folders(root, simulated, sequence, names_in(classes), out / "tracklets", progress)
    rows = report.table(*sides)
    path = report.write(rows, root, simulated, sequence, out)
    print_table([name for name, _, _ in report.TABLE], [table_cells(row, report.TABLE) for row in rows])
    messages.print(f"rows in {path}")
    from evaluation.realism_plots import draw  # matplotlib takes half a second to load: errors are told without

    messages.print(f"picture: {draw(*sides, out)}")
