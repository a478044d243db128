"""Measure ego poses on simulated scenes, for the tables of docs/ego-motion.md.

python -m regmot.ego_figures OUT

Scenes with a rolling shutter and an ego car on its way: pose errors of every mode, with and without traffic around;
what the sweep does to parked cars, and what is left of it; and what 5 ms of jitter between GPS/IMU and scans do.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from evaluation.compare import run_causal
from evaluation.pose_error import score_steps
from tracker.ego_motion.modes import EgoConfig, with_ego
from tracker.errors import MissingDataError
from tracker.estimators import create_estimator
from tracker.kitti import KittiSequence, open_sequence
from tracker.kitti.poses import Poses
from tracker.simulation import Recording, create_scene, simulate
from tracker.simulation.scenes import Scene
from tracker.store import cut_sequence
from tracker.types import WORLD, VelocityEstimate

from .console import print_table, progress_bars

N_FRAMES = 80
SEED = 1
JITTER = 0.005  # standard deviation of the time between GPS/IMU record and scan [s]
MODES = ("oxts", "odometry", "refined:oxts", "refined:odometry", "refined:none", "refined-smooth:oxts")
RANGE = 20.0  # of the parked cars that are looked at [m]
SECTORS = 12  # of azimuth that a bias is measured in
POSE_HEADER = (
    "scene",
    "poses",
    "shift, RMS [mm]",
    "largest",
    "forward, mean",
    "yaw, RMS [mrad]",
    "NEES / 3",
    "flagged",
)
SWEEPS = (("instantaneous", False), ("rolling", False), ("rolling", True))  # scans, whether they are deskewed


def main() -> None:
    """Simulate what is missing, measure, print."""
    out = Path(sys.argv[1])
    scenes = {name: create_scene(name, SEED, N_FRAMES) for name in ("parked-row", "urban", "highway")}
    scenes["urban, no traffic"] = replace(scenes["urban"], actors=())
    roots = {name: _simulated(scene, out / name.replace(", ", "-").replace(" ", "-")) for name, scene in scenes.items()}
    instant = _simulated(scenes["parked-row"], out / "parked-row-instant", rolling_shutter=False)
    with progress_bars() as progress:
        progress("ego figures", 0, 3)
        poses = [row for name, root in roots.items() for row in _pose_rows(name, scenes[name], root, out)]
        progress("ego figures", 1, 3)
        sweeps = list(_sweep_rows(instant, roots["parked-row"], out))
        progress("ego figures", 2, 3)
        jitters = list(_jitter_rows(scenes["parked-row"], roots["parked-row"], out))
        progress("ego figures", 3, 3)
    print_table(POSE_HEADER, poses, title="pose errors, a step")
    print_table(["scans", "poses", "deskew", "n", "RMSE [m/s]", "bias [m/s]"], sweeps, title="parked cars, the sweep")
    print_table(["poses", "n", "RMSE [m/s]", "NEES / 2"], jitters, title=f"parked cars, {1e3 * JITTER:g} ms of jitter")


def _simulated(scene: Scene, root: Path, rolling_shutter: bool = True) -> Path:
    return simulate(scene, root, seed=SEED, recording=Recording(rolling_shutter=rolling_shutter))


def jittered(scene: Scene, seed: int = 7) -> Poses:
    """Give poses whose records were taken a little before or after the scan."""
    rng = np.random.default_rng(seed)
    times = scene.period * np.arange(scene.n_frames) + JITTER * rng.standard_normal(scene.n_frames)
    return np.array([scene.T_world_lidar(float(time)) for time in times])


def _pose_rows(name: str, scene: Scene, root: Path, out: Path) -> list[list[str]]:
    exact = open_sequence(root, "0000")
    sequence = replace(exact, poses=jittered(scene), ego="oxts with jitter")
    rows = []
    for mode in MODES:
        found = _with_ego(sequence, mode, out / f"ego-{root.name}")
        score = score_steps(_poses(found), _poses(exact), found.step_covariances)
        lengths = [f"{1e3 * value:.2f}" for value in (score.rms_shift, score.max_shift, score.mean_forward)]
        nees = "-" if np.isnan(score.nees) else f"{score.nees / 3.0:.2f}"
        rows.append([name, found.ego, *lengths, f"{1e3 * score.rms_yaw:.3f}", nees, str(len(found.flagged))])
    return rows


def _poses(sequence: KittiSequence) -> Poses:
    if sequence.poses is None:
        raise MissingDataError(f"sequence {sequence.name} has no poses")
    return sequence.poses


def _with_ego(sequence: KittiSequence, mode: str, cache: Path, deskew: bool = True) -> KittiSequence:
    config = EgoConfig(mode, deskew=deskew)
    if config.recorded == "none":
        sequence = replace(sequence, poses=None, ego="none")
    return with_ego(sequence, config, cache)


def _sweep_rows(instant: Path, rolling: Path, out: Path) -> list[list[str]]:
    rows = []
    for what, deskew in SWEEPS:
        root = instant if what == "instantaneous" else rolling
        for mode in ("oxts", "refined:oxts"):
            cache = out / f"sweep-{root.name}-{deskew}-{mode.replace(':', '-')}"
            sequence = _with_ego(open_sequence(root, "0000"), mode, cache, deskew)
            velocities, azimuths, _ = _parked(sequence, cache)
            figures = [f"{_rms(velocities):.3f}", f"{sector_bias(velocities, azimuths):.3f}"]
            rows.append([what, sequence.ego, "yes" if deskew else "no", str(len(velocities)), *figures])
    return rows


def _jitter_rows(scene: Scene, rolling: Path, out: Path) -> list[list[str]]:
    exact = open_sequence(rolling, "0000")
    rough = replace(exact, poses=jittered(scene), ego="oxts with jitter")
    rows = []
    for sequence, mode in ((exact, "oxts"), (rough, "oxts"), (rough, "refined:oxts"), (rough, "refined-smooth:oxts")):
        cache = out / f"jitter-{sequence.ego.replace(' ', '-')}-{mode.replace(':', '-')}"
        found = _with_ego(sequence, mode, cache)
        velocities, _, covariances = _parked(found, cache)
        nees = np.einsum("ni,nij,nj->n", velocities, np.linalg.inv(covariances), velocities).mean()
        rows.append([found.ego, str(len(velocities)), f"{_rms(velocities):.3f}", f"{nees / 2.0:.2f}"])
    return rows


def _parked(
    sequence: KittiSequence, cache: Path
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"], Float64[np.ndarray, "n 2 2"]]:
    """Run `adh-3d` over parked cars within reach: velocities along and across the ego's way, azimuths, covariances."""
    store = cut_sequence(sequence, cache / "tracklets")
    runs, _ = run_causal(create_estimator("adh-3d"), store, ("Car", "Van"), WORLD)
    found = [e for run in runs for e in run[1:] if e.n_points and e.range_m < RANGE]
    along = [_along_the_way(e, sequence) for e in found]
    return (
        np.array([velocity for velocity, _, _ in along]),
        np.array([azimuth for _, azimuth, _ in along]),
        np.array([covariance for _, _, covariance in along]),
    )


