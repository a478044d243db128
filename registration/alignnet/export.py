"""The network as graphs that run without this package, by torch.export."""

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from registration.alignnet.folding import fold
from registration.alignnet.network import AlignNet, Encoding
from registration.alignnet.ragged import Clouds

OUTPUTS = ("center", "moved_center", "turn", "heading", "precision")


class Encode(nn.Module):
    """The part that is run once for each cloud: ragged points in, `network.Encoding` out, field by field."""

    def __init__(self, network: AlignNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, points: Tensor, cloud: Tensor, n_seen: Tensor, sensor: Tensor) -> tuple[Tensor, ...]:
        """Encode b clouds of n points in all."""
        return tuple(self.network.encode(Clouds(points, cloud, n_seen, sensor)))


class Align(nn.Module):
    """The part that is run once for each pair: two encodings in, OUTPUTS out."""

    def __init__(self, network: AlignNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, source: tuple[Tensor, ...], target: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """Compare b pairs of encodings."""
        motion = self.network.align(Encoding(*source), Encoding(*target))
        return tuple(getattr(motion, name) for name in OUTPUTS)


def export(network: AlignNet) -> tuple[ExportedProgram, ExportedProgram]:
    """Export both parts, folded, in float32, for any numbers of points and clouds.

    Args:
        network: trained; with one batch norm for both clouds of a pair.

    Returns:
        the graphs of `Encode` and of `Align`.
    """
    folded = fold(network)
    clouds = _example()
    n, b = Dim("n_points", min=1), Dim("n_clouds", min=1)
    rows = tuple({0: axis} for axis in (n, n, b, b))
    encode = torch.export.export(Encode(folded), tuple(clouds), dynamic_shapes=rows)
    source = tuple(folded.encode(clouds))
    target = tuple(field.clone() for field in source)  # the same tensor twice would be taken for one input
    pairs = tuple({0: Dim("n_pairs", min=1)} for _ in source)
    align = torch.export.export(Align(folded), (source, target), dynamic_shapes=(pairs, pairs))
    return encode, align


def write(network: AlignNet, folder: Path) -> tuple[Path, Path]:
    """Write both graphs as `encode.pt2` and `align.pt2`."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / "encode.pt2", folder / "align.pt2"
    for program, path in zip(export(network), paths, strict=True):
        unfinished = path.with_name(f"unfinished-{path.name}")
        torch.export.save(program, unfinished)
        unfinished.replace(path)
    return paths


def _example() -> Clouds:
    generator = torch.Generator().manual_seed(0)
    return Clouds(
        points=torch.randn(50, 3, generator=generator),
        cloud=torch.arange(5).repeat_interleave(10),
        n_seen=torch.full((5,), 10.0),
        sensor=torch.tensor([[-10.0, 1.0]]).repeat(5, 1),
    )
