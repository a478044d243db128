"""Sets of cloud pairs as a few large arrays, and batches out of them."""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64

from registration.alignnet.errors import TrainingError
from registration.alignnet.loss import Truth
from registration.alignnet.ragged import Clouds
from registration.pair_set import PairSet

FORMAT = 1
ARRAYS = ("points", "begin", "center", "heading")
SPARE = 4  # of a large cloud, this many times the wanted points are read: augmentation drops some

Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class PackedPairs:
    """n pairs; cloud 2 i is the source of pair i, cloud 2 i + 1 its target.

    Attributes:
        points: of all clouds, in sensor axes [m]; may lie on disk.
        begin: cloud k is points[begin[k]:begin[k + 1]].
        center: of the object [m].
        heading: of the object, counter-clockwise about +z [rad].
    """

    points: Float32[np.ndarray, "m 3"]
    begin: Int64[np.ndarray, " ends"]
    center: Float64[np.ndarray, "clouds 3"]
    heading: Float64[np.ndarray, " clouds"]

    def __len__(self) -> int:
        return len(self.heading) // 2


@dataclass(frozen=True)
class Batch:
    """2 b clouds in sensor axes: the sources of b pairs, then their targets.

    Attributes:
        points: of all clouds [m].
        cloud: which cloud each point belongs to; ascending.
        n_seen: points that each cloud had, also those that were not drawn.
        center, heading: of each cloud's object [m, rad].
    """

    points: Float32[np.ndarray, "n 3"]
    cloud: Int64[np.ndarray, " n"]
    n_seen: Float64[np.ndarray, " b"]
    center: Float64[np.ndarray, "b 3"]
    heading: Float64[np.ndarray, " b"]

    @property
    def n_clouds(self) -> int:
        """Number of clouds: twice that of pairs."""
        return len(self.heading)


def pack(pairs: PairSet, part: str, folder: Path, progress: Progress | None = None) -> PackedPairs:
    """Read a part of a set of pairs, or what an earlier call has made of it.

    Args:
        pairs: the set on disk.
        part: train, val or test.
        folder: of the arrays; made whole or not at all, and made again when the set is another one.
        progress: told what is done, how many pairs, of how many.

    Raises:
        PairSetError: the set cannot be read.
        TrainingError: the part is empty.
    """
    about = json.dumps(_identity(pairs, part), indent=1)
    if not (folder / "about.json").is_file() or (folder / "about.json").read_text() != about:
        unfinished = folder.with_name(f"{folder.name}.unfinished")
        for old in (unfinished, folder):
            shutil.rmtree(old, ignore_errors=True)
        unfinished.mkdir(parents=True)
        _write(pairs, part, unfinished, progress or (lambda *_: None))
        (unfinished / "about.json").write_text(about)
        os.replace(unfinished, folder)
    return PackedPairs(*(np.load(folder / f"{name}.npy", mmap_mode="r") for name in ARRAYS))


def join(sets: Sequence[PackedPairs]) -> PackedPairs:
    """Put several sets one behind the other."""
    if len(sets) == 1:
        return sets[0]
    sizes = np.concatenate([np.diff(pairs.begin) for pairs in sets])
    return PackedPairs(
        points=np.concatenate([pairs.points for pairs in sets]),
        begin=np.concatenate([[0], np.cumsum(sizes)]),
        center=np.concatenate([pairs.center for pairs in sets]),
        heading=np.concatenate([pairs.heading for pairs in sets]),
    )


def repeated(pairs: PackedPairs, near: float, times: int) -> Int64[np.ndarray, " n"]:
    """List all pairs in order, those of objects nearer than `near` [m] in the source so many times."""
    distance = np.hypot(pairs.center[::2, 0], pairs.center[::2, 1])
    return np.repeat(np.arange(len(pairs)), np.where(distance < near, times, 1))


