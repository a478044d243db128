"""The compiled loops behind `neighbours` and the ICP methods: sort into cells, search, iterate.

They share one file because numba's cache looks only at the file of the function it was asked for: a search that
lived elsewhere could change without the loops that contain it being compiled anew.  They take arrays one by one,
which makes many arguments (PLR0913): numba counts references of arrays that come in tuples, again and again, and of
those that a function hands on to another, whenever it is called.  So what is called for each point (`look_around`)
calls nothing that is not inlined, and loops hand whole arrays on, not rows of them.
Divisions are checked where they are made, not by numba (`error_model`), and rows that cannot be negative are said to
be so (uint64): together a tenth of ICP's time.

ICP looks for the nearest target point of every source point again and again, each time almost where it was.  So
each source point keeps a list of the few target points around it and how far away everything else is, and the
grid is asked again only when the point has moved so far that another target point could be nearer.  The answer
stays exact.  Source of the idea: Verlet, "Computer experiments on classical fluids", Phys. Rev. 159, 1967.
"""

import typing

import numpy as np
from numba import njit

LARGEST_EXTENT = 1e12  # [m]; beyond it, and where numbers overflow, one cell holds everything
ROUNDING = 1e-6  # a search reaches this share of a cell farther, so that rounding hides no cell
CLOSE = 1e-9  # lists are given up this much before they have to be [m]
LINE = 0.01  # neighbours lie on a line whose second scatter is less than this share of the first
UPRIGHT = 0.5  # a plane counts as upright when its normal's horizontal part is longer than this, ...
FLAT = 0.2  # ... and as flat, telling of z alone, when it is shorter than this
PLANE_NUMBERS = 3  # numbers that a plane has
LARGEST_TURN = 0.2  # of one update [rad]
LISTED = 4  # target points that a source point remembers

# Lines of `memory`, which has a column for every source point: where the point was at first; where the target points
# on its list are, and their squared distance in z; where it was when it asked the grid, and how far away then
# everything was that is not on its list; where it is now; its squared distance to the nearest target point, which
# one on the list that is, and how much farther off all others must be (below 0: the grid must be asked).
X, Y, Z = range(3)
LIST_X, LIST_Y, LIST_DZ2 = 3, 3 + LISTED, 3 + 2 * LISTED
X_THEN, Y_THEN, BEYOND, X_NOW, Y_NOW, DISTANCE2, NEAREST, SAFE = range(3 + 3 * LISTED, 11 + 3 * LISTED)
LINES = 11 + 3 * LISTED

