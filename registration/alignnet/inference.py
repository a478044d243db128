"""The network made fast, on a CPU: clouds unpadded, wide layers by oneDNN, all between them in compiled loops.

It says once more what `network.AlignNet` says, for arrays instead of tensors: of a few objects, small tensors' own
costs are most of the time.  Batch norm is folded away; wide layers are in bfloat16 where the CPU knows it.
"""

import threading
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int16, Int64
from torch import Tensor, nn

from registration.alignnet import checkpoint, inference_kernels
from registration.alignnet.answers import Answers
from registration.alignnet.checkpoint import About
from registration.alignnet.inference_kernels import CONTEXT_NUMBERS, FRAME_NUMBERS
from registration.alignnet.layers import Head, NormalisedLinear, PointEncoder
from registration.alignnet.network import AlignNet
from registration.alignnet.packing import thinned
from registration.alignnet.products import FoldedLinear
from registration.neighbours import pack_arrays
from registration.types import Points

LIKE_SIZED = 64  # points: batches have some multiple of it
MADE_BEFORE = 32  # up to so many rows, or so many times LIKE_SIZED points, oneDNN's programs are made with the network

PRECISIONS = ("auto", "float32", "bfloat16")

Pose = Float64[np.ndarray, "4"]
Stored = Int16[np.ndarray, "..."] | Float32[np.ndarray, "..."]  # bits of bfloat16, or float32
Frames = Float64[np.ndarray, "b 8"]  # see `inference_kernels`
Context = Float64[np.ndarray, "b 4"]
Begin = Int64[np.ndarray, " _"]  # cloud k is rows begin[k] to begin[k + 1]


class Encoding(NamedTuple):
    """What the network knows of one cloud.

    Attributes:
        pose: the object's centre, by T-FineNet, relative to the cloud's own origin, and its heading [m, rad].
        embedding: of the cloud in the object's axes.
    """

    pose: Pose
    embedding: Stored


class Room(threading.local):
    """What is multiplied, always in the same place, as NumPy and as torch know it; each thread has its own.

    Telling one of an array of the other takes as long as filling it, for a few objects.

    Args:
        columns: of it.
        dtype: float32 or bfloat16.
        most: rows that are kept.
    """

    def __init__(self, columns: int, dtype: torch.dtype, most: int) -> None:
        self._all, self._most = torch.zeros((most, columns), dtype=dtype), most
        self._parts: dict[int, tuple[Stored, Tensor]] = {}

    def rows(self, n: int) -> tuple[Stored, Tensor]:
        """Give the first n rows; what they hold is of earlier calls, or 0."""
        if n > self._most:
            part = torch.zeros((n, self._all.shape[1]), dtype=self._all.dtype)
            return _numbers(part), part
        if n not in self._parts:
            part = self._all[:n]
            self._parts[n] = _numbers(part), part
        return self._parts[n]


