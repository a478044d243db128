"""Annealed search of a shift: a histogram over shifts, refined where it is likely, against a grid of densities.

Compiled by numba; the search behind `registration.methods.adh`.  All pairs of a batch are one call, and all their
grids, at all resolutions, use one piece of memory in turn.  One file, longer than we like: numba's cache of a
compiled function notices changes of that function's own file only, and would keep what it had called from others.

Source: Held, Levinson, Thrun & Savarese, "Combining 3D shape, color, and motion for robust anytime tracking",
RSS 2014: sections IV (measurement model), V (motion model) and VI (annealed dynamic histograms).
"""

import typing
from typing import NamedTuple

import numpy as np
from numba import njit

GRID_SIDE, GRID_HEIGHT = 1000, 250  # the most cells along x and y, and along z

# One row a pair: where to search, how densely the sensor sees it, and what is known beforehand.
PAIR = np.dtype(
    [
        ("center_x", "f8"),  # middle of the searched square of shifts [m]
        ("center_y", "f8"),
        ("reach", "f8"),  # half its side [m]
        ("across", "f8"),  # distance of neighbouring points of the fixed cloud, horizontally [m]
        ("up", "f8"),  # the same, vertically [m]
        ("sign", "f8"),  # +1 where the moved cloud is the source, -1 where it is the target
        ("has_prior", "?"),
        ("prior_x", "f8"),  # expected shift of the source [m]
        ("prior_y", "f8"),
        ("precision_xx", "f8"),  # inverse of its covariance [1/m^2]
        ("precision_xy", "f8"),
        ("precision_yy", "f8"),
        ("log_peak", "f8"),  # log of the prior's density at its mean [1/m^3]
    ]
)

# One row a pair: the moments of the histogram, which is over shifts of the moved cloud.
POSTERIOR = np.dtype(
    [
        ("x", "f8"),  # mean [m]
        ("y", "f8"),
        ("xx", "f8"),  # covariance of the cells' centres [m^2]
        ("xy", "f8"),
        ("yy", "f8"),
        ("within", "f8"),  # mean variance inside a cell, of each of x and y [m^2]
        ("n_levels", "i8"),  # number of resolutions gone through
    ]
)


class Constants(NamedTuple):
    """What is the same for all pairs: settings of `registration.methods.adh.AnnealedHistograms2D`, by their names.

    Attributes:
        step_up: height of a grid's cell over its width; 0 where height does not count.
    """

    coarsest: float
    finest: float
    ray_share: float
    reduction: int
    split_above: float
    sensor_share: float
    noise: float
    floor: float
    discount: float
    independent: int
    prior_floor: float
    step_up: float


class _Sensing(NamedTuple):
    """How well a point of the cloud tells where another one will be measured.

    Attributes:
        spread: standard deviation from the distance of neighbouring points and from noise, horizontally [m].
        spread_up: the same, vertically [m].
        floor: likelihood of a point with nothing near it, where 1 more is that of one right on a point.
    """

    spread: float
    spread_up: float
    floor: float


class _Grid(NamedTuple):
    """Cells around a cloud, layer by layer, in each layer row by row along x.

    Attributes:
        cells: their values, flat; may be longer than the grid.
        n_x, n_y, n_z: number of cells; n_z is 1 where height does not count.
        x, y, z: centre of the first cell [m].
        step: distance of cells along x and y [m].
        step_up: along z [m].
    """

    cells: np.ndarray
    n_x: int
    n_y: int
    n_z: int
    x: float
    y: float
    z: float
    step: float
    step_up: float


@njit(cache=True, nogil=True)
@typing.no_type_check
def measure(points):
    """Give a non-empty cloud's mean (3), horizontal covariance (2, 2), and bounding box (3), (3)."""
    n = len(points)
    mean, scatter = np.zeros(3), np.zeros((2, 2))
    for i in range(n):
        for axis in range(3):
            mean[axis] += points[i, axis]
    mean /= n
    for i in range(n):
        x, y = points[i, 0] - mean[0], points[i, 1] - mean[1]
        scatter[0, 0] += x * x
        scatter[0, 1] += x * y
        scatter[1, 1] += y * y
    scatter[1, 0] = scatter[0, 1]
    low, high = _bounds(points)
    return mean, scatter / n, low, high


