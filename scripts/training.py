"""What `regmot train` puts together: a recipe, sets of pairs, and the paper's table of the held-out ones."""

import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluation.registration_error import LEVELS, score
from registration.alignnet import checkpoint, dataset, processes
from registration.alignnet.dataset import Progress
from registration.alignnet.recipe import Recipe, read_recipe
from registration.alignnet.train import Training
from registration.alignnet.validate import Held
from registration.pair_set import ABOUT, PairSet

RANGES_M = (80, 20, 5)
SHARES = ("share_2cm_1deg", "share_10cm_5deg", "share_20cm_10deg")


@dataclass(frozen=True)
class Plan:
    """What is to be trained, and on what."""

    recipe: Recipe
    sets: tuple[PairSet, ...]


def plan(recipe: str, settings: Sequence[str], folders: Sequence[Path], mirrored_angles: bool) -> Plan:
    """Read the recipe and open the sets.

    Raises:
        RecipeError, PairSetError: one of them cannot be used; the message says which.
    """
    sets = tuple(PairSet(folder, mirrored_angles) for folder in folders)
    return Plan(read_recipe(recipe, settings), sets)


def run(plan: Plan, out: Path, start_from: Path | None, progress: Progress) -> Path:
    """Read the pairs, train, and give the path of the weights."""
    if not processes.is_first():
        progress = _quiet
    with processes.first_alone():
        parts = {
            part: dataset.join(
                [dataset.pack(pairs, part, out / f"pairs-{k}-{part}", progress) for k, pairs in enumerate(plan.sets)]
            )
            for part in ("train", "val")
        }
    training = Training(
        recipe=plan.recipe,
        pairs=parts["train"],
        held_out=parts["val"],
        out=out,
        score=columns,
        about={"data": tuple(_about(pairs.folder) for pairs in plan.sets), "commit": commit()},
        start_from=start_from,
        progress=progress,
    )
    return training.run()


def is_first() -> bool:
    """Say whether this is the process that talks, of several that torchrun has started."""
    return processes.is_first()


def columns(held: Held) -> Mapping[str, float]:
    """Make the paper's columns for each range, and how well the covariances fit."""
    row: dict[str, float] = {}
    for range_m in RANGES_M:
        found = score(held.errors[held.distance < range_m])
        row |= {f"{name}_{range_m}m": getattr(found, name) for name in ("n", *SHARES, "rmse_t", "rmse_r_deg")}
    row["covariance_scale"] = held.covariance_scale()
    return row


def table(weights: Path) -> tuple[list[str], list[list[str]]]:
    """Give the validation table that weights carry with them, as header and body."""
    validation = checkpoint.read_weights(weights)[1].validation
    header = ["range", "n", *(f"< {t * 100:g} cm, {deg:g} deg" for t, deg in LEVELS), "RMSE t [m]", "RMSE R [deg]"]
    body = []
    for range_m in RANGES_M:
        shares = [f"{100 * validation[f'{name}_{range_m}m']:.2f} %" for name in SHARES]
        errors = [f"{validation[f'{name}_{range_m}m']:.3f}" for name in ("rmse_t", "rmse_r_deg")]
        body.append([f"< {range_m} m", f"{validation[f'n_{range_m}m']:g}", *shares, *errors])
    return header, body


def commit() -> str:
    """Name the code's commit, with a plus where the working tree differs; `unknown` outside a repository."""
    folder = Path(__file__).resolve().parent
    try:
        asked = ("git", "-C", str(folder), "describe", "--always", "--dirty=+", "--abbrev=12")
        return subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _about(folder: Path) -> dict[str, Any]:
    """Give what a set says of itself; at least the folder's name."""
    path = folder / ABOUT
    return {"name": folder.name, **(json.loads(path.read_text()) if path.is_file() else {})}


def _quiet(what: str, done: int, total: int | None) -> None:
    """Say nothing: of several processes only the first talks."""
