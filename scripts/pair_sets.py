"""What `regmot pairs` does: sets that are generated, and sets that are cut from KITTI's tracklets."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from registration.errors import PairSetError, unknown_name
from registration.pair_set import PairSet, write_pair_set
from registration.synthetic.catalogue import create_recipe, generated_names
from registration.synthetic.production import Order, make_pair_set
from tracker.kitti import KittiSequence, open_sequences
from tracker.kitti.tracking import simulation_of, training_folder
from tracker.pairs import kitti_pairs
from tracker.pairs import pair_set_names as tracklet_names

Progress = Callable[[str, int, int | None], None]


def is_cut_from_kitti(name: str) -> bool:
    """Tell a set that is cut from KITTI's scans from one that is generated.

    Raises:
        PairSetError: no such set of either kind.
    """
    if name not in (known := [*generated_names(), *tracklet_names()]):
        raise PairSetError(unknown_name("set of pairs", name, known))
    return name in tracklet_names()


def cut(name: str, root: Path, sequences: tuple[str, ...], rule: str, out: Path, progress: Progress) -> PairSet:
    """Cut a set from KITTI's tracklets."""
    opened = open_sequences(root, sequences)
    about = {"name": name, "rule": rule, "sequences": [s.name for s in opened], **_simulated(root, opened)}
    with TemporaryDirectory() as cache:
        return write_pair_set(out, kitti_pairs(name, opened, Path(cache), rule, progress), about)


def _simulated(root: Path, opened: Sequence[KittiSequence]) -> dict[str, dict[str, Any]]:
    """Say of each sequence that our simulator made, how: what is trained on such a set has seen no real scan of it."""
    folder = training_folder(root)
    found = {} if folder is None else {s.name: simulation_of(folder, s.name) for s in opened}
    records = {name: record for name, record in found.items() if record is not None}
    return {"simulation": records} if records else {}


def generate(order: Order, out: Path, n_jobs: int, progress: Progress) -> PairSet:
    """Generate a set, by as many processes as are asked for, or as there are cores (0)."""
    return make_pair_set(order, out, n_jobs or os.cpu_count() or 1, progress)


def order_of(name: str, meshes: Path | None, seed: int, counts: str) -> Order:
    """Ask for a set that is generated.

    Args:
        name: of the set.
        meshes: folder that its meshes come from; None for our own.
        seed: of all pairs.
        counts: numbers of pairs for training, validation and test, comma-separated.

    Raises:
        PairSetError: counts, seed or meshes that cannot be.
    """
    words = counts.split(",")
    if len(words) != 3 or not all(word.strip().isdecimal() for word in words):
        raise PairSetError(f"expected three counts of pairs (train,val,test), such as 8000,1000,1000; got {counts!r}")
    n_train, n_val, n_test = (int(word) for word in words)
    return Order(create_recipe(name, meshes), seed, (n_train, n_val, n_test))
