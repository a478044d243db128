"""Nearest neighbours within a radius: for one cloud, and for many small clouds in one call.

A cloud is sorted once into cubic cells; a query then looks only at the cells that its radius touches.  Unlike a
tree this takes microseconds to build for the few hundred points of a segment, and the loops are compiled.  Answers
are exact whatever the side of the cells, which only decides on the time: about the radius of the searches is good.
Clouds that are small beside the space they span have larger cells, so that memory stays in proportion to points.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, Int64

from registration import icp_kernels
from registration.types import Points

CELLS_PER_POINT = 4  # at most, and ...
CELLS_ANYWAY = 64  # ... this many more


@dataclass(frozen=True, slots=True)
class Grid:
    """A cloud sorted into cubic cells.

    Attributes:
        points: cell by cell [m].
        order: which row of the cloud each of them is.
        first: where each cell's points begin; the cell at (i, j, k) has number (i * n_y + j) * n_z + k.
        frame: origin x, y, z [m], side of a cell [m], number of cells along x, y, z.
    """

    points: Points
    order: Int64[np.ndarray, " _"]
    first: Int32[np.ndarray, " _"]
    frame: Float64[np.ndarray, "7"]


class Packed(NamedTuple):
    """Many grids one after the other, as the compiled loops take them; grid k begins at `..._begin[k]`."""

    points: Points
    points_begin: Int64[np.ndarray, " _"]
    first: Int32[np.ndarray, " _"]
    first_begin: Int64[np.ndarray, " _"]
    frames: Float64[np.ndarray, "_ 7"]


def build_grid(points: Points, cell: float) -> Grid:
    """Sort a cloud, which may be empty, into cells of side `cell` [m] or, where that makes too many, larger ones."""
    packed, order = build_grids(np.ascontiguousarray(points), np.array([0, len(points)]), np.array([float(cell)]))
    return Grid(packed.points, order, packed.first, packed.frames[0])


def build_grids(
    points: Points, begin: Int64[np.ndarray, " _"], cells: Float64[np.ndarray, " _"]
) -> tuple[Packed, Int64[np.ndarray, " n"]]:
    """Do `build_grid` for clouds that lie one after the other already (see `pack_arrays`), each with cells of its own.

    Returns:
        the grids, and which row of its cloud each of their points is.
    """
    most = CELLS_PER_POINT * np.diff(begin) + CELLS_ANYWAY
    in_order, order, first, first_begin, frames = icp_kernels.sort_into_cells(points, begin, cells, most)
    return Packed(in_order, begin, first, first_begin, frames), order


def nearest(grid: Grid, queries: Points, radius: float) -> tuple[Int64[np.ndarray, " q"], Float64[np.ndarray, " q"]]:
    """Find each query's nearest point closer than `radius` [m].

    Returns:
        its row in the cloud, -1 where there is none, and its distance [m], infinite where there is none.
    """
    return nearest_many([grid], [queries], radius)[0]


def nearest_many(
    grids: Sequence[Grid], queries: Sequence[Points], radius: float, threads: int = 1
) -> list[tuple[Int64[np.ndarray, " _"], Float64[np.ndarray, " _"]]]:
    """Do `nearest` for many clouds in one call, the k-th queries in the k-th grid."""
    found = _search(grids, queries, 1, radius, threads)
    return [(rows[:, 0], distances[:, 0]) for rows, distances in found]


def k_nearest(
    grid: Grid, queries: Points, k: int, radius: float
) -> tuple[Int64[np.ndarray, "q k"], Float64[np.ndarray, "q k"]]:
    """Find each query's k nearest points closer than `radius` [m], nearest first; else as `nearest`."""
    return _search([grid], [queries], k, radius, 1)[0]


def pack(grids: Sequence[Grid]) -> Packed:
    """Lay grids, at least one, one after the other."""
    points, points_begin = pack_arrays([grid.points for grid in grids])
    first, first_begin = pack_arrays([grid.first for grid in grids])
    return Packed(points, points_begin, first, first_begin, np.array([grid.frame for grid in grids]))


def pack_arrays(arrays: Sequence[np.ndarray]) -> tuple[np.ndarray, Int64[np.ndarray, " _"]]:
    """Lay arrays one after the other; say where each begins, and where the last ends."""
    begin = np.array([0, *accumulate(len(array) for array in arrays)])
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays), begin


def share_out(work: Callable[[int, int], None], n: int, threads: int) -> None:
    """Do jobs 0 to n by `work(begin, end)`, on one thread or on several; the kernels let go of Python's lock."""
    if threads <= 1 or n <= 1:
        work(0, n)
        return
    with ThreadPoolExecutor(min(threads, n)) as pool:
        list(pool.map(lambda k: work(k, k + 1), range(n)))  # list: raises what a thread raised


def _search(
    grids: Sequence[Grid], queries: Sequence[Points], k: int, radius: float, threads: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    if not grids:
        return []
    asked, begin = pack_arrays(queries)
    rows = np.full((len(asked), k), -1, dtype=np.int64)
    distances2 = np.empty((len(asked), k))
    packed = pack(grids)
    share_out(
        lambda a, b: icp_kernels.nearest_points(a, b, asked, begin, *packed, float(radius), rows, distances2),
        len(grids),
        threads,
    )
    distances = np.where(rows >= 0, np.sqrt(distances2), np.inf)
    found = []
    for grid, a, b in zip(grids, begin[:-1], begin[1:], strict=True):
        order = np.append(grid.order, -1)  # row -1 stays -1
        found.append((order[rows[a:b]], distances[a:b]))
    return found
