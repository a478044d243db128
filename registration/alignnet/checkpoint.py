"""Files of weights: what ships, and what a training goes on from; whole or not at all, and refused when foreign."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, safe_open, save
from torch import Tensor

from registration.alignnet.errors import RecipeError, WeightsError
from registration.alignnet.network import AlignNet, Architecture
from registration.alignnet.recipe import Recipe, from_table, to_table

WEIGHTS, STATE = "regmot-alignnet-weights", "regmot-alignnet-training"
FORMAT = 1
WEIGHTS_FOLDER = Path(__file__).parent / "weights"


@dataclass(frozen=True)
class About:
    """Where weights come from; kept in the file beside them.

    Attributes:
        recipe: of the training.
        covariance_scale: factor of the predicted covariances, from held-out pairs.
        validation: the paper's table on held-out pairs, by column.
        data: the sets it was trained on: name, seed, and whatever else they say of themselves.
        commit: of the code that trained it.
        started_from: the same fields of the weights that the training began with; empty if those were random.
    """

    recipe: Recipe
    covariance_scale: float = 1.0
    validation: Mapping[str, float] = field(default_factory=dict)
    data: Sequence[Mapping[str, Any]] = ()
    commit: str = "unknown"
    started_from: Mapping[str, Any] = field(default_factory=dict)

    @property
    def architecture(self) -> Architecture:
        """What the network is made of."""
        return self.recipe.network

    def fields(self) -> dict[str, Any]:
        """Give all of it as JSON knows it."""
        return {
            "recipe": to_table(self.recipe),
            "covariance_scale": self.covariance_scale,
            "validation": dict(self.validation),
            "data": list(self.data),
            "commit": self.commit,
            "started_from": dict(self.started_from),
        }


def write_weights(path: Path, network: AlignNet, about: About) -> None:
    """Write weights with where they come from, whole or not at all."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    _write(path, tensors, WEIGHTS, about.fields())


def read_weights(path: Path) -> tuple[AlignNet, About]:
    """Read a network, ready to be used, and where it comes from.

    Raises:
        WeightsError: no such file, or one that is damaged or foreign (no safetensors, not of AlignNet, of another
            format, or whose weights do not fit its own recipe).
    """
    tensors, fields = _read(path, WEIGHTS)
    try:
        about = About(
            recipe=from_table(fields["recipe"], str(path)),
            covariance_scale=float(fields["covariance_scale"]),
            validation=fields["validation"],
            data=tuple(fields["data"] or ()),
            commit=fields["commit"],
            started_from=fields.get("started_from", {}),
        )
    except (KeyError, TypeError, RecipeError) as error:
        raise WeightsError(f"{path}: its recipe cannot be used ({error})") from None
    network = AlignNet(about.architecture)
    _fill(network, tensors, path)
    return network.eval(), about


def write_state(path: Path, network: AlignNet, optimiser: torch.optim.Optimizer, fields: Mapping[str, Any]) -> None:
    """Write all that a training needs to go on, whole or not at all."""
    tensors = {f"network.{name}": tensor.detach().cpu() for name, tensor in network.state_dict().items()}
    for index, slots in optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{slot}": value.detach().cpu() for slot, value in slots.items()}
    _write(path, {name: tensor.contiguous() for name, tensor in tensors.items()}, STATE, fields)


def read_state(path: Path, network: AlignNet, optimiser: torch.optim.Optimizer) -> dict[str, Any]:
    """Bring network and optimiser to where `write_state` left them; give the other fields.

    Raises:
        WeightsError: see `read_weights`.
    """
    tensors, fields = _read(path, STATE)
    of_network: dict[str, Tensor] = {}
    slots: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        owner, _, rest = name.partition(".")
        if owner == "network":
            of_network[rest] = tensor
        else:
            index, _, slot = rest.partition(".")
            slots.setdefault(int(index), {})[slot] = tensor
    _fill(network, of_network, path)
    optimiser.load_state_dict({**optimiser.state_dict(), "state": slots})
    return fields


def shipped(name: str) -> Path:
    """Give the place of the weights that come with the package.

    Raises:
        WeightsError: this installation has none of that name.
    """
    path = WEIGHTS_FOLDER / f"{name}.safetensors"
    if not path.is_file():
        raise WeightsError(
            f"{path}: this installation has no weights for {name!r}; train some (`regmot train cpu --data PAIRS "
            f"--out DIR`) and name them: create({name!r}, weights='DIR/weights.safetensors')"
        )
    return path


def _write(path: Path, tensors: Mapping[str, Tensor], kind: str, fields: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.unfinished")
    metadata = {"kind": kind, "format": str(FORMAT), "fields": json.dumps(fields)}
    try:
        unfinished.write_bytes(save(dict(tensors), metadata=metadata))
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _read(path: Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read tensors and fields; safetensors holds no code, so that a foreign file can do no harm."""
    if not path.is_file():
        raise WeightsError(f"{path}: no such file")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
        if metadata.get("kind") != kind:
            raise WeightsError(f"{path}: expected a file of {kind}, got {metadata.get('kind', 'tensors of others')!r}")
        if metadata.get("format") != str(FORMAT):
            raise WeightsError(f"{path}: expected format {FORMAT}, got {metadata.get('format')}")
        return load(path.read_bytes()), json.loads(metadata["fields"])
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        if isinstance(error, WeightsError):
            raise
        raise WeightsError(f"{path}: no whole safetensors file ({error})") from None


def _fill(network: AlignNet, tensors: Mapping[str, Tensor], path: Path) -> None:
    try:
        network.load_state_dict(dict(tensors))
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise WeightsError(f"{path}: the weights do not fit the network of their recipe ({first})") from None