@njit(cache=True, nogil=True)
@typing.no_type_check
def search(begin, end, moved, moved_start, fixed, fixed_start, pairs, constants, found):
    """Find the distribution of the shift that brings each moved cloud onto its fixed cloud.

    Args:
        begin, end: which of the pairs.
        moved: the points of all moved clouds, end to end (n, 3) [m]; none is empty.
        moved_start: where each pair's points start, and the end (k + 1).
        fixed: the points of all fixed clouds (m, 3) [m].
        fixed_start: the same for them (k + 1).
        pairs: rows of PAIR (k).
        constants: `Constants`.
        found: rows of POSTERIOR (k), filled in.
    """
    cells = np.empty(0, dtype=np.float32)
    for i in range(begin, end):
        cloud = fixed[fixed_start[i] : fixed_start[i + 1]]
        low, high = _bounds(cloud)
        last = constants.coarsest
        while not _is_last(last, pairs[i], constants):
            last /= constants.reduction
        largest = _lay(low, high, last, last * constants.step_up, cells)
        n_cells = largest.n_x * largest.n_y * largest.n_z
        if n_cells > len(cells):
            cells = np.empty(n_cells, dtype=np.float32)
        _anneal(moved[moved_start[i] : moved_start[i + 1]], cloud, pairs[i], constants, cells, found[i])


@njit(cache=True, nogil=True)
@typing.no_type_check
def _anneal(moved, fixed, pair, constants, cells, found):
    """Weigh all shifts of a coarse grid, divide the likely ones into finer cells, and so on."""
    low, high = _bounds(fixed)
    spread = np.hypot(constants.sensor_share * pair.across, constants.noise)
    spread_up = np.hypot(constants.sensor_share * pair.up, constants.noise)
    sensing = _Sensing(spread, spread_up, constants.floor)
    weight = constants.discount * min(1.0, constants.independent / len(moved))
    resolution, region = constants.coarsest, 1.0  # region: probability of all that was divided
    x, y, side = _first_candidates(pair, resolution)
    moments = np.zeros(7)
    while True:
        grid = _lay(low, high, resolution, resolution * constants.step_up, cells)
        _fill(grid, fixed, sensing)
        score = weight * _look_up(grid, moved, x, y, side)
        _add_log_prior(score, x, y, pair, constants)
        probability = region * _softmax(score)
        found.n_levels += 1
        is_last = _is_last(resolution, pair, constants)
        divided = np.empty(0, dtype=np.int64) if is_last else np.flatnonzero(probability > constants.split_above)
        region = probability[divided].sum()
        probability[divided] = 0.0
        _accumulate(moments, x, y, probability, resolution)
        if len(divided) == 0:
            break
        x, y = _children(x[divided], y[divided], resolution, constants.reduction)
        resolution, side = resolution / constants.reduction, constants.reduction
    _finish(found, moments)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _is_last(resolution, pair, constants):
    """Tell whether cells are as fine as the sensor's rays allow, or as the finest of use."""
    return resolution <= max(constants.ray_share * pair.across, constants.finest)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _add_log_prior(score, x, y, pair, constants):
    """Add the log-density of each shift before the points were looked at, never less than the floor."""
    if not pair.has_prior:
        return
    least = np.log(constants.prior_floor)
    for c in range(len(x)):
        dx, dy = pair.sign * x[c] - pair.prior_x, pair.sign * y[c] - pair.prior_y
        distance = pair.precision_xx * dx * dx + 2.0 * pair.precision_xy * dx * dy + pair.precision_yy * dy * dy
        score[c] += max(pair.log_peak - 0.5 * distance, least)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _softmax(score):
    """Turn log-densities into probabilities that sum to 1."""
    weight = np.exp(score - score.max())
    return weight / weight.sum()


@njit(cache=True, nogil=True)
@typing.no_type_check
def _first_candidates(pair, resolution):
    """Lay the coarsest candidates over the searched square, borders included; give them and the square's side."""
    n = int(2.0 * pair.reach / resolution + 1e-9) + 1
    x, y = np.empty(n * n), np.empty(n * n)
    for i in range(n):
        for j in range(n):
            x[i * n + j] = pair.center_x - pair.reach + i * resolution
            y[i * n + j] = pair.center_y - pair.reach + j * resolution
    return x, y, n


@njit(cache=True, nogil=True)
@typing.no_type_check
def _children(x, y, resolution, reduction):
    """Divide cells of a resolution into `reduction` times `reduction` each; give their centres."""
    fine = resolution / reduction
    first = 0.5 * (fine - resolution)
    n = reduction * reduction
    child_x, child_y = np.empty(len(x) * n), np.empty(len(x) * n)
    for c in range(len(x)):
        for i in range(reduction):
            for j in range(reduction):
                child_x[c * n + i * reduction + j] = x[c] + first + i * fine
                child_y[c * n + i * reduction + j] = y[c] + first + j * fine
    return child_x, child_y


