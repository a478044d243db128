"""Compiled loops of the network between its products: axes, first layers, maxima, and what the heads' numbers mean.

Features are bits of bfloat16 (int16), which NumPy does not know, or float32; the compiler drops the other case.

Lines of `frames`, which has one for each cloud: where the axes that its points are said in have their origin, cosine,
sine and angle of their heading, and the direction of sight.  `context` has what the heads are told beside points: the
sensor's direction in these axes, range and number of points.
"""

import math
import typing

import numpy as np
from numba import njit

TURN = 2.0 * np.pi
FRAME_NUMBERS, CONTEXT_NUMBERS, POSE_NUMBERS = 8, 4, 4
HALF = 2  # bytes of a bfloat16
LOWEST_RANGE = 1e-12  # of an object [m]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
@typing.no_type_check
def _to_bits(value):
    """Give the bits of the bfloat16 that is nearest to a float32."""
    bits = np.float32(value).view(np.uint32)
    return np.int16(np.uint32(bits + np.uint32(0x7FFF) + np.uint32((bits >> np.uint32(16)) & np.uint32(1))) >> 16)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
@typing.no_type_check
def _from_bits(bits):
    """Give the float32 of a bfloat16's bits."""
    return np.uint32(np.uint32(np.uint16(bits)) << np.uint32(16)).view(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def see(points, begin, sensors, n_seen, along_sight, frames, context):  # noqa: PLR0913
    """Say each cloud about its mean; along the line of sight, or in the axes it came in.

    Args:
        points: (n, 3) float64 [m].
        begin: (b + 1,); cloud k is rows begin[k] to begin[k + 1], one at least.
        sensors: (b, 2) [m].
        n_seen: (b,); points of each cloud before any were left out.
        along_sight: whether axes look along the line of sight.
        frames: (b, FRAME_NUMBERS), written.
        context: (b, CONTEXT_NUMBERS), written.
    """
    for k in range(len(begin) - 1):
        n = begin[k + 1] - begin[k]
        for axis in range(3):
            total, first = 0.0, points[begin[k], axis]  # sums of small numbers keep their digits
            for i in range(begin[k], begin[k + 1]):
                total += points[i, axis] - first
            frames[k, axis] = first + total / n
        x, y = frames[k, 0] - sensors[k, 0], frames[k, 1] - sensors[k, 1]
        distance = math.sqrt(x * x + y * y)
        frames[k, 6], frames[k, 7] = x / max(distance, LOWEST_RANGE), y / max(distance, LOWEST_RANGE)
        frames[k, 5] = math.atan2(y, x) if along_sight else 0.0
        context[k, 2] = math.log1p(distance) - 3.0
        context[k, 3] = math.log1p(n_seen[k]) - 5.0
        _face(frames, context, k)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _face(frames, context, k):
    c, s = math.cos(frames[k, 5]), math.sin(frames[k, 5])
    frames[k, 3], frames[k, 4] = c, s
    context[k, 0] = -c * frames[k, 6] - s * frames[k, 7]
    context[k, 1] = s * frames[k, 6] - c * frames[k, 7]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def first_layer(points, begin, frames, weight, bias, features):  # noqa: PLR0913
    """Say points in the axes of their clouds, map and rectify them; rows beyond the last point become zeros.

    Args:
        points: (n, 3) float64 [m].
        begin: (b + 1,).
        frames: (b, FRAME_NUMBERS).
        weight: (3, d) float32.
        bias: (d,) float32.
        features: (n or more, d) bits or float32, written.
    """
    d, zero = weight.shape[1], np.float32(0.0)
    for k in range(len(begin) - 1):
        c, s = frames[k, 3], frames[k, 4]
        for i in range(begin[k], begin[k + 1]):
            east, north = points[i, 0] - frames[k, 0], points[i, 1] - frames[k, 1]
            x, y = np.float32(c * east + s * north), np.float32(c * north - s * east)
            z = np.float32(points[i, 2] - frames[k, 2])
            for j in range(d):
                value = max(weight[0, j] * x + weight[1, j] * y + weight[2, j] * z + bias[j], zero)
                features[i, j] = _to_bits(value) if features.itemsize == HALF else value
    features[begin[-1] :] = 0


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def pool(product, begin, bias, context, first, features):  # noqa: PLR0913
    """Give the largest of each feature over each cloud, with bias and ReLU, which do not change which one that is.

    Bits of positive bfloat16 numbers are in order as integers, and those of negative ones in the opposite order, below
    them: the largest number is the largest integer, or the smallest one if all are negative.

    Args:
        product: (n or more, d) bits or float32.
        begin: (b + 1,); no cloud is empty.
        bias: (d,) float32.
        context: (b, CONTEXT_NUMBERS), of which the columns from `first` on go behind the features.
        first: see there.
        features: (b, d + columns) bits or float32, written.
    """
    d, zero = product.shape[1], np.float32(0.0)
    best, lowest, values = np.empty(d, product.dtype), np.empty(d, product.dtype), np.empty(d, np.float32)
    for k in range(len(begin) - 1):
        for j in range(d):
            best[j] = lowest[j] = product[begin[k], j]
        for i in range(begin[k] + 1, begin[k + 1]):
            for j in range(d):
                best[j] = max(best[j], product[i, j])
                lowest[j] = min(lowest[j], product[i, j])
        for j in range(d):
            most = best[j] if best[j] >= 0 or product.itemsize != HALF else lowest[j]
            values[j] = max((_from_bits(most) if product.itemsize == HALF else np.float32(most)) + bias[j], zero)
        _store(values, features, k, 0)
        _store(context[k, first:].astype(np.float32), features, k, d)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _store(values, features, k, first):
    """Put float32 values into a row of features, from a column on."""
    if features.itemsize == HALF:
        for j in range(len(values)):
            features[k, first + j] = _to_bits(values[j])
    else:
        for j in range(len(values)):
            features[k, first + j] = values[j]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def dense(features, weight, bias, found):
    """Map and rectify a few rows; oneDNN, whose caches others have emptied, takes longer to call than this to compute.

    Args:
        features: (b, d_in) bits or float32.
        weight: (d_in, d_out), the same.
        bias: (d_out,) float32.
        found: (b, d_out) bits or float32, written.
    """
    n, zero = features.shape[0], np.float32(0.0)
    sums = np.empty((n, weight.shape[1]), np.float32)
    for k in range(n):
        sums[k] = bias
    for i in range(features.shape[1]):
        for k in range(n):
            value = _from_bits(features[k, i]) if features.itemsize == HALF else np.float32(features[k, i])
            if value != zero:  # as half of them are, after a ReLU
                _add_row(sums, k, value, weight, i)
    for k in range(n):
        _store(np.maximum(sums[k], zero), found, k, 0)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
@typing.no_type_check
def _add_row(sums, k, value, weight, i):
    if weight.itemsize == HALF:
        for j in range(weight.shape[1]):
            sums[k, j] += value * _from_bits(weight[i, j])
    else:
        for j in range(weight.shape[1]):
            sums[k, j] += value * weight[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _outputs(hidden, weight, bias):
    """Give the last layer's numbers (b, d_out) float32, of hidden features (b, d) and a weight (d, d_out)."""
    out = np.empty((hidden.shape[0], weight.shape[1]), np.float32)
    for k in range(hidden.shape[0]):
        out[k] = bias
        for i in range(hidden.shape[1]):
            value = _from_bits(hidden[k, i]) if hidden.itemsize == HALF else np.float32(hidden[k, i])
            for j in range(weight.shape[1]):
                out[k, j] += value * weight[i, j]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _angle(numbers, k, first, n_bins):
    """Give the angle of the likeliest bin and its residual, in [-pi, pi): see `angles.decode`."""
    likeliest = 0
    for j in range(1, n_bins):
        if numbers[k, first + j] > numbers[k, first + likeliest]:
            likeliest = j
    return _wrap((2.0 * likeliest + numbers[k, first + n_bins + likeliest]) * np.pi / n_bins)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _wrap(angle):
    return (angle + np.pi) % TURN - np.pi


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def move(hidden, weight, bias, dims, frames, context):  # noqa: PLR0913
    """Move the axes to where a head sees the object, and turn them if it tells a heading, too.

    Args:
        hidden: (b, d) bits or float32.
        weight: (d, d_out) float32.
        bias: (d_out,) float32.
        dims: of the shift; what follows it in the output are bins and residuals of a heading.
        frames: (b, FRAME_NUMBERS), changed.
        context: (b, CONTEXT_NUMBERS), changed.
    """
    numbers = _outputs(hidden, weight, bias)
    n_bins = (numbers.shape[1] - dims) // 2
    for k in range(len(frames)):
        c, s, x, y = frames[k, 3], frames[k, 4], numbers[k, 0], numbers[k, 1]
        frames[k, 0] += c * x - s * y
        frames[k, 1] += s * x + c * y
        frames[k, 2] += numbers[k, 2] if dims > 2 else 0.0  # noqa: PLR2004 - z is the third
        if n_bins:
            frames[k, 5] += _angle(numbers, k, dims, n_bins)
            _face(frames, context, k)


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def compare(hidden, weight, bias, dims, is_composed, n_precision, scale, sources, targets, motions, covariances):  # noqa: PLR0913
    """Compose what the last head leaves of motions with the poses of both clouds.

    Args:
        hidden: (m, d) bits or float32.
        weight: (d, d_out) float32.
        bias: (d_out,) float32.
        dims: of the shift; bins and residuals of the turn follow it, and then numbers of the precision.
        is_composed: shifts are in the target's canonical axes, else in the sensor's.
        n_precision: 6, or 0 where the network predicts none.
        scale: factor of the covariances.
        sources, targets: (m, POSE_NUMBERS): centre and heading, in each cloud.
        motions: (m, 7), written: the centre in the source, in the target, and the turn.
        covariances: (m, 3, 3), written: of (x, y, yaw) about the centre; NaN where none is predicted.
    """
    numbers = _outputs(hidden, weight, bias)
    n_bins = (numbers.shape[1] - dims - n_precision) // 2
    for k in range(len(numbers)):
        x, y, heading = float(numbers[k, 0]), float(numbers[k, 1]), targets[k, 3]
        if is_composed:
            c, s = math.cos(heading), math.sin(heading)
            x, y = c * x - s * y, s * x + c * y
        motions[k, 0], motions[k, 1], motions[k, 2] = sources[k, 0], sources[k, 1], sources[k, 2]
        motions[k, 3], motions[k, 4] = targets[k, 0] + x, targets[k, 1] + y
        motions[k, 5] = targets[k, 2] + (numbers[k, 2] if dims > 2 else 0.0)  # noqa: PLR2004 - z is the third
        motions[k, 6] = _wrap(heading - sources[k, 3] + _angle(numbers, k, dims, n_bins))
        if n_precision:
            _spread(numbers, k, numbers.shape[1] - n_precision, sources[k, 3], scale, covariances)
        else:
            covariances[k] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def judge(motions, covariances, expected, are_folded, farthest, widest):  # noqa: PLR0913
    """Say where the network does not know, or contradicts the clouds (m); fold turns to what is expected.

    Args:
        motions: see `compare` (m, 7); turns become those, or half a turn more or less, that are nearest to `expected`.
        covariances: (m, 3, 3).
        expected: turns (m) [rad].
        are_folded: whether front and back do not differ; else turns stay as they are.
        farthest: that an object's centre may be from the mean of its points, along x or y in either cloud [m].
        widest: largest standard deviation of the shift, in any direction, of an answer [m].
    """
    is_doubtful = np.empty(len(motions), np.bool_)
    for k in range(len(motions)):
        if are_folded:
            off = (motions[k, 6] - expected[k] + 0.5 * np.pi) % np.pi - 0.5 * np.pi
            motions[k, 6] = np.pi - (np.pi - expected[k] - off) % TURN
        centers = max(abs(motions[k, 0]), abs(motions[k, 1])), max(abs(motions[k, 3]), abs(motions[k, 4]))
        xx, xy, yy = covariances[k, 0, 0], covariances[k, 0, 1], covariances[k, 1, 1]
        variance = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)  # NaN where none is predicted: no doubt
        is_doubtful[k] = max(centers) > farthest or variance > widest**2
    return is_doubtful


@njit(cache=True, nogil=True, error_model="numpy")
@typing.no_type_check
def _spread(numbers, k, first, heading, scale, covariances):  # noqa: PLR0913
    """Give the covariance of a precision's six numbers (see `loss.precision_factor`), turned by a heading."""
    xx = 10.0 * math.exp(min(max(float(numbers[k, first]), -6.0), 6.0))
    yy = 10.0 * math.exp(min(max(float(numbers[k, first + 1]), -6.0), 6.0))
    tt = 10.0 * math.exp(min(max(float(numbers[k, first + 2]), -6.0), 6.0))
    xy, xt, yt = 10.0 * numbers[k, first + 3], 10.0 * numbers[k, first + 4], 10.0 * numbers[k, first + 5]
    root = np.zeros((3, 3))  # the inverse of the factor, turned
    root[0, 0], root[1, 1], root[2, 2] = 1.0 / xx, 1.0 / yy, 1.0 / tt
    root[0, 1] = -xy / (xx * yy)
    root[1, 2] = -yt / (yy * tt)
    root[0, 2] = (xy * yt - xt * yy) / (xx * yy * tt)
    c, s = math.cos(heading), math.sin(heading)
    for j in range(3):
        root[0, j], root[1, j] = c * root[0, j] - s * root[1, j], s * root[0, j] + c * root[1, j]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for n in range(3):
                total += root[i, n] * root[j, n]
            covariances[k, i, j] = scale * total
