"""Sets of cloud pairs with known motion, on disk in AlignNet-3D's format: read and write.

`meta/%08d.json`, `pointcloud1|pointcloud2|transform/%08d.npy`, `split/train.txt|val.txt` (one id a line).  The authors'
val.txt lists validation items and then test items; our sets say which is which in `split/test.txt`.
"""

import json
import os
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from registration import planar
from registration.errors import PairSetError
from registration.types import Point, Points, Transform

PARTS = ("train", "val", "test")
ABOUT = "about.json"  # what a set is made of
RELEASED_VAL = 1000  # items of a released val.txt that come before its test items (synthetic sets)
RELEASED_TEST_IDS = frozenset({2, 6, 7, 8, 10})  # re-indexed track ids that test (KITTI sets)


@dataclass(frozen=True)
class CloudPair:
    """One object seen twice, and its true motion.

    Attributes:
        source, target: earlier and later cloud [m]; sensor axes, x forward, z up.
        start_position, end_position: the object's centre in each [m].
        start_angle, end_angle: its heading in each, counter-clockwise about +z [rad].
        extra: what else the set knows: class, sequence, frames, ...
    """

    source: Points
    target: Points
    start_position: Point
    end_position: Point
    start_angle: float
    end_angle: float
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def T_target_source(self) -> Transform:  # noqa: N802 - names carry frames
        """True planar motion: the turn about the start position, then the shift to the end position."""
        x, y, _ = self.end_position - self.start_position
        motion = np.array([x, y, planar.wrap(self.end_angle - self.start_angle)])
        return planar.to_transform(motion, self.start_position)


@dataclass(frozen=True)
class PairSet:
    """A folder of pairs, read one at a time.

    Attributes:
        folder: root of the set.
        mirrored_angles: the released KITTI sets store the camera's rotation_y, which turns the other way about +z
            than everything else does; True flips their sign back.
    """

    folder: Path
    mirrored_angles: bool = False

    def __post_init__(self) -> None:
        """Refuse a folder that holds no set."""
        for name in ("meta", "pointcloud1", "pointcloud2", "split"):
            if not (self.folder / name).is_dir():
                raise PairSetError(f"{self.folder}: expected a set of pairs (meta, pointcloud1, ...), found no {name}")

    def ids(self, part: str) -> list[int]:
        """List the ids of `train`, `val` or `test`.

        Raises:
            PairSetError: no such part, or a damaged list.
        """
        if part not in PARTS:
            raise PairSetError(f"unknown part {part!r} of a set of pairs; expected one of {', '.join(PARTS)}")
        if part == "train":
            return self._list("train")
        held_out = self._list("val")
        if (self.folder / "split" / "test.txt").is_file():
            listed = set(self._list("test"))
            is_test = [id_ in listed for id_ in held_out]
        else:
            is_test = [self._is_released_test(position, id_) for position, id_ in enumerate(held_out)]
        return [id_ for id_, tests in zip(held_out, is_test, strict=True) if tests == (part == "test")]

    def pairs(self, part: str) -> Iterator[CloudPair]:
        """Read the pairs of a part, one after the other."""
        for id_ in self.ids(part):
            yield self.read(id_)

    def read(self, id_: int) -> CloudPair:
        """Read one pair.

        Raises:
            PairSetError: a file is missing or malformed; the message names it.
        """
        meta = self._meta(id_)
        sign = -1.0 if self.mirrored_angles else 1.0
        path = self.folder / "meta" / f"{id_:08d}.json"
        try:
            start, end = (np.array([float(w) for w in meta.pop(f"{k}_position").split()]) for k in ("start", "end"))
            start_angle, end_angle = (sign * float(meta.pop(f"{k}_angle")) for k in ("start", "end"))
        except (KeyError, ValueError, AttributeError) as error:
            raise PairSetError(f"{path}: expected positions and angles of a pair, got {error!r}") from None
        if not (start.shape == end.shape == (3,) and np.isfinite([*start, *end, start_angle, end_angle]).all()):
            raise PairSetError(f"{path}: expected positions of three finite numbers, and finite angles")
        source, target = self._cloud("pointcloud1", id_), self._cloud("pointcloud2", id_)
        return CloudPair(source, target, start, end, start_angle, end_angle, extra=meta)

    def _is_released_test(self, position: int, id_: int) -> bool:
        """Tell validation from test items in the authors' sets: KITTI by track id, synthetic ones by position."""
        track_ids = self._meta(id_).get("trackids")
        return position >= RELEASED_VAL if track_ids is None else track_ids[0] in RELEASED_TEST_IDS

    def _list(self, name: str) -> list[int]:
        path = self.folder / "split" / f"{name}.txt"
        if not path.is_file():
            raise PairSetError(f"{path}: no such file")
        try:
            return [int(line) for line in path.read_text().split()]
        except ValueError as error:
            raise PairSetError(f"{path}: expected an integer id a line ({error})") from None

    def _meta(self, id_: int) -> dict[str, Any]:
        path = self.folder / "meta" / f"{id_:08d}.json"
        try:
            return dict(json.loads(path.read_text()))
        except (OSError, ValueError, TypeError) as error:
            raise PairSetError(f"{path}: expected a pair's JSON record ({error})") from None

    def _cloud(self, name: str, id_: int) -> Points:
        path = self.folder / name / f"{id_:08d}.npy"
        try:
            points = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise PairSetError(f"{path}: expected a cloud ({error})") from None
        if points.ndim != 2 or points.shape[1] < 3 or not np.isfinite(points[:, :3]).all():
            raise PairSetError(f"{path}: expected a finite (N, 3+) array, got shape {points.shape}")
        return points[:, :3].astype(np.float64)


