"""Train a network by a recipe: seeded, resumable at any step, on one device or on several through torchrun."""

import csv
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.parallel import DistributedDataParallel

from registration.alignnet import checkpoint, loss, processes
from registration.alignnet.augment import augment
from registration.alignnet.dataset import Batch, PackedPairs, Progress, draw, limited, repeated, to_tensors
from registration.alignnet.errors import TrainingError
from registration.alignnet.network import AlignNet
from registration.alignnet.optimisation import learning_rate, make_optimiser, norm_momentum, set_norm_momentum
from registration.alignnet.recipe import Recipe, to_table
from registration.alignnet.validate import Held, validate

STATE, WEIGHTS, LOG = "state.safetensors", "weights.safetensors", "log.csv"

FREE = ("validate_every", "save_minutes", "threads")  # settings that may change when a training goes on

Score = Callable[[Held], Mapping[str, float]]


@dataclass
class Training:
    """A training that is under way in a folder; `run` starts it, or goes on with it.

    Whatever is random in a step depends on the seed, the epoch and the step alone: a training that was killed
    ends with the same weights as one that was not.

    Attributes:
        recipe: all settings.
        pairs, held_out: what is trained on, and what is only looked at.
        out: folder of `state.safetensors`, `weights.safetensors` and `log.csv`.
        score: makes the columns of the validation table out of held-out errors.
        about: kept with the weights: `data` and `commit` of `checkpoint.About`; what it starts from is added.
        start_from: weights to start with instead of random ones, to fine-tune.
        progress: told what is done, how many batches of how many.
    """

    recipe: Recipe
    pairs: PackedPairs
    held_out: PackedPairs
    out: Path
    score: Score
    about: Mapping[str, Any] = field(default_factory=dict)
    start_from: Path | None = None
    progress: Progress = lambda *_: None  # noqa: E731 - a default that does nothing

    def __post_init__(self) -> None:
        settings = self.recipe.training
        self.rank, self.n_processes = processes.this_process()
        self.device = processes.device()
        self.out.mkdir(parents=True, exist_ok=True)
        if settings.batch_size % self.n_processes:
            raise TrainingError(f"batch_size {settings.batch_size} cannot be shared by {self.n_processes} processes")
        self.index = repeated(self.pairs, settings.near, settings.near_times)  # of the pairs of an epoch
        self.n_steps = len(self.index) // settings.batch_size  # what is left over is dropped
        if self.n_steps == 0:
            raise TrainingError(f"{len(self.index)} pairs make no batch of {settings.batch_size}")
        if settings.threads:
            torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        self.network = AlignNet(self.recipe.network)
        if self.start_from is not None:
            self._start_from(self.start_from)
        self.network.to(self.device)
        self.optimiser = make_optimiser(self.network, self.recipe.optimiser)

    def run(self, stop_after: int | None = None) -> Path:
        """Train to the end; give the path of the weights.

        Args:
            stop_after: end after so many steps in all, with the state on disk.

        Raises:
            TrainingError: the folder holds a training by another recipe, or the loss is no number any more.
            WeightsError: the state on disk is damaged.
        """
        done = self._resume()
        network = self._distributed()
        n_epochs = self.recipe.training.epochs
        end, saved = min(n_epochs * self.n_steps, stop_after or n_epochs * self.n_steps), time.monotonic()
        means = _Means()
        for step, batch in self._batches(done, end):
            means.add(self._step(network, batch, step))
            epoch, position = divmod(step + 1, self.n_steps)
            self.progress("training", step + 1, n_epochs * self.n_steps)
            if position == 0:
                self._end_epoch(epoch, self._checked(means, step))
                means = _Means()
            if position == 0 or step + 1 == end or time.monotonic() - saved > 60.0 * self.recipe.training.save_minutes:
                self._checked(means, step)
                self._save(step + 1)
                saved = time.monotonic()
        processes.meet()
        return self.out / WEIGHTS

    def _checked(self, means: "_Means", step: int) -> dict[str, float]:
        """Give the means since the epoch began, if the loss is a number."""
        values = means.values()
        if not np.isfinite(values.get("loss", 0.0)):
            raise TrainingError(f"{self.out}: the loss is {values['loss']} at step {step + 1}; lower optimiser.rate")
        return values

    def _start_from(self, path: Path) -> None:
        network, about = checkpoint.read_weights(path)
        if about.architecture != self.recipe.network:
            raise TrainingError(f"{path}: is a network of another kind than the recipe's; make [network] the same")
        self.network.load_state_dict(network.state_dict())
        self.about = {**self.about, "started_from": about.fields()}

    def _step(self, network: torch.nn.Module, batch: Batch, step: int) -> dict[str, Tensor]:
        """Follow the gradient of one batch; give the loss and its parts."""
        settings, epoch = self.recipe.optimiser, step / self.n_steps
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(settings, epoch, self.recipe.training.epochs)
        set_norm_momentum(self.network, norm_momentum(settings, epoch))
        torch.manual_seed(_mix(self.recipe.training.seed, step, self.rank))
        (source, target), truths = to_tensors(batch)
        truth_pair = tuple(loss.Truth(*(t.to(self.device) for t in truth)) for truth in truths)
        half = self.recipe.training.precision == "bfloat16"
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=half):
            *encodings, motion = network(source.to(self.device), target.to(self.device))
        value, parts = loss.total(tuple(encodings), motion, truth_pair, self.recipe.loss)  # type: ignore[arg-type]
        self.optimiser.zero_grad(set_to_none=True)
        value.backward()
        if settings.clip > 0.0:
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), settings.clip)
        self.optimiser.step()
        return {"loss": value.detach(), **parts}

    def _batches(self, begin: int, end: int) -> Iterator[tuple[int, Batch]]:
        """Prepare batches in the background, a few ahead."""
        with ThreadPoolExecutor(1 if self.device.type == "cpu" else 8) as pool:
            ahead = 2 if self.device.type == "cpu" else 16
            waiting = {step: pool.submit(self._batch, step) for step in range(begin, min(begin + ahead, end))}
            for step in range(begin, end):
                if step + ahead < end:
                    waiting[step + ahead] = pool.submit(self._batch, step + ahead)
                yield step, waiting.pop(step).result()

    def _batch(self, step: int) -> Batch:
        """Draw and change the pairs of a step: this process' share of the batch."""
        settings = self.recipe.training
        epoch, position = divmod(step, self.n_steps)
        order = np.random.default_rng([settings.seed, epoch]).permutation(self.index)
        index = order[position * settings.batch_size :][self.rank : settings.batch_size : self.n_processes]
        rng = np.random.default_rng([settings.seed, epoch, position, self.rank])
        batch = augment(draw(self.pairs, index, settings.max_points, rng), self.recipe.augment, rng)
        fewest = settings.fewest_points or settings.max_points
        return limited(batch, int(rng.integers(fewest, settings.max_points + 1)), rng)

    def _end_epoch(self, epoch: int, means: dict[str, float]) -> None:
        """Look at the held-out pairs now and then, write the log, and the weights at the end."""
        settings = self.recipe.training
        if self.rank != 0:
            return
        row: dict[str, float] = {"epoch": epoch, "rate": self.optimiser.param_groups[0]["lr"], **means}
        is_last = epoch == settings.epochs
        if is_last or epoch % settings.validate_every == 0:
            held = validate(
                self.network, self.held_out, settings.validation_points, self.recipe.loss.heading_axis, str(self.device)
            )
            table = dict(self.score(held))
            row |= table
            about = checkpoint.About(self.recipe, held.covariance_scale(), table, **self.about)
            checkpoint.write_weights(self.out / (WEIGHTS if is_last else f"latest-{WEIGHTS}"), self.network, about)
        _log(self.out, row)

    def _save(self, step: int) -> None:
        if self.rank == 0:
            fields = {"recipe": to_table(self.recipe), "step": step, "pairs": len(self.pairs)}
            checkpoint.write_state(self.out / STATE, self.network, self.optimiser, fields)

    def _resume(self) -> int:
        """Go on from the state on disk, if there is any; give the number of steps done."""
        path = self.out / STATE
        if not path.is_file():
            return 0
        fields = checkpoint.read_state(path, self.network, self.optimiser)
        if (_binding(fields["recipe"]), fields["pairs"]) != (_binding(to_table(self.recipe)), len(self.pairs)):
            raise TrainingError(f"{path}: is a training by another recipe or on other pairs; choose another folder")
        return int(fields["step"])

    def _distributed(self) -> torch.nn.Module:
        if self.n_processes == 1:
            return self.network
        return DistributedDataParallel(self.network)


