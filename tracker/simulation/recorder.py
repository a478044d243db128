"""Simulated sequences made frame by frame, here or in several processes."""

import logging
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from tracker.errors import AbruptEndError, InputError
from tracker.simulation.recording import Run, Take, close_run, open_run, publish, write_frame

PIECE_LENGTH = 40  # frames that a process makes before it takes the next ones
POLL = 0.5  # how often progress is looked at [s]
MAX_CRASHES = 5  # of processes, in one run

Recipe = Callable[[], Take]  # opens a sequence; can be pickled where several processes are wanted
Progress = Callable[[str, int, int], None]  # called with a sequence's name, the frames done, and how many it has

_log = logging.getLogger(__name__)


def record(recipes: Mapping[str, Recipe], out: Path, progress: Progress | None = None, n_jobs: int = 1) -> Path:
    """Write sequences, in several processes where wanted.

    Args:
        recipes: how to open each sequence, by name; for several processes it must be possible to pickle them.
        out: root of the folder to write.
        progress: told of a sequence's name, the number of its frames done, and of all its frames.
        n_jobs: number of processes.

    Raises:
        DataError, InputError: see `open_run`; or what opening a sequence raises.
        AbruptEndError: processes crashed again and again.
    """
    if n_jobs < 1:
        raise InputError(f"expected at least 1 process, got {n_jobs}")
    run = open_run({name: recipe() for name, recipe in recipes.items()}, out)
    told = progress or (lambda name, done, total: None)
    if n_jobs == 1:
        _write_here(run, told)
    else:
        _write_in_processes(run, recipes, told, n_jobs)
    close_run(run)
    return out


def _write_here(run: Run, progress: Progress) -> None:
    for name in run.left:
        take = run.takes[name]
        for index in run.frames_left(name):
            write_frame(take, run.folder(name), index)
            progress(name, index + 1, take.n_frames)
        publish(run, name)


def _write_in_processes(run: Run, recipes: Mapping[str, Recipe], progress: Progress, n_jobs: int) -> None:
    """Write what is left; when a process crashes, new ones go on with what it has not finished."""
    left = run.left
    for _ in range(MAX_CRASHES):
        try:
            _share_out(run, {name: recipes[name] for name in left}, progress, n_jobs, left)
        except BrokenProcessPool:
            _log.warning("%s: a process ended abruptly; others go on with what it has left", run.out)
        else:
            return
    raise AbruptEndError(
        f"{run.out}: processes ended abruptly {MAX_CRASHES} times (out of memory?); "
        "finished frames are kept, run the same again to go on"
    )


def _share_out(run: Run, recipes: Mapping[str, Recipe], progress: Progress, n_jobs: int, left: list[str]) -> None:
    """Hand out pieces of sequences to new processes; each sequence is published when its last piece is done."""
    context = multiprocessing.get_context("spawn")  # a fork of a process that runs threads may hang
    with ProcessPoolExecutor(n_jobs, mp_context=context, initializer=_end_with_parent) as pool:
        open_pieces: dict[str, set[Future[None]]] = {}
        for name, recipe in recipes.items():
            frames = run.frames_left(name)
            pieces = [frames[i : i + PIECE_LENGTH] for i in range(0, len(frames), PIECE_LENGTH)]
            open_pieces[name] = {pool.submit(write_frames, recipe, run.folder(name), piece) for piece in pieces}
        try:
            while left:
                wait(open_pieces[left[0]], timeout=POLL, return_when=FIRST_COMPLETED)
                for name in list(left):
                    if _is_whole(run, name, open_pieces[name], progress):
                        publish(run, name)
                        left.remove(name)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _is_whole(run: Run, name: str, pieces: set["Future[None]"], progress: Progress) -> bool:
    """Tell whether all pieces of a sequence are done; raise what went wrong with one, tell of the progress."""
    for piece in [piece for piece in pieces if piece.done()]:
        piece.result()
        pieces.remove(piece)
    if n_done := run.n_done(name):
        progress(name, n_done, run.takes[name].n_frames)
    return not pieces


def write_frames(recipe: Recipe, folder: Path, indices: Sequence[int]) -> None:
    """Make some frames of a sequence."""
    take = recipe()
    for index in indices:
        write_frame(take, folder, index)


def _end_with_parent() -> None:
    """Watch the process that started this one: killed, it could not tell us to stop."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)  # the main thread may be anywhere, and all that it writes is whole or not there