def draw(pairs: PackedPairs, index: Int64[np.ndarray, " b"], max_points: int, rng: np.random.Generator) -> Batch:
    """Read some pairs; of large clouds, a random part of SPARE * max_points points."""
    of_cloud = np.concatenate([2 * index, 2 * index + 1])
    clouds, n_seen = [], np.empty(len(of_cloud))
    for k, which in enumerate(of_cloud):
        begin, end = int(pairs.begin[which]), int(pairs.begin[which + 1])
        n_seen[k] = end - begin
        if end - begin > SPARE * max_points:
            clouds.append(pairs.points[begin + np.sort(rng.permutation(end - begin)[: SPARE * max_points])])
        else:
            clouds.append(pairs.points[begin:end])
    sizes = [len(cloud) for cloud in clouds]
    return Batch(
        points=np.concatenate(clouds),
        cloud=np.repeat(np.arange(len(clouds)), sizes),
        n_seen=n_seen,
        center=np.asarray(pairs.center[of_cloud]),
        heading=np.asarray(pairs.heading[of_cloud]),
    )


def limited(batch: Batch, max_points: int, rng: np.random.Generator) -> Batch:
    """Leave at most so many points in each cloud, drawn without replacement."""
    sizes = np.bincount(batch.cloud, minlength=batch.n_clouds)
    if sizes.max(initial=0) <= max_points:
        return batch
    order = np.argsort(batch.cloud + rng.random(len(batch.cloud)))
    rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    kept = np.sort(order[rank < max_points])
    return Batch(batch.points[kept], batch.cloud[kept], batch.n_seen, batch.center, batch.heading)


def to_tensors(batch: Batch) -> tuple[tuple[Clouds, Clouds], tuple[Truth, Truth]]:
    """Split a batch into sources and targets, each cloud relative to its own mean point."""
    n, half = batch.n_clouds, batch.n_clouds // 2
    sizes = np.maximum(np.bincount(batch.cloud, minlength=n), 1)
    origin = np.stack([np.bincount(batch.cloud, batch.points[:, k], n) / sizes for k in range(3)], axis=1)
    points = batch.points - origin[batch.cloud]
    middle = int(np.searchsorted(batch.cloud, half))
    clouds, truths = [], []
    for rows, part in ((slice(None, middle), slice(None, half)), (slice(middle, None), slice(half, None))):
        clouds.append(
            Clouds(
                points=torch.from_numpy(points[rows].astype(np.float32)),
                cloud=torch.from_numpy(batch.cloud[rows] - (part.start or 0)),
                n_seen=torch.from_numpy(batch.n_seen[part].astype(np.float32)),
                sensor=torch.from_numpy(-origin[part, :2].astype(np.float32)),
            )
        )
        center = torch.from_numpy((batch.center - origin)[part].astype(np.float32))
        truths.append(Truth(center, torch.from_numpy(batch.heading[part].astype(np.float32))))
    return (clouds[0], clouds[1]), (truths[0], truths[1])


def in_order(pairs: PackedPairs, batch_size: int, max_points: int, seed: int = 0) -> Iterator[Batch]:
    """Go through all pairs once, always with the same points."""
    for step, begin in enumerate(range(0, len(pairs), batch_size)):
        rng = np.random.default_rng([seed, step])
        index = np.arange(begin, min(begin + batch_size, len(pairs)))
        yield limited(draw(pairs, index, max_points, rng), max_points, rng)


def _identity(pairs: PairSet, part: str) -> dict[str, object]:
    """Say which set, and which state of it, arrays are made of."""
    stamp = (pairs.folder / "split" / "train.txt").stat()
    return {
        "format": FORMAT,
        "folder": str(pairs.folder.absolute()),
        "part": part,
        "mirrored_angles": pairs.mirrored_angles,
        "written": stamp.st_mtime_ns,
    }


def _write(pairs: PairSet, part: str, folder: Path, progress: Progress) -> None:
    ids = pairs.ids(part)
    if not ids:
        raise TrainingError(f"{pairs.folder}: the part {part!r} holds no pair")
    clouds, center, heading = [], np.empty((2 * len(ids), 3)), np.empty(2 * len(ids))
    for k, id_ in enumerate(ids):
        pair = pairs.read(id_)
        clouds += [pair.source.astype(np.float32), pair.target.astype(np.float32)]
        center[2 * k], center[2 * k + 1] = pair.start_position, pair.end_position
        heading[2 * k], heading[2 * k + 1] = pair.start_angle, pair.end_angle
        progress(f"reading {part}", k + 1, len(ids))
    begin = np.concatenate([[0], np.cumsum([len(cloud) for cloud in clouds])])
    arrays: tuple[np.ndarray, ...] = (np.concatenate(clouds), begin, center, heading)
    for name, array in zip(ARRAYS, arrays, strict=True):
        np.save(folder / f"{name}.npy", array)
