"""An outside package announces a method by entry point; it is installed for real and used by name."""

import os
import subprocess
import sys
from pathlib import Path

PYPROJECT = """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "tiny-plugin"
version = "1.0"

[project.entry-points."registration.methods"]
halfway = "tiny_plugin:Halfway"
broken = "tiny_plugin_that_is_not_there:Nothing"

[tool.setuptools]
py-modules = ["tiny_plugin"]
"""

MODULE = '''
"""A registration method of an outside author: the centroids' shift, by its own code."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from registration import PairMethod, RegistrationResult, Status


@dataclass(frozen=True)
class Halfway(PairMethod):
    """Shift centroids."""

    name: ClassVar[str] = "halfway"
    sigma: float = 0.5  # standard deviation that it claims [m]

    def prepare_cloud(self, points):
        return points

    def align_pair(self, source, target, prior):
        T = np.eye(4)
        enough = len(source) > 0 and len(target) > 0
        if enough:
            T[:3, 3] = target.mean(axis=0) - source.mean(axis=0)
        center = source.mean(axis=0) if len(source) else np.zeros(3)
        status = Status.CONVERGED if enough else Status.TOO_FEW_POINTS
        return RegistrationResult(T, center, self.sigma**2 * np.eye(3), status, float("nan"), 0)
'''

USE = """
import numpy as np, registration
from tracker.estimators import create_estimator
method = registration.create("halfway", sigma=0.25)
registration.check_method(method)
cloud = np.random.default_rng(0).normal(size=(50, 3))
result = method.register(cloud, cloud + [0.5, 0.0, 0.0])
assert abs(result.T_target_source[0, 3] - 0.5) < 1e-9 and result.covariance[0, 0] == 0.0625
assert create_estimator("halfway").name == "halfway"
try:
    registration.create("broken")
except registration.RegistrationError as error:
    print(error)
"""


def test_an_outside_package_is_installed_and_its_method_used_by_name(tmp_path):
    source, site = tmp_path / "source", tmp_path / "site"
    source.mkdir()
    (source / "pyproject.toml").write_text(PYPROJECT)
    (source / "tiny_plugin.py").write_text(MODULE)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(site), str(source)], check=True, capture_output=True)

    environment = {**os.environ, "PYTHONPATH": str(site)}
    used = subprocess.run(
        [sys.executable, "-c", USE], check=True, capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert "method 'broken' of tiny-plugin (tiny_plugin_that_is_not_there:Nothing) cannot be imported" in used.stdout

    regmot = [sys.executable, "-m", "regmot", "methods"]
    listed = subprocess.run(regmot, check=True, capture_output=True, text=True, env=environment, cwd=tmp_path)
    line = next(line for line in listed.stdout.splitlines() if "halfway" in line)
    assert "tiny-plugin" in line
    assert "ready" in line
    assert Path(site / "tiny_plugin.py").is_file()
