"""Which meshes train, which validate and which test: a fixed rule for files, and ranges of seeds for our own."""

import hashlib
from collections.abc import Sequence

from registration.errors import SimulationError, unknown_name
from registration.synthetic.mesh_files import MeshFile

PARTS = ("train", "val", "test")

# Different members of a parametric family; the seeds of a part follow those of the part before.
N_SHAPES = {"train": 1000, "val": 200, "test": 200}

_CAR_BLACKLIST = (21, 31, 46)
_N_PERSONS = 40
_HOLD_OUT = 5  # of this many files of a flat folder, one validates and one tests

MODELNET_RULE = (
    "by the number in the file's name, as the released code of AlignNet-3D: cars 1-53 without 21, 31, 46 train and "
    "54-103 are held out; persons 1-53 and 54-104, of which the first 40 each (the list of those left out was never "
    "released); others 1-20 and 21-40.  The first half of those held out validates, the second tests: the released "
    "sets used the same meshes for both"
)
FLAT_RULE = (
    "by the rank of the SHA-256 of the file's name within its category: one in five validates (at least one if there "
    "are three files), one in five tests, the others train"
)


def check_part(part: str) -> None:
    """Make sure that a part is one of PARTS.

    Raises:
        SimulationError: it is not.
    """
    if part not in PARTS:
        raise SimulationError(unknown_name("part of the meshes", part, PARTS))


def seed_range(part: str) -> range:
    """Tell which members of a parametric family a part has; no two parts share one.

    Raises:
        SimulationError: no such part.
    """
    check_part(part)
    start = sum(N_SHAPES[earlier] for earlier in PARTS[: PARTS.index(part)])
    return range(start, start + N_SHAPES[part])


def modelnet_numbers(category: str, numbers: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Tell which of a category's numbers each part has, by MODELNET_RULE.

    Args:
        category: of ModelNet40.
        numbers: of the files that there are, in any order.

    Source: AlignNet-3D's released generator; see MODELNET_RULE for where we must differ.
    """
    last_train, last = {"car": (53, 103), "person": (53, 104)}.get(category, (20, 40))
    barred = _CAR_BLACKLIST if category == "car" else ()
    usable = sorted(set(numbers) - set(barred))
    train = [n for n in usable if 1 <= n <= last_train]
    held_out = [n for n in usable if last_train < n <= last]
    if category == "person":
        train, held_out = train[:_N_PERSONS], held_out[:_N_PERSONS]
    half = (len(held_out) + 1) // 2
    return {"train": tuple(train), "val": tuple(held_out[:half]), "test": tuple(held_out[half:])}


def split_modelnet(files: Sequence[MeshFile]) -> dict[str, tuple[MeshFile, ...]]:
    """Divide one category of ModelNet40.

    Raises:
        SimulationError: two files have the same number.
    """
    by_number: dict[int, MeshFile] = {}
    for file in files:
        number = file.number if file.number is not None else 0
        if number in by_number:
            raise SimulationError(f"{file.path}: has the same number as {by_number[number].path}")
        by_number[number] = file
    parts = modelnet_numbers(files[0].category, list(by_number))
    return {part: tuple(by_number[n] for n in numbers) for part, numbers in parts.items()}


def split_flat(files: Sequence[MeshFile]) -> dict[str, tuple[MeshFile, ...]]:
    """Divide one category of any other folder by FLAT_RULE; it depends on the files' names alone."""
    ranked = sorted(files, key=lambda file: (hashlib.sha256(file.path.name.encode()).hexdigest(), str(file.path)))
    held = max(1, len(ranked) // _HOLD_OUT) if len(ranked) >= 3 else 0
    parts = {"val": ranked[:held], "test": ranked[held : 2 * held], "train": ranked[2 * held :]}
    return {part: tuple(parts[part]) for part in PARTS}
