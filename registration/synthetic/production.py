"""Making sets of pairs: any pair alone from its seed; all of them by several processes, resumable after a kill."""

import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from threading import Thread
from typing import Any, Protocol, runtime_checkable

import numpy as np

from registration.errors import PairSetError, SimulationError
from registration.pair_set import (
    ABOUT,
    PARTS,
    CloudPair,
    PairSet,
    check_free,
    make_folders,
    write_about,
    write_lists,
    write_pair,
)

BATCH = 8  # pairs that a process makes between two reports
MAX_REDRAWS = 1000  # scenes without a usable pair in a row; then something is wrong with the recipe

Progress = Callable[[str, int, int | None], None]


@runtime_checkable
class Recipe(Protocol):
    """How the pairs of a set come about."""

    @property
    def name(self) -> str:
        """Name of the set."""

    @property
    def allow_empty(self) -> bool:
        """Whether a cloud of the set may be empty."""

    def describe(self) -> dict[str, Any]:
        """Tell all that decides what pairs come out, for `about.json`."""

    def check(self, parts: Sequence[str]) -> None:
        """Make sure, before anything is written, that all is there and whole that scenes of some parts need.

        Raises:
            RegistrationError: it is not.
        """

    def draw(self, part: str, rng: np.random.Generator) -> CloudPair | None:
        """Draw a scene of `train`, `val` or `test` and look at it twice; None for one that cannot be."""


@dataclass(frozen=True)
class Order:
    """A set that is asked for.

    Attributes:
        recipe: how its pairs come about.
        seed: of all of them.
        counts: number of pairs for training, validation and test.
    """

    recipe: Recipe
    seed: int = 0
    counts: tuple[int, int, int] = (8000, 1000, 1000)

    def __post_init__(self) -> None:
        if len(self.counts) != len(PARTS) or min(self.counts) < 0 or sum(self.counts) == 0:
            raise PairSetError(
                f"expected three counts of pairs (train, val, test), one at least > 0: got {self.counts}"
            )
        if self.seed < 0:
            raise PairSetError(f"expected a seed >= 0, got {self.seed}")

    @property
    def n_pairs(self) -> int:
        """Number of pairs in all parts."""
        return sum(self.counts)

    def ids(self) -> dict[str, list[int]]:
        """Number the pairs through: training, validation, test."""
        starts = np.cumsum([0, *self.counts]).tolist()
        return {part: list(range(starts[i], starts[i + 1])) for i, part in enumerate(PARTS)}

    def make(self, id_: int) -> CloudPair:
        """Make one pair; it depends on the recipe, the seed, its part and its place in that part only."""
        part, ids = next((part, ids) for part, ids in self.ids().items() if id_ in ids)
        return make_pair(self.recipe, self.seed, part, id_ - ids[0])

    def describe(self) -> dict[str, Any]:
        """Tell all that decides what comes out."""
        return {
            "name": self.recipe.name,
            "version": version("regmot"),
            "seed": self.seed,
            "counts": list(self.counts),
            **self.recipe.describe(),
        }


def make_pair(recipe: Recipe, seed: int, part: str, index: int) -> CloudPair:
    """Make one pair of a set, alone.

    A scene that cannot be, or one with a cloud that is empty and must not be, is drawn again from the same stream of
    random numbers; `extra` tells how often.

    Args:
        recipe: how the pairs of the set come about.
        seed: of the set.
        part: `train`, `val` or `test`.
        index: of the pair in its part.

    Raises:
        SimulationError: no usable scene comes out.
    """
    rng = np.random.default_rng([seed, PARTS.index(part), index])
    for n_redraws in range(MAX_REDRAWS):
        pair = recipe.draw(part, rng)
        if pair is not None and (recipe.allow_empty or min(len(pair.source), len(pair.target)) > 0):
            origin = {"seed": seed, "part": part, "index": index, "redraws": n_redraws}
            return replace(pair, extra={**pair.extra, **origin})
    raise SimulationError(f"{recipe.name}, {part} {index}: no pair with points in {MAX_REDRAWS} scenes")