def _along_the_way(
    estimate: VelocityEstimate, sequence: KittiSequence
) -> tuple[Float64[np.ndarray, "2"], float, Float64[np.ndarray, "2 2"]]:
    T = _poses(sequence)[estimate.frame]
    heading = np.arctan2(T[1, 0], T[0, 0])
    c, s = np.cos(heading), np.sin(heading)
    R = np.array([[c, s], [-s, c]])
    ahead, left = R @ (estimate.position - T[:2, 3])
    return R @ estimate.velocity, float(np.arctan2(left, ahead)), R @ estimate.covariance @ R.T


def sector_bias(velocities: Float64[np.ndarray, "n 2"], azimuths: Float64[np.ndarray, " n"]) -> float:
    """Give the root mean square, over sectors of azimuth, of the mean velocity along the way [m/s]."""
    sector = np.floor((azimuths + np.pi) / (2.0 * np.pi) * SECTORS).astype(int)
    means = [velocities[sector == i, 0].mean() for i in range(SECTORS) if (sector == i).sum() >= 10]
    return float(np.sqrt(np.mean(np.square(means))))


def _rms(velocities: Float64[np.ndarray, "n 2"]) -> float:
    return float(np.sqrt((velocities**2).sum(axis=1).mean()))


if __name__ == "__main__":
    main()