@njit(cache=True, nogil=True)
@typing.no_type_check
def _accumulate(moments, x, y, probability, resolution):
    """Add cells to the sums of p, p x, p y, p x^2, p x y, p y^2 and of p times a cell's own variance."""
    for c in range(len(x)):
        p = probability[c]
        moments[0] += p
        moments[1] += p * x[c]
        moments[2] += p * y[c]
        moments[3] += p * x[c] * x[c]
        moments[4] += p * x[c] * y[c]
        moments[5] += p * y[c] * y[c]
        moments[6] += p * resolution**2 / 12.0


@njit(cache=True, nogil=True)
@typing.no_type_check
def _finish(found, moments):
    """Turn sums into mean and covariance."""
    m = moments / moments[0]
    found.x, found.y = m[1], m[2]
    found.xx, found.xy, found.yy = m[3] - m[1] * m[1], m[4] - m[1] * m[2], m[5] - m[2] * m[2]
    found.within = m[6]


@njit(cache=True, nogil=True)
@typing.no_type_check
def _bounds(points):
    """Give the corners of a cloud's bounding box [m]."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[i, axis])
            high[axis] = max(high[axis], points[i, axis])
    return low, high


@njit(cache=True, nogil=True)
@typing.no_type_check
def _lay(low, high, step, step_up, cells):
    """Lay a grid around a bounding box, two cells wider on each side.

    Args:
        low, high: corners of the box [m].
        step: distance of cells along x and y [m].
        step_up: along z [m]; 0 for a flat grid.
        cells: memory; may be too short as long as only the grid's size is of interest.
    """
    x, y, z = low[0] - (2.0 * step + 1e-4), low[1] - (2.0 * step + 1e-4), 0.0
    n_x = _count(high[0] + 2.0 * step - x, step, GRID_SIDE)
    n_y = _count(high[1] + 2.0 * step - y, step, GRID_SIDE)
    n_z = 1
    if step_up > 0.0:
        z = low[2] - (2.0 * step_up + 0.5 * abs(step_up - (high[2] - low[2])))
        n_z = _count(high[2] + 2.0 * step_up - z, step_up, GRID_HEIGHT)
    return _Grid(cells, n_x, n_y, n_z, x, y, z, step, step_up)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _count(length, step, most):
    return int(min(max(np.ceil(length / step), 1.0), most))


@njit(cache=True, nogil=True)
@typing.no_type_check
def _fill(grid, points, sensing):
    """Give each cell the largest of what the points' stencils write into it.

    The outermost cells stay empty, for they stand for all that is outside.
    """
    n_x, n_y, n_z = grid.n_x, grid.n_y, grid.n_z
    cells = grid.cells[: n_x * n_y * n_z]
    cells[:] = 0.0
    stencil = _stencil(grid, sensing)
    values, steps = stencil.ravel(), _steps(stencil.shape, n_x, n_y)
    w_up, w, _ = stencil.shape
    w_up, w = w_up // 2, w // 2
    for i in range(len(points)):
        ix = int((points[i, 0] - grid.x) / grid.step + 0.5)
        iy = int((points[i, 1] - grid.y) / grid.step + 0.5)
        if ix < 1 or ix > n_x - 2 or iy < 1 or iy > n_y - 2:
            continue
        iz = _layer(points[i, 2], grid, w_up)
        cell = (iz * n_x + ix) * n_y + iy
        if cells[cell] == stencil[w_up, w, w]:
            continue  # another point of this cell was here before
        is_inside = w < ix < n_x - 1 - w and w < iy < n_y - 1 - w
        if is_inside and (n_z == 1 or w_up < iz < n_z - 1 - w_up):
            for k in range(len(values)):
                cells[cell + steps[k]] = max(cells[cell + steps[k]], values[k])
        else:
            _fill_at_border(ix, iy, iz, stencil, grid)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _layer(z, grid, w_up):
    """Give the layer of a point of the cloud; those at the very top and bottom move in where stencils are thin."""
    if grid.n_z == 1:
        return 0
    iz = min(max(int((z - grid.z) / grid.step_up + 0.5), 0), grid.n_z - 1)
    return min(max(iz, 1), grid.n_z - 2) if w_up == 1 else iz


@njit(cache=True, nogil=True)
@typing.no_type_check
def _fill_at_border(ix, iy, iz, stencil, grid):
    """Write the part of a point's stencil that is inside the outermost cells."""
    n_x, n_y, n_z = grid.n_x, grid.n_y, grid.n_z
    w_up, w = stencil.shape[0] // 2, stencil.shape[1] // 2
    z_first, z_last = (max(iz - w_up, 1), min(iz + w_up, n_z - 2)) if n_z > 1 else (0, 0)
    for jz in range(z_first, z_last + 1):
        for jx in range(max(ix - w, 1), min(ix + w, n_x - 2) + 1):
            row = (jz * n_x + jx) * n_y
            for jy in range(max(iy - w, 1), min(iy + w, n_y - 2) + 1):
                value = stencil[jz - iz + w_up, jx - ix + w, jy - iy + w]
                grid.cells[row + jy] = max(grid.cells[row + jy], value)


