"""Simulated sequences on disk: written frame by frame, resumed after a kill, visible only when they are whole."""

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float64
from numpy import ndarray

from registration.types import Points
from tracker.errors import DataError, InputError
from tracker.files import UNFINISHED, write_whole
from tracker.kitti import writer
from tracker.kitti.tracking import RECORD

FORMAT = 1
RUN = f"{UNFINISHED}-run.json"  # there while a run is under way: its settings

# The parts of a sequence in a tracking folder; the labels come last, because they make it a sequence.
PIECES = ("velodyne", "calib", "oxts", "poses", "times", "truth", "label_02")
_ROWS = "rows"  # holds the rows of each finished frame, while its sequence is not whole


@dataclass(frozen=True, slots=True)
class TakenFrame:
    """What a frame adds to a sequence.

    Attributes:
        points_lidar: its scan (n, 3) [m].
        intensity: of each point, in [0, 1].
        rows: what it adds to each text file, by the name of its piece: `label_02`, `truth`, `times`, `oxts`.
    """

    points_lidar: Points
    intensity: Float64[ndarray, " n"]
    rows: dict[str, str]


@runtime_checkable
class Take(Protocol):
    """A sequence that can be made frame by frame, in any order, and comes out the same every time."""

    @property
    def n_frames(self) -> int:
        """Number of its frames."""

    @property
    def settings(self) -> dict[str, Any]:
        """All that decides what it looks like, as JSON has it: a run resumes only what was made with the same."""

    @property
    def heads(self) -> dict[str, str]:
        """How each of its text files starts, by the name of its piece; there may be nothing to start with."""

    def frame(self, index: int) -> TakenFrame:
        """Make one frame."""


@dataclass(frozen=True)
class Run:
    """Sequences being written to a folder.

    Attributes:
        out: root of the folder.
        takes: what is being written, by the sequence's name.
        whole: names of the sequences that an interrupted run had finished.
    """

    out: Path
    takes: Mapping[str, Take]
    whole: frozenset[str]

    @property
    def left(self) -> list[str]:
        """Names of the sequences that are not whole yet."""
        return [name for name in self.takes if name not in self.whole]

    def folder(self, name: str) -> Path:
        """Where a sequence lies until it is whole."""
        return self.out / f"{UNFINISHED}-{name}"

    def frames_left(self, name: str) -> list[int]:
        """List the frames of a sequence that are still to be made."""
        folder = self.folder(name)
        return [k for k in range(self.takes[name].n_frames) if not all(path.is_file() for path in _paths(folder, k))]

    def n_done(self, name: str) -> int:
        """Count the frames of a sequence that are finished."""
        return sum(1 for _ in (self.folder(name) / _ROWS).glob("*.json"))


def open_run(takes: Mapping[str, Take], out: Path) -> Run:
    """Start to write sequences, or go on where a run with the same settings was interrupted.

    What a run with other settings left unfinished is removed; whole sequences stay until they are replaced.

    Raises:
        DataError: `out` holds something that no simulation has written.
        InputError: a sequence's name is no plain word.
    """
    for name in takes:
        if not name.replace("-", "").replace("_", "").isalnum():
            raise InputError(f"a sequence's name is made of letters and digits, got {name!r}")
    entries = _open_record(out)
    settings = {name: _as_json(take.settings) for name, take in takes.items()}
    wanted = {"version": metadata.version("regmot"), "sequences": settings}
    if _resumes(out / RUN, wanted):
        return Run(out, takes, frozenset(name for name in takes if entries.get(name) == settings[name]))
    for path in out.glob(f"{UNFINISHED}-*"):
        _remove(path)
    write_whole(out / RUN, json.dumps(wanted))
    return Run(out, takes, frozenset())


def close_run(run: Run) -> None:
    """Forget a run whose sequences are all whole."""
    (run.out / RUN).unlink(missing_ok=True)


def write_frame(take: Take, folder: Path, index: int) -> None:
    """Make a frame and put it into the folder of its unfinished sequence; its rows go last and say that it is done."""
    taken = take.frame(index)
    scan_path, rows_path = _paths(folder, index)
    writer.write_scan(scan_path, taken.points_lidar, taken.intensity)
    write_whole(rows_path, json.dumps(taken.rows))


def publish(run: Run, name: str) -> None:
    """Put a sequence whose frames are all made together, and move it to where readers look."""
    take, folder, training = run.takes[name], run.folder(name), run.out / "training"
    for piece, text in _texts(take, folder):
        write_whole(folder / _file(piece, name), text)
    entries = _open_record(run.out)
    entries.pop(name, None)
    _write_record(run.out, entries)
    for piece in reversed(PIECES):  # of an earlier simulation; without labels it is no sequence any more
        _remove(training / _file(piece, name))
    for piece in PIECES:
        source, target = folder / _file(piece, name), training / _file(piece, name)
        if piece == "velodyne":
            source = folder / piece
        if source.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            source.replace(target)
    _write_record(run.out, {**entries, name: _as_json(take.settings)})
    shutil.rmtree(folder)


def _paths(folder: Path, index: int) -> tuple[Path, Path]:
    """Name the files of a finished frame."""
    return folder / "velodyne" / f"{index:06d}.bin", folder / _ROWS / f"{index:06d}.json"


def _file(piece: str, name: str) -> str:
    """Name a piece of a sequence within a tracking folder."""
    return f"{piece}/{name}" + {"velodyne": "", "truth": ".csv"}.get(piece, ".txt")


def _texts(take: Take, folder: Path) -> Iterator[tuple[str, str]]:
    """Join the rows of all frames to text files."""
    rows = [json.loads(_paths(folder, k)[1].read_text()) for k in range(take.n_frames)]
    for piece, head in take.heads.items():
        yield piece, head + "".join(row.get(piece, "") for row in rows)


def _as_json(settings: dict[str, Any]) -> Any:
    """Give settings as they come back from a file: tuples are lists there."""
    return json.loads(json.dumps(settings, sort_keys=True))


def _resumes(path: Path, wanted: dict[str, Any]) -> bool:
    """Tell whether a run with these settings was interrupted; one whose settings are damaged was another."""
    try:
        return bool(json.loads(path.read_text()) == wanted)
    except (FileNotFoundError, ValueError):
        return False


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _open_record(out: Path) -> dict[str, Any]:
    """Read what simulations have left in a folder, by sequence, or start a record in an empty one."""
    path = out / RECORD
    if path.is_file():
        try:
            record = json.loads(path.read_text())
        except ValueError as error:
            raise DataError(path, f"expected a simulation's record (JSON), got {error}") from None
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise DataError(path, f"expected a simulation's record of format {FORMAT}")
        return dict(record.get("sequences", {}))
    leftover = RECORD + UNFINISHED  # of a run that was killed
    if out.exists() and (not out.is_dir() or any(path.name != leftover for path in out.iterdir())):
        raise DataError(out, "holds something that no simulation has written; choose an empty folder")
    _write_record(out, {})
    return {}


def _write_record(out: Path, sequences: dict[str, Any]) -> None:
    record = {"format": FORMAT, "version": metadata.version("regmot"), "sequences": sequences}
    write_whole(out / RECORD, json.dumps(record, indent=1, sort_keys=True) + "\n")
