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
def reference() -> Path:
    """Give the folder with stored answers of the published programs on real data."""
    folder = SHARED / "reference"
    if not folder.is_dir():
        pytest.skip(f"no stored answers at {folder}")
    return folder
