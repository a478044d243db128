"""The command `regmot`: arguments in, files and tables out; the work is done by the libraries."""

import json
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

app = typer.Typer(
    help="How fast is that car? Velocities of tracked objects by registering their own LiDAR points.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Root = Annotated[Path, typer.Argument(help="a KITTI tracking folder (label_02, velodyne, calib) or a raw drive")]
Sequences = Annotated[
    list[str], typer.Option("--sequence", help="name, or names with commas; may be repeated; default: all with scans")
]
Classes = Annotated[str, typer.Option(help="names, comma-separated")]
FrameName = Annotated[str, typer.Option("--frame", help="world, or sensor: relative to the ego")]
Clock = Annotated[str, typer.Option(help="auto: recorded times where there are any; nominal: 10 Hz")]
Ego = Annotated[
    str, typer.Option(help="auto, poses, oxts, odometry, refined, refined-smooth, none; refined:odometry starts there")
]
Deskew = Annotated[bool, typer.Option(help="move each object's points to one instant by the ego's motion")]
BeamAngles = Annotated[bool, typer.Option(help="in odometry, correct KITTI's beams by 0.205 degrees")]
Split = Annotated[str, typer.Option(help="all, id-train|val|test (as published), sequence-train|val|test")]
Ranges = Annotated[str, typer.Option("--range", help="upper ends of the table's ranges [m]")]


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="where the scene, the tables and the pictures go")] = Path("demo-out"),
    frames: Annotated[int, typer.Option(help="length of the simulated scene")] = 100,
    seed: Annotated[int, typer.Option(help="of the scene and its noise")] = 0,
) -> None:
    """Run the main job on the embedded default: simulate a street, track it, compare estimators, draw.

    Example: regmot demo --out demo-out
    """
    root = _simulate(out / "street", "street", frames, seed)
    shown = [name for name in ("adh-3d", "icp", "alignnet", "fused") if _state_of(name) == "ready"]
    _compare(root, out, {"seed": seed, "estimators": ("centroid-kf", *shown)})


@app.command()
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

    from . import simulations
    from .console import messages, progress_bars

    names, is_scene = _names(",".join(sequence)), from_labels is None
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


@app.command()
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
        "sequences": _names(",".join(sequence)),
        "classes": _names(classes),
        "estimators": _names(estimators),
        "smoothing": _names(smoothing),
        "window": window,
        "frame": frame,
        "truth": truth,
        "ranges": _numbers("--range", ranges),
        "split": split,
        "clock": clock,
        "seed": seed,
        "ego": ego,
        "deskew": deskew,
        "correct_beam_angles": correct_beam_angles,
    }
    _compare(root, out, settings)