def write_pair_set(folder: Path, pairs: Iterable[tuple[str, CloudPair]], about: dict[str, Any]) -> PairSet:
    """Write pairs in AlignNet-3D's format, with a `transform` that is the true motion.

    Args:
        folder: must not exist or be empty; it appears when it is whole.
        pairs: (part, pair), part one of PARTS; read once, one at a time.
        about: what the set is made of; written as `about.json`.

    Raises:
        PairSetError: the folder holds something already, or there is no pair.
    """
    folder = folder.absolute()
    unfinished = folder.with_name(f"{folder.name}.unfinished")
    for path in (folder, unfinished):
        check_free(path)
    try:
        _write_all(unfinished, pairs, about)
        if folder.exists():
            folder.rmdir()
        os.replace(unfinished, folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return PairSet(folder)


def write_pair(folder: Path, id_: int, pair: CloudPair) -> None:
    """Write one pair into a set's folder; its record comes last and at once: where it is, the pair is whole."""
    for name, cloud in (("pointcloud1", pair.source), ("pointcloud2", pair.target)):
        np.save(folder / name / f"{id_:08d}.npy", cloud.astype(np.float32))
    np.save(folder / "transform" / f"{id_:08d}.npy", pair.T_target_source)
    _write_json(folder / "meta" / f"{id_:08d}.json", _record(pair))


def make_folders(folder: Path) -> None:
    """Make the folders that `write_pair` and `write_lists` write to, where they are not there yet."""
    for name in ("meta", "pointcloud1", "pointcloud2", "transform", "split"):
        (folder / name).mkdir(parents=True, exist_ok=True)


def write_lists(folder: Path, ids: dict[str, list[int]], about: dict[str, Any]) -> None:
    """Say which pairs belong to which part, and what the set is made of (`about.json`)."""
    lists = {"train": ids["train"], "val": ids["val"] + ids["test"], "test": ids["test"]}
    for name, members in lists.items():
        (folder / "split" / f"{name}.txt").write_text("".join(f"{id_}\n" for id_ in members))
    counts = {part: len(members) for part, members in ids.items()}
    write_about(folder, {**about, "angles": "heading", "n": counts})


def write_about(folder: Path, about: dict[str, Any]) -> None:
    """Say what a set is made of."""
    _write_json(folder / ABOUT, about, indent=1)


def check_free(folder: Path) -> None:
    """Refuse to write where something is already.

    Raises:
        PairSetError: the path is no folder, or one that holds something.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise PairSetError(f"{folder}: holds something already; choose an empty folder, or remove it")


def _write_all(folder: Path, pairs: Iterable[tuple[str, CloudPair]], about: dict[str, Any]) -> None:
    make_folders(folder)
    ids: dict[str, list[int]] = {part: [] for part in PARTS}
    for id_, (part, pair) in enumerate(pairs):
        ids[part].append(id_)
        write_pair(folder, id_, pair)
    if not any(ids.values()):
        raise PairSetError("there is no pair to write")
    write_lists(folder, ids, about)


def _write_json(path: Path, content: dict[str, Any], indent: int | None = None) -> None:
    """Write a JSON file whole or not at all."""
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps(content, indent=indent))
    os.replace(unfinished, path)


def _record(pair: CloudPair) -> dict[str, Any]:
    translation = (pair.end_position - pair.start_position) * [1.0, 1.0, 0.0]
    return {
        "start_position": _column(pair.start_position),
        "end_position": _column(pair.end_position),
        "translation": _column(translation),
        "start_angle": pair.start_angle,
        "end_angle": pair.end_angle,
        "rel_angle": pair.end_angle - pair.start_angle,
        **pair.extra,
    }


def _column(point: Point) -> str:
    """Write three numbers the way the authors do: one a line."""
    return "".join(f"{value:.18e}\n" for value in point)
