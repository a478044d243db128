"""The command that times things beside their peers."""

from pathlib import Path
from typing import Annotated

import typer

from .available import ready
from .options import Classes, Sequences, names_in

NONE = "none"


def benchmark(
    root: Annotated[
        Path | None, typer.Argument(help="a KITTI folder: time transforms and estimators on its segments")
    ] = None,
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    classes: Classes = "Car,Van",
    methods: Annotated[str, typer.Option(help="names, comma-separated; default: all that can be used")] = "",
    estimators: Annotated[
        str,
        typer.Option(
            help="names, comma-separated, or none; default: what can be used of fused,adh-3d,centroid-kf. "
            "Without ROOT they run on a street simulated for them"
        ),
    ] = "",
    growth: Annotated[bool, typer.Option(help="also how times grow with points and with pairs")] = True,
    out: Annotated[Path | None, typer.Option(help="also write the timings to this JSON file")] = None,
    seed: Annotated[int, typer.Option(help="of the generated data")] = 0,
) -> None:
    """Time the hot paths beside their peers in one run: transforms, estimators, growth, cutting segments.

    All of it runs in one thread on one core, Open3D too, unless OMP_NUM_THREADS says otherwise.

    Example: regmot benchmark --out timings.json
    """
    from evaluation.cores import keep_to_one_core

    keep_to_one_core()  # before anything is loaded that looks at the cores once
    from .. import timings
    from ..console import messages, print_table, progress_bars

    order = timings.Order(
        root=root,
        sequences=names_in(",".join(sequence)),
        classes=names_in(classes),
        methods=names_in(methods),
        estimators=() if estimators == NONE else names_in(estimators) or ready(timings.ESTIMATORS),
        growth=growth,
        seed=seed,
    )
    with progress_bars() as progress:
        found = timings.measure(order, progress)
    for title, header, body in timings.tables(found):
        print_table(header, body, title=title)
    if out is not None:
        timings.write(found, order, out)
        messages.print(f"timings in {out}")
