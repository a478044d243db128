"""Importing the packages is light, and the import-direction contracts are what the configuration says."""

import subprocess
import sys
from pathlib import Path

HEAVY = ("torch", "open3d", "cv2", "pandas", "small_gicp")


def test_importing_the_packages_loads_no_heavy_library(tmp_path):
    for name in HEAVY:  # a library that must not be loaded breaks whoever loads it
        (tmp_path / f"{name}.py").write_text(f"raise RuntimeError('{name} was imported')\n")
    script = "import registration, tracker, tracker.pipeline, evaluation, evaluation.compare, regmot.cli"
    environment = {"PYTHONPATH": str(tmp_path), "PATH": ""}
    subprocess.run([sys.executable, "-c", script], check=True, env=environment, cwd=tmp_path)


def test_scripts_is_no_package_of_anyones_site_packages(tmp_path):
    script = "import importlib.util as u; print(u.find_spec('regmot').origin, u.find_spec('scripts'))"
    found = subprocess.run([sys.executable, "-c", script], check=True, cwd=tmp_path, capture_output=True, text=True)
    origin, scripts = found.stdout.split()
    assert Path(origin).parent.name in ("scripts", "regmot")
    assert scripts == "None"