def make_pair_set(order: Order, out: Path, n_jobs: int = 1, progress: Progress | None = None) -> PairSet:
    """Make all pairs of a set and write them in AlignNet-3D's format.

    Pairs are kept in a hidden folder beside the set's place until all are there; after a kill, or on another disk
    that is full, the same call goes on where the last one stopped.  What comes out depends neither on that nor on
    the number of processes.

    Args:
        order: what is asked for.
        out: the set's folder; must not hold anything.
        n_jobs: number of processes; with more than one, a script that calls this must guard its main part
            (`if __name__ == "__main__"`), as everywhere where Python starts processes afresh.
        progress: told of pairs that are done.

    Raises:
        PairSetError: the folder holds something, an unfinished set with other settings is in the way, or the disk
            cannot be written to.
        RegistrationError: the recipe fails, or lacks what it needs.
    """
    out = out.absolute()
    check_free(out)
    order.recipe.check([part for part, n in zip(PARTS, order.counts, strict=True) if n > 0])
    unfinished = unfinished_folder(out)
    _open_unfinished(unfinished, order)
    report = _Report(order, unfinished, progress)
    try:
        for done in _make_missing(order, unfinished, max(1, n_jobs)):
            report.add(done)
        _finish(order, unfinished, out)
    except (OSError, BrokenProcessPool) as error:
        reason = error.strerror or str(error) if isinstance(error, OSError) else "a process that makes pairs was killed"
        raise PairSetError(
            f"{out}: the set is not complete: {reason}.  {report.n_done} of {order.n_pairs} pairs are kept in "
            f"{unfinished}: the same command goes on from there"
        ) from error
    return PairSet(out)


def unfinished_folder(out: Path) -> Path:
    """Tell where the pairs of a set are kept while it is being made."""
    return out.with_name(f".{out.name}.unfinished")


class _Report:
    """Counts finished pairs and tells about them."""

    def __init__(self, order: Order, unfinished: Path, progress: Progress | None) -> None:
        self.what, self.n_pairs, self.progress = f"{order.recipe.name}: pairs", order.n_pairs, progress
        self.n_done = 0
        self.add(len(_finished(unfinished)))

    def add(self, n: int) -> None:
        self.n_done += n
        if self.progress is not None:
            self.progress(self.what, self.n_done, self.n_pairs)


def _open_unfinished(folder: Path, order: Order) -> None:
    """Make the folder that pairs are kept in, or check that the one that is there is of the same set."""
    wanted = json.loads(json.dumps(order.describe()))
    path = folder / ABOUT
    if not path.exists() and (not folder.exists() or not any(folder.iterdir())):
        folder.mkdir(parents=True, exist_ok=True)
        write_about(folder, wanted)
    try:
        found = dict(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError):
        raise PairSetError(f"{folder}: expected an unfinished set of pairs with its {ABOUT}; remove it") from None
    different = [key for key in wanted if wanted[key] != found.get(key)]
    if different:
        words = ", ".join(f"{key} is {found.get(key)}, not {wanted[key]}" for key in different)
        raise PairSetError(f"{folder}: holds an unfinished set with other settings ({words}); remove it, or finish it")
    make_folders(folder)


def _finished(folder: Path) -> set[int]:
    return {int(path.stem) for path in (folder / "meta").glob("*.json")}


def _make_missing(order: Order, folder: Path, n_jobs: int) -> Iterator[int]:
    """Make the pairs that are not there yet; give the number of new ones, batch by batch."""
    missing = sorted(set(range(order.n_pairs)) - _finished(folder))
    batches = [missing[i : i + BATCH] for i in range(0, len(missing), BATCH)]
    if min(n_jobs, len(batches)) <= 1:
        yield from (_make_batch(order, folder, batch) for batch in batches)
        return
    with ProcessPoolExecutor(min(n_jobs, len(batches)), get_context("spawn"), _start_process, (order, folder)) as pool:
        try:
            waiting = iter(batches)
            running = {pool.submit(_make_ordered, batch) for batch in islice(waiting, 4 * n_jobs)}
            while running:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                running |= {pool.submit(_make_ordered, batch) for batch in islice(waiting, len(done))}
                yield from (future.result() for future in done)
        finally:
            pool.shutdown(cancel_futures=True)


def _make_batch(order: Order, folder: Path, ids: list[int]) -> int:
    for id_ in ids:
        write_pair(folder, id_, order.make(id_))
    return len(ids)


_ORDERED: list[tuple[Order, Path]] = []  # in a process that makes pairs: what it makes, and where


def _start_process(order: Order, folder: Path) -> None:
    """Tell a process what to make, and leave Ctrl-C to its parent, which lets it end its batch."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    _ORDERED[:] = [(order, folder)]


def _end_with_parent() -> None:
    """End this process as soon as its parent is gone: one that was killed cannot tell it to."""
    parent = parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


def _make_ordered(ids: list[int]) -> int:
    order, folder = _ORDERED[0]
    return _make_batch(order, folder, ids)


def _finish(order: Order, unfinished: Path, out: Path) -> None:
    """Write the lists, count the redraws, and move the set to its place."""
    n_redraws = sum(json.loads(path.read_text())["redraws"] for path in (unfinished / "meta").glob("*.json"))
    write_lists(unfinished, order.ids(), {**order.describe(), "redraws": n_redraws})
    for leftover in (unfinished / "meta").glob("*.unfinished"):
        leftover.unlink()
    if out.exists():
        out.rmdir()
    os.replace(unfinished, out)