@njit(cache=True, nogil=True)
@typing.no_type_check
def _stencil(grid, sensing):
    """Tabulate what a point writes into its own cell and its neighbours', up to two standard deviations away.

    Horizontally a point may also be measured anywhere else in its cell.
    """
    variance, variance_up = grid.step**2 + sensing.spread**2, sensing.spread_up**2
    w = int(np.ceil(2.0 * np.sqrt(variance) / grid.step - 1.0))
    w_up = max(1, int(np.ceil(2.0 * sensing.spread_up / grid.step_up - 1.0))) if grid.n_z > 1 else 0
    stencil = np.empty((2 * w_up + 1, 2 * w + 1, 2 * w + 1), dtype=np.float32)
    for k in range(w_up + 1):
        up = (k * grid.step_up) ** 2 / (2.0 * variance_up)
        for i in range(w + 1):
            for j in range(i + 1):
                across = (i * i + j * j) * grid.step**2 / (2.0 * variance)
                value = np.log(np.exp(-across - up) + sensing.floor) - np.log(sensing.floor)
                for a in (w_up - k, w_up + k):
                    for b, c in ((i, j), (j, i)):
                        stencil[a, w - b, w - c] = stencil[a, w - b, w + c] = value
                        stencil[a, w + b, w - c] = stencil[a, w + b, w + c] = value
    return stencil


@njit(cache=True, nogil=True)
@typing.no_type_check
def _steps(widths, n_x, n_y):
    """Give how far each cell of a stencil is from its middle in the grid's memory."""
    steps = np.empty(widths[0] * widths[1] * widths[2], dtype=np.int64)
    k = 0
    for jz in range(-(widths[0] // 2), widths[0] // 2 + 1):
        for jx in range(-(widths[1] // 2), widths[1] // 2 + 1):
            for jy in range(-(widths[2] // 2), widths[2] // 2 + 1):
                steps[k] = (jz * n_x + jx) * n_y + jy
                k += 1
    return steps


@njit(cache=True, nogil=True)
@typing.no_type_check
def _look_up(grid, points, x, y, side):
    """Sum up, for each of many shifts, the cells that the shifted points lie in.

    Shifts come in squares of `side` times `side`, whose columns share their x and whose rows share their y.

    Args:
        grid: filled.
        points: (n, 3) [m].
        x, y: the shifts [m], square by square, column by column.
        side: of a square.
    """
    n = len(points)
    layer = _layers(grid, points)
    px, py = points[:, 0] / grid.step + 0.5, points[:, 1] / grid.step + 0.5  # half a cell on: cutting rounds
    column, row = np.empty(n, dtype=np.int32), np.empty((side, n), dtype=np.int32)
    total = np.empty(len(x))
    for first in range(0, len(x), side * side):
        for b in range(side):
            _places(py, (y[first + b] - grid.y) / grid.step, grid.n_y, row[b])
        for a in range(side):
            _places(px, (x[first + a * side] - grid.x) / grid.step, grid.n_x, column)
            for i in range(n):
                column[i] = column[i] * grid.n_y + layer[i]
            for b in range(side):
                total[first + a * side + b] = _sum(grid.cells, column, row[b])
    return total


@njit(cache=True, nogil=True)
@typing.no_type_check
def _layers(grid, points):
    """Give where in memory each point's layer starts; shifts do not change it."""
    layer = np.zeros(len(points), dtype=np.int32)
    if grid.n_z > 1:
        for i in range(len(points)):
            iz = int((points[i, 2] - grid.z) / grid.step_up + 0.5)
            layer[i] = min(max(iz, 0), grid.n_z - 1) * grid.n_x * grid.n_y
    return layer


@njit(cache=True, nogil=True)
@typing.no_type_check
def _places(position, shift, n_cells, out):
    """Give the cells that shifted positions lie in; all that is outside counts as the outermost."""
    for i in range(len(position)):
        out[i] = min(max(np.int32(position[i] + shift), np.int32(0)), np.int32(n_cells - 1))


@njit(cache=True, nogil=True, fastmath={"reassoc"})
@typing.no_type_check
def _sum(cells, column, row):
    total = 0.0
    for i in range(len(column)):
        total += cells[column[i] + row[i]]
    return total
