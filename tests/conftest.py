"""What all tests share: seeded hypothesis, and the way to real data where there is any."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

SHARED = Path(__file__).resolve().parents[2] / "shared"

# The same examples in every run, and no failure because a machine is slow.
settings.register_profile("suite", derandomize=True, deadline=None)
settings.load_profile("suite")


@pytest.fixture(scope="session")
def kitti_root() -> Path:
    """Give the real tracking folder: REGMOT_KITTI, or the one beside the project."""
    root = Path(os.environ.get("REGMOT_KITTI", SHARED / "data" / "kitti_tracking"))
    if not (root / "training" / "label_02").is_dir():
        pytest.skip(f"no KITTI tracking folder at {root} (set REGMOT_KITTI)")
    return root


@pytest.fixture(scope="session")
def real_labels(kitti_root: Path) -> dict:
    """Give all real labels, by sequence: reading them takes seconds."""
    from tracker.kitti.labels import read_labels  # here: what conftest imports at its top is not checked for shapes

    return {path.stem: read_labels(path) for path in sorted((kitti_root / "training" / "label_02").glob("*.txt"))}


@pytest.fixture(scope="session")
def reference() -> Path:
    """Give the folder with stored answers of the published programs on real data."""
    folder = SHARED / "reference"
    if not folder.is_dir():
        pytest.skip(f"no stored answers at {folder}")
    return folder
