"""Commands about registration: its table, sets of pairs, training on them, methods, splits of KITTI's pairs."""

from pathlib import Path
from typing import Annotated

import typer

from .available import state_of
from .options import Classes, Ranges, Root, Sequences, Split, names_in, numbers_in


def register(
    root: Annotated[Path, typer.Argument(metavar="PAIRS", help="a set of pairs on disk, or a KITTI folder")],
    methods: Annotated[str, typer.Option(help="names, comma-separated: see `regmot methods`")] = "centroid,icp",
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    classes: Classes = "Car,Van",
    ranges: Ranges = "80,20,5",
    split: Split = "all",
    part: Annotated[str, typer.Option(help="of a set on disk: train, val or test")] = "test",
    mirrored_angles: Annotated[bool, typer.Option(help="the set holds the camera's angles, as released")] = False,
    full_heading: Annotated[bool, typer.Option(help="count a turn by 180 degrees as wrong")] = False,
    out: Annotated[Path, typer.Option(help="where registration.json and cut segments go")] = Path("out"),
) -> None:
    """Score registration methods on a set of pairs, or on the consecutive segments of KITTI tracklets.

    Example: regmot register kitti/tracking --sequence 0000 --methods centroid,icp --out out
    """
    from evaluation import register as registering
    from evaluation.report import table_cells

    from ..console import messages, print_table, progress_bars

    config = registering.RegisterConfig(
        methods=names_in(methods),
        sequences=names_in(",".join(sequence)),
        classes=names_in(classes),
        ranges=numbers_in("--range", ranges),
        split=split,
        part=part,
        mirrored_angles=mirrored_angles,
        heading_axis=not full_heading,
    )
    with progress_bars() as progress:
        rows = registering.register_pairs(root, config, out / "tracklets", progress)
    path = registering.write(rows, root, config, out)
    for line in registering.heading(root, config):
        messages.print(line)
    print_table([name for name, _, _ in registering.TABLE], [table_cells(row, registering.TABLE) for row in rows])
    messages.print(f"rows in {path}")


def pairs(
    name: Annotated[
        str,
        typer.Argument(
            help="synth-cars, synth-cars-persons, synth-20, synth-20-others; kitti-like-cars, "
            "kitti-like-cars-persons, kitti-tracklets-cars, kitti-tracklets-cars-persons: each also -hard; "
            "kitti-looks-cars"
        ),
    ],
    out: Annotated[Path, typer.Option(help="the set's folder; must not hold anything yet")],
    seed: Annotated[int, typer.Option(help="of a generated set")] = 0,
    counts: Annotated[str, typer.Option(help="pairs to generate: train,val,test")] = "8000,1000,1000",
    meshes: Annotated[Path | None, typer.Option(help="folder of meshes for synth-*; default: our own shapes")] = None,
    jobs: Annotated[int, typer.Option(help="processes that generate; 0: one a core")] = 0,
    root: Annotated[
        Path | None, typer.Option(help="kitti-tracklets-*, kitti-looks-* need it: a KITTI folder with scans")
    ] = None,
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    rule: Annotated[str, typer.Option(help="part of a pair cut from KITTI: by track id, or by sequence")] = "id",
) -> None:
    """Write a set of cloud pairs with known motion, in AlignNet-3D's format on disk: generated, or cut from KITTI.

    A generated set that was interrupted goes on when the same command is run again.

    Example: regmot pairs synth-cars --out synth-cars --seed 1

    Example: regmot pairs kitti-tracklets-cars --root kitti/tracking --out pairs
    """
    from registration.pair_set import PARTS

    from .. import pair_sets
    from ..console import messages, progress_bars

    is_cut = pair_sets.is_cut_from_kitti(name)
    if is_cut != (root is not None):
        raise typer.BadParameter(
            f"{name} {'needs --root: it is cut from KITTI scans' if is_cut else 'takes no --root'}"
        )
    if is_cut and meshes is not None:
        raise typer.BadParameter(f"{name} takes no --meshes: it is cut from KITTI scans")
    with progress_bars() as progress:
        if root is not None:
            written = pair_sets.cut(name, root, names_in(",".join(sequence)), rule, out, progress)
        else:
            order = pair_sets.order_of(name, meshes, seed, counts)
            written = pair_sets.generate(order, out, jobs, progress)
    messages.print(", ".join(f"{part}: {len(written.ids(part))}" for part in PARTS) + f" pairs in {out}")


def train(
    recipe: Annotated[str, typer.Argument(help="a TOML file, or one of ours: paper, gpu, cpu, fine-tune")],
    data: Annotated[list[Path], typer.Option(help="a set of pairs (see `regmot pairs`); may be repeated")],
    out: Annotated[Path, typer.Option(help="where weights, log and state go; a training there goes on")],
    settings: Annotated[
        list[str], typer.Option("--set", help="a setting of the recipe, as training.epochs=3; may be repeated")
    ] = [],  # noqa: B006 - typer makes a new list of it
    start_from: Annotated[Path | None, typer.Option(help="weights to start from, to fine-tune them")] = None,
    mirrored_angles: Annotated[bool, typer.Option(help="the sets hold the camera's angles, as released")] = False,
) -> None:
    """Train AlignNet by a recipe; run the same command again to go on with what was interrupted.

    Example: regmot train cpu --data synth-cars --set training.epochs=20 --out alignnet-cars

    On several GPUs: torchrun --nproc-per-node 4 -m regmot train gpu --data synth-cars --out alignnet-cars
    """
    from .. import training
    from ..console import messages, print_table, progress_bars

    plan = training.plan(recipe, settings, data, mirrored_angles)
    with progress_bars() as progress:
        path = training.run(plan, out, start_from, progress)
    if training.is_first():
        print_table(*training.table(path))
        messages.print(f"weights in {path}")


def methods() -> None:
    """List registration methods and velocity estimators: where they come from and whether they can be used.

    Example: regmot methods
    """
    import registration
    from registration.registry import source_of
    from tracker.estimators import estimator_names

    from ..console import print_table

    body = []
    for name in estimator_names():
        if name in registration.names():
            body.append([name, "registration method, estimator", source_of(name), state_of(name)])
        else:
            body.append([name, "estimator", "regmot", state_of(name)])
    print_table(["name", "what", "from", "state"], body)


def splits(root: Root, classes: Classes = "Car,Van") -> None:
    """Count the pairs of consecutive labels in each part of AlignNet-3D's splits; needs labels only.

    Example: regmot splits kitti/tracking --classes Car,Van
    """
    from tracker.errors import MissingDataError
    from tracker.kitti.labels import read_labels
    from tracker.kitti.splits import count_pairs
    from tracker.kitti.tracking import sequence_names, training_folder

    from ..console import print_table

    folder = training_folder(root)
    if folder is None:
        raise MissingDataError(f"{root}: expected a KITTI tracking folder with label_02")
    labels = {name: read_labels(folder / "label_02" / f"{name}.txt") for name in sequence_names(folder)}
    counts = count_pairs(labels, names_in(classes))
    body = [[c.split, str(c.total), str(c.within_80m), str(c.within_20m)] for c in counts]
    print_table(["split", "pairs", "<= 80 m", "<= 20 m"], body)