class _Means:
    """Means of the parts of the loss over steps; read seldom, since that waits for a GPU."""

    def __init__(self) -> None:
        self._sums: dict[str, Tensor] = {}
        self._n = 0

    def add(self, parts: Mapping[str, Tensor]) -> None:
        self._sums = {name: self._sums.get(name, 0.0) + part for name, part in parts.items()}
        self._n += 1

    def values(self) -> dict[str, float]:
        return {name: float(total) / self._n for name, total in self._sums.items()}


def _mix(seed: int, step: int, rank: int) -> int:
    """Make one seed of torch's out of what a step depends on."""
    return int(np.random.SeedSequence([seed, step, rank, 1]).generate_state(1, np.uint64)[0] >> 1)


def _binding(recipe: Mapping[str, Any]) -> Any:
    """Give what must not change in a training, as it is after JSON, where tuples are lists."""
    training = {name: value for name, value in recipe["training"].items() if name not in FREE}
    return json.loads(json.dumps({**recipe, "training": training}))


def _log(out: Path, row: Mapping[str, float]) -> None:
    """Add a row to the log in CSV and, where TensorBoard is installed, to its own."""
    path = out / LOG
    rows = list(csv.DictReader(path.open(newline=""))) if path.is_file() else []
    kept = [old for old in rows if float(old["epoch"]) < row["epoch"]]  # a resumed training may repeat an epoch
    kept.append({name: f"{value:.6g}" for name, value in row.items()})
    names = list(dict.fromkeys(name for line in kept for name in line))
    unfinished = path.with_name(f"{path.name}.unfinished")
    with unfinished.open("w", newline="") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(kept)
    os.replace(unfinished, path)
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return
    with SummaryWriter(str(out / "tensorboard")) as board:
        for name, value in row.items():
            board.add_scalar(name, value, int(row["epoch"]))