class Stage:
    """A `PointEncoder`, with the first layer in float32: bfloat16 knows 4 m to 2 cm only."""

    def __init__(self, encoder: PointEncoder, dtype: torch.dtype, branch: int = 0) -> None:
        first, *middle, last = encoder.normalised()
        self.first = _arrays(FoldedLinear(first, torch.float32, branch, pack=False))
        self.middle = [FoldedLinear(layer, dtype, branch) for layer in middle]
        self.last = FoldedLinear(last, dtype, branch)
        self.bias = _arrays(FoldedLinear(last, torch.float32, branch, pack=False))[1]
        self.room = Room(len(self.first[1]), dtype, LIKE_SIZED * MADE_BEFORE)

    def pooled(self, points: Points, begin: Begin, frames: Frames, context: Context, first: int) -> Stored:
        """Encode clouds in their axes; what they are told beside their points, from `first` on, comes behind that."""
        layer, same = self.room.rows(LIKE_SIZED * like_sized(-(-len(points) // LIKE_SIZED)))
        inference_kernels.first_layer(points, begin, frames, *self.first, layer)
        features = np.empty((len(frames), len(self.bias) + context.shape[1] - first), dtype=layer.dtype)
        inference_kernels.pool(self.product(same), begin, self.bias, context, first, features)
        return features

    def product(self, layer: Tensor) -> Stored:
        """Give the features of points (n, d), before the last bias and activation, from those of the first layer."""
        for folded in self.middle:
            layer = folded.forward(layer)  # (n, 128)
        return _numbers(self.last.product(layer))


class Dense:
    """A layer of a head that sees one row a cloud: few of them, for which a compiled loop is faster than oneDNN."""

    def __init__(self, layer: NormalisedLinear, dtype: torch.dtype, branch: int = 0) -> None:
        self.weight = np.ascontiguousarray(_numbers(FoldedLinear(layer, dtype, branch, pack=False).weight).T)
        self.bias = _arrays(FoldedLinear(layer, torch.float32, branch, pack=False))[1]

    def forward(self, features: Stored) -> Stored:
        """Map and rectify a batch."""
        found = np.empty((len(features), len(self.bias)), dtype=self.weight.dtype)
        inference_kernels.dense(features, self.weight, self.bias, found)
        return found


class Answering:
    """A `Head` that sees a row a cloud, but for what its last layer's numbers mean."""

    def __init__(self, head: Head, dtype: torch.dtype, branch: int = 0) -> None:
        self.layers = [Dense(layer, dtype, branch) for layer in head.normalised()]
        self.output = _arrays(FoldedLinear(head.output, torch.float32, pack=False))

    def hidden(self, features: Stored) -> Stored:
        """Give the features before the last layer."""
        for layer in self.layers:
            features = layer.forward(features)  # (b, 512), (b, 256)
        return features


class AnsweringPairs:
    """A `Head` that sees a row a pair, of which there are several a cloud; last layers lie beside each other."""

    def __init__(self, head: Head, dtype: torch.dtype, *beside: nn.Linear) -> None:
        self.layers = [FoldedLinear(layer, dtype) for layer in head.normalised()]
        weights, biases = zip(
            *(_arrays(FoldedLinear(each, torch.float32, pack=False)) for each in (head.output, *beside)), strict=True
        )
        self.output = np.concatenate(weights, axis=1), np.concatenate(biases)
        self.room = Room(head.normalised()[0].weight.shape[1], dtype, MADE_BEFORE)

    def hidden(self, features: Tensor) -> Stored:
        """Give the features before the last layer."""
        for layer in self.layers:
            features = layer.forward(features)  # (m, 512), (m, 256)
        return _numbers(features)


class Inference:
    """`AlignNet` for arrays.

    Args:
        network: trained; it stays as it is.
        dtype: of the wide layers, float32 or bfloat16; coordinates, the first layer of points and the last of heads
            are in float32 and more.
        branch: whose batch norm, where each cloud of a pair has its own.
    """

    def __init__(self, network: AlignNet, dtype: torch.dtype = torch.float32, branch: int = 0) -> None:
        network = network.eval()
        precision = () if network.precision is None else (network.precision,)
        self.architecture = network.architecture
        self.coarse, self.fine = Stage(network.coarse, dtype, branch), Stage(network.fine, dtype, branch)
        self.embedding = Stage(network.embedding, dtype, branch)
        self.coarse_head = Answering(network.coarse_head, dtype, branch)
        self.fine_head = Answering(network.fine_head, dtype, branch)
        self.final_head = AnsweringPairs(network.final_head, dtype, *precision)
        self._make_programs()

    def _make_programs(self) -> None:
        """Let oneDNN make its programs, in a tenth of a second, so that no frame waits for them; see `like_sized`."""
        for n in sorted({like_sized(n) for n in range(1, MADE_BEFORE + 1)}):
            for stage in (self.coarse, self.fine, self.embedding):
                stage.product(stage.room.rows(LIKE_SIZED * n)[1])
            self.final_head.hidden(self.final_head.room.rows(n)[1])

    def encode(
        self,
        clouds: Sequence[Points],
        origins: Float64[np.ndarray, "b 3"],
        sensors: Float64[np.ndarray, "b 2"],
        max_points: int,
    ) -> list[Encoding]:
        """Do all that depends on one cloud only; see `AlignNet.encode`.

        Args:
            clouds: b of them, of one point at least, in any axes with z up [m].
            origins: one near each cloud, in the same axes [m].
            sensors: where each was seen from (x, y), in the same axes [m].
            max_points: of a cloud that are looked at, evenly out of all.
        """
        points, begin = pack_arrays([thinned(cloud, max_points) for cloud in clouds])
        frames, context = np.empty((len(clouds), FRAME_NUMBERS)), np.empty((len(clouds), CONTEXT_NUMBERS))
        points, n_seen = np.ascontiguousarray(points), np.array([len(cloud) for cloud in clouds])
        inference_kernels.see(points, begin, sensors, n_seen, self.architecture.view_axes, frames, context)
        told, all_told = (2, 0) if self.architecture.sensor_context else (CONTEXT_NUMBERS, CONTEXT_NUMBERS)
        for stage, head in ((self.coarse, self.coarse_head), (self.fine, self.fine_head)):
            hidden = head.hidden(stage.pooled(points, begin, frames, context, told))  # heads know no direction
            inference_kernels.move(hidden, *head.output, self.architecture.translation_dims, frames, context)
        embeddings = self.embedding.pooled(points, begin, frames, context, all_told)
        poses = frames[:, [0, 1, 2, 5]]
        poses[:, :3] -= origins
        return list(map(Encoding, poses, embeddings))

    def align(self, sources: Sequence[Encoding], targets: Sequence[Encoding], scale: float) -> Answers:
        """Compare m pairs of encodings, one at least; see `AlignNet.align`.

        Args:
            sources, targets: the encodings.
            scale: factor of the covariances, from held-out pairs.
        """
        m, a = len(sources), self.architecture
        features, same = self.final_head.room.rows(like_sized(m))  # those beyond the last pair are of no one
        both = [each.embedding for pair in zip(sources, targets, strict=True) for each in pair]
        np.concatenate(both, out=features[:m].reshape(-1))
        poses = np.array([each.pose for side in (sources, targets) for each in side]).reshape(2, m, -1)
        motions, covariances = np.empty((m, 7)), np.empty((m, 3, 3))
        inference_kernels.compare(
            self.final_head.hidden(same)[:m],
            *self.final_head.output,
            a.translation_dims,
            a.composition == "composed",
            6 if a.covariance else 0,
            float(scale),
            *poses,
            motions,
            covariances,
        )
        return Answers(motions, covariances)


def like_sized(n: int) -> int:
    """Give the next of 1 to 8, 10, 12, 14, 16, 20, 24, 28, 32, 40 and so on.

    oneDNN makes a program for each new number of rows, which takes longer than running it ten times: there are to be
    few such numbers.
    """
    step = 1 << max((n - 1).bit_length() - 3, 0)
    return -(-n // step) * step


def best_dtype(precision: str = "auto") -> torch.dtype:
    """Give the number type of a precision; `auto` is bfloat16 where the CPU multiplies it in hardware.

    Raises:
        ValueError: no such precision.
    """
    if precision not in PRECISIONS:
        raise ValueError(f"precision must be one of {', '.join(PRECISIONS)}, got {precision!r}")
    has_it = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return torch.bfloat16 if precision == "bfloat16" or (precision == "auto" and has_it) else torch.float32


def load(path: Path, precision: str = "auto") -> tuple[list[Inference], About]:
    """Read weights and fold them, once for each file: a network for the source, and one for the target.

    They are the same one unless each cloud of a pair has its own batch norm.

    Raises:
        WeightsError: see `checkpoint.read_weights`.
    """
    try:
        written = path.stat().st_mtime_ns
    except OSError:
        written = 0  # reading it will say what is wrong
    return _load(path, written, best_dtype(precision))


@lru_cache(maxsize=8)
def _load(path: Path, written: int, dtype: torch.dtype) -> tuple[list[Inference], About]:
    network, about = checkpoint.read_weights(path)
    n_branches = 2 if about.architecture.branch_norms else 1
    return [Inference(network, dtype, branch) for branch in range(n_branches)], about


def _arrays(layer: FoldedLinear) -> tuple[Float32[np.ndarray, "d_in d_out"], Float32[np.ndarray, " d_out"]]:
    return np.ascontiguousarray(layer.weight.numpy().T), layer.bias.numpy()


def _numbers(features: Tensor) -> Stored:
    """Give the array that a tensor is of: bits of bfloat16, which NumPy does not know, or float32."""
    return (features.view(torch.int16) if features.dtype is torch.bfloat16 else features).numpy()