@app.command()
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

    from .console import messages, progress_bars

    config = TrackConfig(
        estimator=estimator,
        sequences=_names(",".join(sequence)),
        classes=_names(classes),
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


@app.command()
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

    from .console import messages, print_table, progress_bars

    config = registering.RegisterConfig(
        methods=_names(methods),
        sequences=_names(",".join(sequence)),
        classes=_names(classes),
        ranges=_numbers("--range", ranges),
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


@app.command()
def pairs(
    name: Annotated[
        str,
        typer.Argument(
            help="synth-cars, synth-cars-persons, synth-20, synth-20-others; kitti-like-cars, "
            "kitti-like-cars-persons, kitti-tracklets-cars, kitti-tracklets-cars-persons: each also -hard"
        ),
    ],
    out: Annotated[Path, typer.Option(help="the set's folder; must not hold anything yet")],
    seed: Annotated[int, typer.Option(help="of a generated set")] = 0,
    counts: Annotated[str, typer.Option(help="pairs to generate: train,val,test")] = "8000,1000,1000",
    meshes: Annotated[Path | None, typer.Option(help="folder of meshes for synth-*; default: our own shapes")] = None,
    jobs: Annotated[int, typer.Option(help="processes that generate; 0: one a core")] = 0,
    root: Annotated[Path | None, typer.Option(help="kitti-tracklets-* need it: a KITTI folder with scans")] = None,
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    rule: Annotated[str, typer.Option(help="part of a pair of kitti-tracklets-*: by track id, or by sequence")] = "id",
) -> None:
    """Write a set of cloud pairs with known motion, in AlignNet-3D's format on disk: generated, or cut from KITTI.

    A generated set that was interrupted goes on when the same command is run again.

    Example: regmot pairs synth-cars --out synth-cars --seed 1

    Example: regmot pairs kitti-tracklets-cars --root kitti/tracking --out pairs
    """
    from registration.pair_set import PARTS

    from . import pair_sets
    from .console import messages, progress_bars

    is_cut = pair_sets.is_cut_from_kitti(name)
    if is_cut != (root is not None):
        raise typer.BadParameter(
            f"{name} {'needs --root: it is cut from KITTI scans' if is_cut else 'takes no --root'}"
        )
    if is_cut and meshes is not None:
        raise typer.BadParameter(f"{name} takes no --meshes: it is cut from KITTI scans")
    with progress_bars() as progress:
        if root is not None:
            written = pair_sets.cut(name, root, _names(",".join(sequence)), rule, out, progress)
        else:
            order = pair_sets.order_of(name, meshes, seed, counts)
            written = pair_sets.generate(order, out, jobs, progress)
    messages.print(", ".join(f"{part}: {len(written.ids(part))}" for part in PARTS) + f" pairs in {out}")


@app.command()
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
    from . import training
    from .console import messages, print_table, progress_bars

    plan = training.plan(recipe, settings, data, mirrored_angles)
    with progress_bars() as progress:
        path = training.run(plan, out, start_from, progress)
    if training.is_first():
        print_table(*training.table(path))
        messages.print(f"weights in {path}")


@app.command()
def methods() -> None:
    """List registration methods and velocity estimators: where they come from and whether they can be used.

    Example: regmot methods
    """
    import registration
    from registration.registry import source_of
    from tracker.estimators import estimator_names

    from .console import print_table

    body = []
    for name in estimator_names():
        if name in registration.names():
            body.append([name, "registration method, estimator", source_of(name), _state_of(name)])
        else:
            body.append([name, "estimator", "regmot", _state_of(name)])
    print_table(["name", "what", "from", "state"], body)


@app.command()
def splits(root: Root, classes: Classes = "Car,Van") -> None:
    """Count the pairs of consecutive labels in each part of AlignNet-3D's splits; needs labels only.

    Example: regmot splits kitti/tracking --classes Car,Van
    """
    from tracker.errors import MissingDataError
    from tracker.kitti.labels import read_labels
    from tracker.kitti.splits import count_pairs
    from tracker.kitti.tracking import sequence_names, training_folder

    from .console import print_table

    folder = training_folder(root)
    if folder is None:
        raise MissingDataError(f"{root}: expected a KITTI tracking folder with label_02")
    labels = {name: read_labels(folder / "label_02" / f"{name}.txt") for name in sequence_names(folder)}
    counts = count_pairs(labels, _names(classes))
    body = [[c.split, str(c.total), str(c.within_80m), str(c.within_20m)] for c in counts]
    print_table(["split", "pairs", "<= 80 m", "<= 20 m"], body)


@app.command()
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
    from evaluation.realism_plots import draw
    from evaluation.report import table_cells

    from .console import messages, print_table, progress_bars
    from .simulations import LabelPlay, play_labels

    with progress_bars() as progress:
        if simulated is None:
            simulated = out / "simulated"
            play_labels(simulated, root, (sequence,), LabelPlay(seed), progress, 1)
        sides = report.compare_folders(root, simulated, sequence, _names(classes), out / "tracklets", progress)
    rows = report.table(*sides)
    path = report.write(rows, root, simulated, sequence, out)
    print_table([name for name, _, _ in report.TABLE], [table_cells(row, report.TABLE) for row in rows])
    messages.print(f"rows in {path}")
    messages.print(f"picture: {draw(*sides, out)}")


@app.command()
def benchmark(
    root: Annotated[Path | None, typer.Argument(help="a KITTI folder: time transforms on its segments")] = None,
    sequence: Sequences = [],  # noqa: B006 - typer makes a new list of it
    classes: Classes = "Car,Van",
    methods: Annotated[str, typer.Option(help="names, comma-separated; default: all that can be used")] = "",
    growth: Annotated[bool, typer.Option(help="also how times grow with points and with pairs")] = True,
    out: Annotated[Path | None, typer.Option(help="also write the timings to this JSON file")] = None,
    seed: Annotated[int, typer.Option(help="of the generated data")] = 0,
) -> None:
    """Time the hot paths beside their peers in one run: transforms in a tracker, growth, cutting segments.

    Open3D gets one thread, like ours, unless OMP_NUM_THREADS says otherwise.

    Example: regmot benchmark --out timings.json
    """
    from dataclasses import asdict

    import numpy as np

    import registration
    from evaluation import runtime, streaming
    from evaluation.report import machine
    from tracker.files import write_whole

    from .console import messages, print_table, progress_bars

    os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when Open3D is loaded
    names = _names(methods) or tuple(registration.names())
    with TemporaryDirectory() as cache, progress_bars() as progress:
        if root is None:
            streams = [list(streaming.generated_stream(np.random.default_rng(seed)))]
        else:
            streams = streaming.kitti_streams(root, _names(",".join(sequence)), _names(classes), Path(cache))
        timings = streaming.time_streams(streams, names, progress)
    timings += runtime.benchmark(seed) if growth else []
    body = [[t.what, f"{t.ours_ms:.2f}", t.peer, f"{t.peer_ms:.2f}", f"{t.ratio:.2f}"] for t in timings]
    print_table(["what", "ours [ms]", "peer", "peer [ms]", "ratio"], body, title=machine())
    if out is not None:
        rows = [{**asdict(t), "ratio": t.ratio} for t in timings]
        about = {"machine": machine(), "seed": seed, "root": None if root is None else str(root)}
        write_whole(out, json.dumps({**about, "timings": rows}, indent=1))
        messages.print(f"timings in {out}")


def main(arguments: list[str] | None = None) -> None:
    """Run the command; our own errors end it with one line on stderr and exit code 1."""
    from registration.errors import RegistrationError
    from tracker.errors import TrackerError

    try:
        app(arguments)
    except (TrackerError, RegistrationError, OSError) as error:
        typer.echo(f"regmot: {error}", err=True)
        sys.exit(1)


def _simulate(out: Path, scene: str, frames: int, seed: int) -> Path:
    from tracker.simulation import Recording

    from . import simulations
    from .console import messages, progress_bars

    with progress_bars() as progress:
        simulations.play_scene(out, scene, frames, seed, progress, ("0000", Recording()))
    messages.print(f"scans, labels and exact truth in {out}")
    return out


def _compare(root: Path, out: Path, settings: dict[str, Any]) -> None:
    from evaluation import plots, report
    from evaluation.compare import CompareConfig
    from evaluation.compare import compare as run_comparison

    from .console import messages, print_table, progress_bars

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
    for picture in plots.draw(comparison, out):
        messages.print(f"picture: {picture}")


def _state_of(name: str) -> str:
    """Say whether an estimator, or a registration method, can be created here, or why not."""
    from registration.errors import RegistrationError
    from tracker.estimators import create_estimator

    try:
        create_estimator(name)
    except (RegistrationError, TypeError, ValueError) as error:
        return str(error)
    return "ready"


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in _names(text))
    except ValueError:
        raise typer.BadParameter(f"{option} expects numbers, comma-separated, got {text!r}") from None
