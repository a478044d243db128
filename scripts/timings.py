"""What `regmot benchmark` does: what is timed, on which data, as tables and as a file."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import registration
from evaluation import estimator_runtime, runtime, streaming
from evaluation.compare import check_list
from evaluation.cores import in_force
from evaluation.estimator_runtime import EstimatorCost
from evaluation.report import machine, table_cells
from evaluation.runtime import Timing
from tracker.estimators import create_estimator
from tracker.files import write_whole
from tracker.simulation import Recording
from tracker.store import SegmentStore

from .simulations import play_scene

ESTIMATORS = ("fused", "adh-3d", "centroid-kf")  # timed unless others are asked for
STREET_FRAMES = 40  # of the street that estimators step through where no data is given

Progress = Callable[[str, int, int | None], None]
Table = tuple[str, list[str], list[list[str]]]  # title, header, body


@dataclass(frozen=True)
class Order:
    """What to time.

    Attributes:
        root: a KITTI folder; None: data of our own.
        sequences, classes: of the root; no sequence means all.
        methods: names of registration methods; none means all that can be used.
        estimators: names; none means none.
        growth: whether to time how methods grow with points and pairs, and cutting segments.
        seed: of generated data, and for methods that draw random numbers.
    """

    root: Path | None
    sequences: tuple[str, ...]
    classes: tuple[str, ...]
    methods: tuple[str, ...]
    estimators: tuple[str, ...]
    growth: bool
    seed: int

    def __post_init__(self) -> None:
        """Refuse estimators that cannot be used, before any work is done."""
        check_list("estimators", self.estimators, may_be_empty=True)
        for name in self.estimators:
            create_estimator(name)


@dataclass(frozen=True)
class Found:
    """What was measured: pairs of times, and what estimators cost."""

    timings: list[Timing]
    costs: list[EstimatorCost]


def measure(order: Order, progress: Progress) -> Found:
    """Time what is ordered, on data that is gone afterwards.

    Raises:
        TrackerError, RegistrationError: data, a method or an estimator that cannot be used.
    """
    methods = order.methods or tuple(registration.names())
    with TemporaryDirectory() as folder:
        stores = [] if order.root is None else _stores(order.root, order, Path(folder))
        if order.root is None:
            streams = [list(streaming.generated_stream(np.random.default_rng(order.seed)))]
        else:
            streams = [streaming.kitti_stream(store, order.classes) for store in stores]
        timings = streaming.time_streams(streams, methods, progress)
        costs: list[EstimatorCost] = []
        if order.estimators:
            stores = stores or _stores(_street(Path(folder) / "street", order.seed, progress), order, Path(folder))
            costs = estimator_runtime.time_estimators(stores, order.estimators, order.classes, order.seed, progress)
    timings += runtime.benchmark(order.seed) if order.growth else []
    return Found(timings, costs)


def tables(found: Found) -> Iterator[Table]:
    """Give the tables to print; that of estimators only if there are any."""
    body = [[t.what, f"{t.ours_ms:.2f}", t.peer, f"{t.peer_ms:.2f}", f"{t.ratio:.2f}"] for t in found.timings]
    yield machine(), ["what", "ours [ms]", "peer", "peer [ms]", "ratio"], body
    if found.costs:
        body = [table_cells(c.row(), estimator_runtime.TABLE) for c in found.costs]
        yield in_force(), [name for name, _, _ in estimator_runtime.TABLE], body


def write(found: Found, order: Order, path: Path) -> None:
    """Write all figures to a JSON file."""
    about = {"machine": machine(), "seed": order.seed, "root": None if order.root is None else str(order.root)}
    timings = [{**asdict(t), "ratio": t.ratio} for t in found.timings]
    estimators = {"in_force": in_force(), "rows": [c.row() for c in found.costs]}
    write_whole(path, json.dumps({**about, "timings": timings, "estimators": estimators}, indent=1))


def _street(out: Path, seed: int, progress: Progress) -> Path:
    play_scene(out, "street", STREET_FRAMES, seed, progress, ("0000", Recording()))
    return out


def _stores(root: Path, order: Order, cache: Path) -> list[SegmentStore]:
    return streaming.kitti_stores(root, order.sequences, order.classes, cache / "segments")