# How an alignment ended, as the kernels number it.
CONVERGED, NOT_CONVERGED, NO_OVERLAP, TOO_FEW_POINTS, EMPTY = range(5)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def move_all(points, begin, turns, places, shifts):
    """Turn clouds about places of their own, counter-clockwise [rad], and shift them (x, y) [m]; in place.

    Cloud k is rows begin[k] to begin[k + 1] of `points`.
    """
    for k in range(len(begin) - 1):
        c, s = np.cos(turns[k]), np.sin(turns[k])
        x, y = places[k, 0], places[k, 1]
        x_shift, y_shift = x + shifts[k, 0] - (c * x - s * y), y + shifts[k, 1] - (s * x + c * y)
        for i in range(begin[k], begin[k + 1]):
            x, y = points[i, 0], points[i, 1]
            points[i, 0], points[i, 1] = c * x - s * y + x_shift, s * x + c * y + y_shift


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def center_all(points, begin, means, scatters):
    """Move clouds to their means, in place.

    `means` becomes these, and `scatters` the horizontal covariances (xx, xy, yy); zero for an empty cloud.
    """
    for k in range(len(begin) - 1):
        a, b = begin[k], begin[k + 1]
        for axis in range(3):
            means[k, axis] = scatters[k, axis] = 0.0
            if a < b:
                origin = points[a, axis]  # sums of small numbers keep their digits where coordinates are kilometres
                for i in range(a, b):
                    means[k, axis] += points[i, axis] - origin
                means[k, axis] = origin + means[k, axis] / (b - a)
            for i in range(a, b):
                points[i, axis] -= means[k, axis]
        for i in range(a, b):
            scatters[k, 0] += points[i, 0] * points[i, 0] / (b - a)
            scatters[k, 1] += points[i, 0] * points[i, 1] / (b - a)
            scatters[k, 2] += points[i, 1] * points[i, 1] / (b - a)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def sort_into_cells(points, begin, cells, most):
    """Choose the cells of many clouds and sort them into these.

    Args:
        points: of all clouds (n, 3) [m].
        begin: cloud k is rows begin[k] to begin[k + 1].
        cells: cells of cloud k are cubes of side cells[k] [m], or larger ones ...
        most: ... where those would be more than most[k].

    Returns:
        the sorted points, their rows in their clouds, `first` and `first_begin` (see `neighbours.Packed`), `frames`.
    """
    n_clouds = len(begin) - 1
    frames, first_begin = np.empty((n_clouds, 7)), np.zeros(n_clouds + 1, np.int64)
    for k in range(n_clouds):
        _lay_out(points, begin[k], begin[k + 1], cells[k], most[k], frames, k)
        first_begin[k + 1] = first_begin[k] + int(frames[k, 4]) * int(frames[k, 5]) * int(frames[k, 6]) + 1
    first, taken = np.zeros(first_begin[-1], np.int32), np.empty(first_begin[-1], np.int32)
    numbers = np.empty(len(points), np.int32)
    in_order, order = np.empty((len(points), 3)), np.empty(len(points), np.int64)
    for k in range(n_clouds):
        n_x, n_y, n_z, start = int(frames[k, 4]), int(frames[k, 5]), int(frames[k, 6]), first_begin[k]
        for i in range(begin[k], begin[k + 1]):
            x = _cell((points[i, 0] - frames[k, 0]) / frames[k, 3], n_x)
            y = _cell((points[i, 1] - frames[k, 1]) / frames[k, 3], n_y)
            numbers[i] = (x * n_y + y) * n_z + _cell((points[i, 2] - frames[k, 2]) / frames[k, 3], n_z)
            first[start + numbers[i] + 1] += 1
        taken[start] = 0
        for number in range(start + 1, first_begin[k + 1]):
            first[number] += first[number - 1]
            taken[number] = first[number]
        for i in range(begin[k], begin[k + 1]):
            place = begin[k] + taken[start + numbers[i]]
            order[place] = i - begin[k]
            in_order[place, 0], in_order[place, 1], in_order[place, 2] = points[i, 0], points[i, 1], points[i, 2]
            taken[start + numbers[i]] += 1
    return in_order, order, first, first_begin, frames


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _lay_out(points, begin, end, cell, most, frames, k):  # noqa: PLR0913
    frame, largest = frames[k], 0.0
    frame[:3], frame[3:] = 0.0, 1.0
    frame[3] = cell
    if begin == end:
        return
    extent = np.zeros(3)
    for axis in range(3):
        low = high = points[begin, axis]
        for i in range(begin, end):
            low, high = min(low, points[i, axis]), max(high, points[i, axis])
        frame[axis], extent[axis] = low, high - low
        largest = max(largest, extent[axis]) if extent[axis] == extent[axis] else np.inf
    if not largest < LARGEST_EXTENT:
        return
    while True:
        for axis in range(3):
            frame[4 + axis] = np.floor(extent[axis] / frame[3]) + 1.0
        if frame[4] * frame[5] * frame[6] <= most:
            return
        frame[3] *= 1.25


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _cell(position, n_cells):
    """Give the number of the cell at a position counted in cells; positions outside go to the border."""
    if not position > 0.0:  # NaN too
        return 0
    return int(position) if position < n_cells else n_cells - 1


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def nearest_points(  # noqa: PLR0913
    begin, end, queries, queries_begin, points, points_begin, first, first_begin, frames, radius, rows, distances2
):
    """Fill in the nearest points of each query of clouds `begin` to `end` of a batch (see `point_to_point`).

    As many a query as `rows` has columns, which hold -1, nearest first, closer than `radius` [m]; row -1 for no point.
    """
    for n in range(begin, end):
        target, target_first = points[points_begin[n] : points_begin[n + 1]], first[first_begin[n] : first_begin[n + 1]]
        for i in range(queries_begin[n], queries_begin[n + 1]):
            x, y, z = queries[i, 0], queries[i, 1], queries[i, 2]
            look_around(target, target_first, frames[n], x, y, z, radius, rows[i], distances2[i])


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def look_around(points, first, frame, x, y, z, reach, found, distances2):  # noqa: PLR0913
    """Fill `found` with the nearest points closer than `reach`, nearest first, and -1 where there are no more.

    Those of the place before, still in it, tell how far to look at most, unless they are -1.  Then those of the cell
    that the place is in do, which come first.
    """
    farthest2, last = reach**2, len(found) - 1
    if found[last] >= 0:
        known2 = 0.0
        for k in range(len(found)):
            row = found[k]
            known2 = max(known2, (points[row, 0] - x) ** 2 + (points[row, 1] - y) ** 2 + (points[row, 2] - z) ** 2)
        farthest2 = min(farthest2, known2 * (1.0 + 1e-9) + CLOSE**2)
    for k in range(len(found)):
        found[k], distances2[k] = -1, farthest2
    n_x, n_y, n_z = int(frame[4]), int(frame[5]), int(frame[6])
    scale = 1.0 / frame[3]
    u, v, w = (x - frame[0]) * scale, (y - frame[1]) * scale, (z - frame[2]) * scale
    i_own, j_own = _cell(u, n_x), _cell(v, n_y)
    own = (i_own * n_y + j_own) * n_z + _cell(w, n_z)
    _search_rows(points, first[own], first[own + 1], x, y, z, found, distances2)
    cells = np.sqrt(distances2[last]) * scale + ROUNDING
    i_low, i_high = _cell(u - cells, n_x), _cell(u + cells, n_x)
    j_low, j_high = _cell(v - cells, n_y), _cell(v + cells, n_y)
    k_low, k_high = _cell(w - cells, n_z), _cell(w + cells, n_z)
    for i in range(i_low, i_high + 1):
        for j in range(j_low, j_high + 1):
            column = (i * n_y + j) * n_z
            if i == i_own and j == j_own:
                _search_rows(points, first[column + k_low], first[own], x, y, z, found, distances2)
                _search_rows(points, first[own + 1], first[column + k_high + 1], x, y, z, found, distances2)
            else:
                _search_rows(points, first[column + k_low], first[column + k_high + 1], x, y, z, found, distances2)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _search_rows(points, begin, end, x, y, z, rows, distances2):  # noqa: PLR0913
    """Put those of the rows that are nearer than what is there in their places."""
    last = len(rows) - 1
    farthest2 = distances2[last]
    for row in range(np.uint64(begin), np.uint64(end)):
        distance2 = (points[row, 0] - x) ** 2 + (points[row, 1] - y) ** 2 + (points[row, 2] - z) ** 2
        if distance2 < farthest2:
            place = last
            while place > 0 and distances2[place - 1] > distance2:
                distances2[place], rows[place] = distances2[place - 1], rows[place - 1]
                place -= 1
            distances2[place], rows[place] = distance2, row
            farthest2 = distances2[last]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def nothing_paired(source):
    """Make the memory of `pair_up` (see the constants), and the rows of the nearest target points (LISTED + 1, n)."""
    memory = np.full((LINES, len(source)), np.inf)
    for i in range(len(source)):
        memory[X, i], memory[Y, i], memory[Z, i] = source[i, 0], source[i, 1], source[i, 2]
        memory[X_THEN, i], memory[Y_THEN, i], memory[BEYOND, i] = 0.0, 0.0, -1.0  # so that all ask the grid first
    return memory, np.full((LISTED + 1, len(source)), -1)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def pair_up(points, first, frame, motion, within, memory, rows):  # noqa: PLR0913
    """Move the source by (x, y, yaw) about its origin and find each point's nearest target point within reach.

    The pairs are in `memory` and `rows`.  Gives their number and the RMS distance of their points [m].
    """
    ask_lists(motion, within, memory)
    found, distances2 = np.full(LISTED + 1, -1), np.zeros(LISTED + 1)
    n_pairs, squares = 0, 0.0
    for i in range(memory.shape[1]):
        if memory[SAFE, i] < 0.0:
            x, y, z = memory[X_NOW, i], memory[Y_NOW, i], memory[Z, i]
            if rows[LISTED, i] >= 0:
                for k in range(LISTED + 1):
                    found[k] = rows[k, i]
            look_around(points, first, frame, x, y, z, 1.5 * within, found, distances2)
            rows[LISTED, i] = found[LISTED]
            for k in range(LISTED):
                row = rows[k, i] = found[k]
                memory[LIST_X + k, i] = points[row, 0] if row >= 0 else np.inf
                memory[LIST_Y + k, i] = points[row, 1] if row >= 0 else np.inf
                memory[LIST_DZ2 + k, i] = (points[row, 2] - z) ** 2 if row >= 0 else np.inf
            memory[X_THEN, i], memory[Y_THEN, i] = x, y
            memory[BEYOND, i] = np.sqrt(distances2[LISTED]) - CLOSE
            memory[DISTANCE2, i] = distances2[0] if found[0] >= 0 else np.inf
            memory[NEAREST, i] = 0.0
        distance2 = memory[DISTANCE2, i]
        n_pairs += 1 if distance2 < within**2 else 0
        squares += distance2 if distance2 < within**2 else 0.0
    return n_pairs, np.sqrt(squares / n_pairs) if n_pairs else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def ask_lists(motion, within, memory):
    """Move all source points and find the nearest of the target points that each has on its list."""
    c, s, x_shift, y_shift = np.cos(motion[2]), np.sin(motion[2]), motion[0], motion[1]
    for i in range(memory.shape[1]):  # free of branches, so that the compiler does eight points at once
        x = c * memory[X, i] - s * memory[Y, i] + x_shift
        y = s * memory[X, i] + c * memory[Y, i] + y_shift
        nearest2, nearest = np.inf, 0.0
        for k in range(LISTED):
            distance2 = (memory[LIST_X + k, i] - x) ** 2 + (memory[LIST_Y + k, i] - y) ** 2 + memory[LIST_DZ2 + k, i]
            is_nearer = distance2 < nearest2
            nearest2 = distance2 if is_nearer else nearest2
            nearest = float(k) if is_nearer else nearest
        moved = np.sqrt((x - memory[X_THEN, i]) ** 2 + (y - memory[Y_THEN, i]) ** 2)
        matters2 = nearest2 if nearest2 < within**2 else within**2
        memory[X_NOW, i], memory[Y_NOW, i] = x, y
        memory[DISTANCE2, i], memory[NEAREST, i] = nearest2, nearest
        memory[SAFE, i] = memory[BEYOND, i] - moved - np.sqrt(matters2)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def point_to_point(  # noqa: PLR0913
    begin, end, sources, source_begin, points, points_begin, first, first_begin, frames, limits, motions, outcomes
):
    """Align pairs `begin` to `end` of a batch by pairing nearest points.

    Sources and targets (`points`, `first`, `frames`: see `neighbours.Grid`) lie one after the other; pair k's begin at
    `..._begin[k]`.  `limits`: (max_distance [m], max_iterations, tolerance, min_points).
    `motions[k]` goes in as the start and comes out as (x, y, yaw) about the source's origin; `outcomes[k]`
    becomes (how it ended, number of pairs, RMSE [m], number of iterations).
    """
    for k in range(begin, end):
        source = sources[source_begin[k] : source_begin[k + 1]]
        target = points[points_begin[k] : points_begin[k + 1]]
        target_first = first[first_begin[k] : first_begin[k + 1]]
        outcomes[k, 0], outcomes[k, 1], outcomes[k, 2], outcomes[k, 3] = _align_points(
            source, target, target_first, frames[k], limits, motions[k]
        )


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _align_points(source, points, first, frame, limits, motion):
    max_distance, max_iterations, tolerance, min_points = limits
    fewest = min(len(source), len(points))
    if fewest == 0 or fewest < min_points:
        return EMPTY if fewest == 0 else TOO_FEW_POINTS, 0, np.nan, 0
    memory, rows = nothing_paired(source)
    n_pairs, rmse = pair_up(points, first, frame, motion, max_distance, memory, rows)
    for iteration in range(1, max_iterations + 1):
        if n_pairs < min_points:
            return NO_OVERLAP, 0, np.nan, iteration - 1
        _add_best_motion(max_distance, memory, motion)
        n_before, rmse_before = n_pairs, rmse
        n_pairs, rmse = pair_up(points, first, frame, motion, max_distance, memory, rows)
        if abs(n_pairs - n_before) < tolerance * len(source) and abs(rmse - rmse_before) < tolerance:
            return CONVERGED, n_pairs, rmse, iteration
    return NOT_CONVERGED, n_pairs, rmse, max_iterations


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _add_best_motion(within, memory, motion):
    """Let the motion that brings the pairs closest together (`planar.align_pairs`) follow `motion`.

    Its sums keep their order: with `fastmath` the process that compiles and those that find it in numba's cache would
    run two builds of this function, which differ in the last digit.
    """
    n, x_sum, y_sum, p_sum, q_sum, cross, dot = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(memory.shape[1]):
        k = int(memory[NEAREST, i])
        is_paired = memory[DISTANCE2, i] < within**2
        x, y = memory[X_NOW, i] if is_paired else 0.0, memory[Y_NOW, i] if is_paired else 0.0
        p, q = memory[LIST_X + k, i] if is_paired else 0.0, memory[LIST_Y + k, i] if is_paired else 0.0
        n += 1.0 if is_paired else 0.0
        x_sum, y_sum, p_sum, q_sum = x_sum + x, y_sum + y, p_sum + p, q_sum + q
        cross += x * q - y * p
        dot += x * p + y * q
    cross -= (x_sum * q_sum - y_sum * p_sum) / n
    dot -= (x_sum * p_sum + y_sum * q_sum) / n
    yaw = np.arctan2(cross, dot) if cross != 0.0 or dot != 0.0 else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = motion[0] - x_sum / n, motion[1] - y_sum / n
    motion[0] = c * x - s * y + p_sum / n
    motion[1] = s * x + c * y + q_sum / n
    motion[2] = motion[2] + yaw


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def fit_planes(points, first, frame, wanted, around, near, planes):  # noqa: PLR0913
    """Fit planes to the neighbourhoods of points, where there is none yet: rows of `planes`, of which each has the unit
    normal, the variance of its lean [rad^2], and the squared radius of the neighbourhood [m^2] (5).

    Neighbourhood: the nearest points, itself among them, within a radius.  Where these lie on a line, as those of a
    single scan ring, more of the nearest are taken instead, of which some may be on other rings: a ring on a hood looks
    like one on a wall.  Those on a line too leave the plane open: an upright one is taken then.  The normal is zero
    where there is no plane to fit.  A normal leans sideways, along the ground, by the noise of the points that it was
    fitted to.

    Args:
        points, first, frame: see `sort_into_cells`.
        wanted: numbers of the points; -1 for none.
        around: radius [m], number of nearest points, and on a line.
        near: so many rows of points near by, or -1.
        planes: filled in; NaN where there is none yet.
    """
    (radius, _, n_line), scatter, distances2 = around, np.empty((3, 3)), np.empty(len(near))
    more, farther2 = np.full(n_line, -1), np.empty(n_line)
    for k in range(len(wanted)):
        i = wanted[k]
        if i < 0 or not np.isnan(planes[i, 0]):
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        look_around(points, first, frame, x, y, z, radius, near, distances2)
        n = _scatter(points, near, scatter)
        planes[i, 4] = distances2[max(n, 1) - 1]  # nearest first
        values = _eigenvalues(scatter)
        if n_line > len(near) and not values[1] > LINE * values[2]:
            more[n_line - 1] = -1
            look_around(points, first, frame, x, y, z, radius, more, farther2)
            n = _scatter(points, more, scatter)
            values = _eigenvalues(scatter)
        planes[i, 0], planes[i, 1], planes[i, 2] = _normal(scatter, values)
        planes[i, 3] = _lean(scatter, planes[i, 0], planes[i, 1], planes[i, 2], n)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _lean(scatter, n_x, n_y, n_z, n):
    """Give the variance of how far a normal leans sideways: that of the slope of a plane through n points, there."""
    steepness = np.hypot(n_x, n_y)
    if n <= PLANE_NUMBERS or not steepness > FLAT:
        return 0.0
    x, y = -n_y / steepness, n_x / steepness
    across = n_x * n_x * scatter[0, 0] + n_y * n_y * scatter[1, 1] + n_z * n_z * scatter[2, 2]
    across += 2.0 * (n_x * n_y * scatter[0, 1] + n_x * n_z * scatter[0, 2] + n_y * n_z * scatter[1, 2])
    along = x * x * scatter[0, 0] + 2.0 * x * y * scatter[0, 1] + y * y * scatter[1, 1]
    return max(across, 0.0) / (n - PLANE_NUMBERS) / along if along > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _scatter(points, rows, scatter):
    """Sum the products of coordinates about the mean of some rows, those of -1 left out; give their number."""
    n, x, y, z = 0, 0.0, 0.0, 0.0
    for k in range(len(rows)):
        row = rows[k]
        if row >= 0:
            n += 1
            x, y, z = x + points[row, 0], y + points[row, 1], z + points[row, 2]
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(rows)):
        row = rows[k]
        if row >= 0:
            a, b, c = points[row, 0] - x / n, points[row, 1] - y / n, points[row, 2] - z / n
            xx, xy, xz, yy, yz, zz = xx + a * a, xy + a * b, xz + a * c, yy + b * b, yz + b * c, zz + c * c
    scatter[0, 0], scatter[1, 1], scatter[2, 2] = xx, yy, zz
    scatter[0, 1] = scatter[1, 0] = xy
    scatter[0, 2] = scatter[2, 0] = xz
    scatter[1, 2] = scatter[2, 1] = yz
    return n


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _normal(scatter, values):
    smallest, middle, largest = values
    if not largest > 0.0:
        return 0.0, 0.0, 0.0
    if middle > LINE * largest:
        return _eigenvector(scatter, smallest)
    x, y, _ = _eigenvector(scatter, largest)
    length = np.hypot(x, y)
    if length < UPRIGHT:
        return 0.0, 0.0, 0.0
    return -y / length, x / length, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _eigenvalues(A):
    """Give the eigenvalues of a symmetric 3x3 matrix, ascending.

    Source: Smith, "Eigenvalues of a symmetric 3x3 matrix", Comm. ACM 4(4), 1961.
    """
    off2 = A[0, 1] ** 2 + A[0, 2] ** 2 + A[1, 2] ** 2
    mean = (A[0, 0] + A[1, 1] + A[2, 2]) / 3.0
    a, b, c = A[0, 0] - mean, A[1, 1] - mean, A[2, 2] - mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * off2) / 6.0)
    if not p > 0.0:
        return mean, mean, mean
    determinant = (
        a * (b * c - A[1, 2] ** 2)
        - A[0, 1] * (A[0, 1] * c - A[1, 2] * A[0, 2])
        + A[0, 2] * (A[0, 1] * A[1, 2] - b * A[0, 2])
    )
    angle = np.arccos(min(1.0, max(-1.0, determinant / (2.0 * p**3)))) / 3.0
    largest = mean + 2.0 * p * np.cos(angle)
    smallest = mean + 2.0 * p * np.cos(angle + 2.0 * np.pi / 3.0)
    return smallest, 3.0 * mean - largest - smallest, largest


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _eigenvector(A, value):
    """Give the unit eigenvector of a symmetric 3x3 matrix for one of its single eigenvalues; zero for others.

    It is at right angles to the rows of A - value I: the longest of their cross products is the surest.
    """
    a, b, c = A[0, 0] - value, A[1, 1] - value, A[2, 2] - value
    d, e, f = A[0, 1], A[0, 2], A[1, 2]
    best, longest2 = (0.0, 0.0, 0.0), 0.0
    for x, y, z in (
        (d * f - e * b, e * d - a * f, a * b - d * d),
        (d * c - e * f, e * e - a * c, a * f - d * e),
        (b * c - f * f, f * e - d * c, d * f - b * e),
    ):
        length2 = x * x + y * y + z * z
        if length2 > longest2:
            best, longest2 = (x, y, z), length2
    length = np.sqrt(longest2) if longest2 > 0.0 else 1.0
    return best[0] / length, best[1] / length, best[2] / length


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def point_to_plane(  # noqa: PLR0913
    begin, end, sources, source_begin, points, points_begin, first, first_begin, frames, planes, own, around, limits,
    beliefs, motions, outcomes, informations
):  # fmt: skip
    """Align pairs `begin` to `end` of a batch by bringing points onto their neighbours' planes.

    As `point_to_point`, and: `own[k]`: which target is that of pair k; `planes` about the targets' points, NaN where
    none is fitted yet, by `fit_planes` with `around`: (radius [m], number of neighbours, and on a line); `limits`:
    (max_distance [m], max_iterations, tolerance [m and rad], min_points, noise [m], patches: patch_share^-2,
    robust_scale [m], independent pairs, belief about the change of height [1/m^2]); `beliefs[k]`: inverse covariance of
    the start; `informations[k]` becomes what the planes alone say of the motion, an inverse covariance too;
    `outcomes[k]` ends with the change of height beside that of the centroids [m].
    """
    for k in range(begin, end):
        source, t = sources[source_begin[k] : source_begin[k + 1]], own[k]
        a, b = points_begin[t], points_begin[t + 1]
        target = points[a:b], first[first_begin[t] : first_begin[t + 1]], frames[t], planes[a:b]
        row = outcomes[k]
        row[0], row[1], row[2], row[3], row[4] = _align_planes(
            source, target, around, limits, beliefs[k], motions[k], informations[k]
        )


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _align_planes(source, target, around, limits, belief, motion, information):
    points, first, frame, planes = target
    near, wanted = np.full(around[1], -1), np.empty(len(source), np.int64)
    (max_distance, max_iterations, tolerance, min_points, noise, patches, robust_scale, independent, height_belief) = (
        limits
    )
    fewest = min(len(source), len(points))
    if fewest == 0 or fewest < min_points:
        return EMPTY if fewest == 0 else TOO_FEW_POINTS, 0, np.nan, 0, 0.0
    memory, rows = nothing_paired(source)
    start, lift = motion.copy(), 0.0
    known, full, gradient, leaning = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros(4), np.zeros((3, 3))
    known[:3, :3], known[3, 3] = belief, height_belief
    n_pairs, rmse = 0, np.nan
    for iteration in range(1, max_iterations + 1):
        n_pairs, rmse = pair_up(points, first, frame, motion, max_distance, memory, rows)
        if n_pairs < min_points:
            return NO_OVERLAP, 0, np.nan, iteration - 1, lift
        for i in range(memory.shape[1]):
            wanted[i] = rows[int(memory[NEAREST, i]), i] if memory[DISTANCE2, i] < max_distance**2 else -1
        fit_planes(points, first, frame, wanted, around, near, planes)
        n_planes = _compare_with_planes(
            points, planes, motion, max_distance, robust_scale, patches, memory, rows, full, gradient, leaning
        )
        weight = min(1.0, independent / max(n_planes, 1)) / noise**2
        full *= weight
        leaning *= weight
        gradient *= -weight
        gradient[:3] -= belief @ (motion - start)
        gradient[3] -= height_belief * lift
        step = np.linalg.solve(full + known, gradient)
        longest = max(np.hypot(step[0], step[1]), abs(step[3]))
        step /= max(longest / max_distance, abs(step[2]) / LARGEST_TURN, 1.0)
        motion += step[:3]
        if np.hypot(step[0], step[1]) < tolerance and abs(step[2]) < tolerance:
            _tell(full, leaning, height_belief, information)
            return CONVERGED, n_pairs, rmse, iteration, lift
        if abs(step[3]) > tolerance:  # less would make all points ask the grid again for nothing
            lift += step[3]
            _lift(points, step[3], memory, rows)
    _tell(full, leaning, height_belief, information)
    return NOT_CONVERGED, n_pairs, rmse, max_iterations, lift


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _tell(full, leaning, height_belief, information):
    """Say what is known of (x, y, yaw) while the height is unknown, but for a belief.

    What normals seem to tell since they lean is taken out; what is no more than that is not told at all.
    """
    height = full[3, 3] + height_belief
    for a in range(3):
        for b in range(3):
            information[a, b] = full[a, b] - full[a, 3] * full[3, b] / height - leaning[a, b]
    values, axes = np.linalg.eigh(information)
    if values[0] < 0.0:
        information[:] = (axes * np.maximum(values, 0.0)) @ axes.T


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _lift(points, step, memory, rows):
    """Lift all source points; what is on no list may have come nearer by as much."""
    for i in range(memory.shape[1]):
        memory[Z, i] += step
        memory[BEYOND, i] -= abs(step)
        for k in range(LISTED):
            if rows[k, i] >= 0:
                memory[LIST_DZ2 + k, i] = (points[rows[k, i], 2] - memory[Z, i]) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _compare_with_planes(  # noqa: PLR0913
    points, planes, motion, within, robust_scale, patches, memory, rows, information, gradient, leaning
):
    """Set up J'WJ and J'Wr of the distances r to the partners' planes; give the number of planes that tell something.

    r = n (R s + t - q), J = (n_x, n_y, n_y a_x - n_x a_y, n_z) with the arm a = R s; the weight of a pair is Geman &
    McClure's, 1 / (1 + (r / robust_scale)^2)^2, and as much less again, by the same law, as the point lies beside its
    partner, against the radius of the plane's neighbourhood: nothing is known of the surface there.  Planes that are
    not upright are not counted; flat ones tell of z alone.

    `leaning` becomes what J'WJ expects to have of (x, y, yaw) only since normals lean: the same with the directions
    along the planes, times the variances.  Along a flat side that is all there is: n of its normals seem to tell of a
    motion along it as one end would.
    """
    # sums of their own, in arrays they take twice as long
    xx = xy = xt = xz = yy = yt = yz = tt = tz = zz = gx = gy = gt = gz = lxx = lxy = lxt = lyy = lyt = ltt = 0.0
    n_planes, sharper = 0, robust_scale**-2
    for i in range(memory.shape[1]):
        row = rows[int(memory[NEAREST, i]), i]
        if not memory[DISTANCE2, i] < within**2:
            continue
        n_x, n_y, n_z = planes[row, 0], planes[row, 1], planes[row, 2]
        steepness2 = n_x * n_x + n_y * n_y
        n_planes += 1 if steepness2 > UPRIGHT**2 else 0
        x, y = memory[X_NOW, i], memory[Y_NOW, i]
        r = n_x * (x - points[row, 0]) + n_y * (y - points[row, 1]) + n_z * (memory[Z, i] - points[row, 2])
        beside2, around2 = max(memory[DISTANCE2, i] - r * r, 0.0), max(planes[row, 4], CLOSE)
        root = around2 / ((1.0 + r * r * sharper) * (around2 + patches * beside2))
        weight = root * root
        zz += weight * n_z * n_z
        gz += weight * n_z * r
        if not steepness2 > FLAT**2:
            continue
        x, y = x - motion[0], y - motion[1]
        n_t, t = n_y * x - n_x * y, n_x * x + n_y * y
        w_x, w_y, w_t, lean = weight * n_x, weight * n_y, weight * n_t, weight * planes[row, 3] / steepness2
        xx, xy, xt, xz, gx = xx + w_x * n_x, xy + w_x * n_y, xt + w_x * n_t, xz + w_x * n_z, gx + w_x * r
        yy, yt, yz, gy = yy + w_y * n_y, yt + w_y * n_t, yz + w_y * n_z, gy + w_y * r
        tt, tz, gt = tt + w_t * n_t, tz + w_t * n_z, gt + w_t * r
        lxx, lxy, lxt = lxx + lean * n_y * n_y, lxy - lean * n_y * n_x, lxt - lean * n_y * t
        lyy, lyt, ltt = lyy + lean * n_x * n_x, lyt + lean * n_x * t, ltt + lean * t * t
    information[0, 0], information[0, 1], information[0, 2], information[0, 3] = xx, xy, xt, xz
    information[1, 0], information[1, 1], information[1, 2], information[1, 3] = xy, yy, yt, yz
    information[2, 0], information[2, 1], information[2, 2], information[2, 3] = xt, yt, tt, tz
    information[3, 0], information[3, 1], information[3, 2], information[3, 3] = xz, yz, tz, zz
    leaning[0, 0], leaning[0, 1], leaning[0, 2] = lxx, lxy, lxt
    leaning[1, 0], leaning[1, 1], leaning[1, 2] = lxy, lyy, lyt
    leaning[2, 0], leaning[2, 1], leaning[2, 2] = lxt, lyt, ltt
    gradient[0], gradient[1], gradient[2], gradient[3] = gx, gy, gt, gz
    return n_planes


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def inverses(matrices):
    """Invert symmetric matrices (n, 3, 3); NumPy's own takes longer to call than to compute, and LAPACK to compile."""
    found = np.empty(matrices.shape)
    for k in range(len(matrices)):
        a, b, c = matrices[k, 0, 0], matrices[k, 0, 1], matrices[k, 0, 2]
        d, e, f = matrices[k, 1, 1], matrices[k, 1, 2], matrices[k, 2, 2]
        p, q, r = d * f - e * e, c * e - b * f, b * e - c * d  # cofactors
        determinant = a * p + b * q + c * r
        found[k, 0, 0], found[k, 1, 1] = p / determinant, (a * f - c * c) / determinant
        found[k, 2, 2] = (a * d - b * b) / determinant
        found[k, 0, 1] = found[k, 1, 0] = q / determinant
        found[k, 0, 2] = found[k, 2, 0] = r / determinant
        found[k, 1, 2] = found[k, 2, 1] = (b * c - a * e) / determinant
    return found


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def covariances(outcomes, informations, known, sizes, variance, shares):  # noqa: PLR0913
    """Bound the errors of motions that planes found; see `plane_icp.Iterated.covariances`.

    Args:
        outcomes, informations: see `point_to_plane`; of n pairs.
        known: inverse covariances of the starts (n, 3, 3).
        sizes: points of both clouds (n, 2).
        variance: of a point's distance to its plane, by the informations [m^2].
        shares: of variances: for each pair of points, over the points of the smaller cloud, for the square of the share
            that is apart, a factor where iterations did not settle, and of any shift.
    """
    shared, sampling, apart, unsettled, floor = shares
    whole = np.empty((len(outcomes), 3, 3))
    for k in range(len(outcomes)):
        n_pairs, fewest = outcomes[k, 1], max(min(sizes[k, 0], sizes[k, 1]), 1)
        alone = 1.0 - n_pairs / max(sizes[k, 0], 1)
        own = shared * n_pairs + sampling / fewest + apart * alone * alone
        own *= 1.0 if outcomes[k, 0] == CONVERGED else unsettled
        for i in range(3):
            for j in range(3):
                whole[k, i, j] = informations[k, i, j] * (variance / own) + known[k, i, j]
    found = inverses(whole)
    for k in range(len(found)):
        found[k, 0, 0] += floor
        found[k, 1, 1] += floor
    return found
