"""Where a sequence's ego poses come from: the choices, the best that there is, and estimates kept on disk."""

import importlib.util
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from tracker.ego_motion.contract import EgoEstimator, EgoPoses, RecordedPoses
from tracker.ego_motion.odometry import LidarOdometry, OdometrySettings, has_kiss_icp
from tracker.ego_motion.refine import Refiner
from tracker.ego_motion.scan_to_map import RefineSettings
from tracker.ego_motion.smooth import SmoothSettings, smooth_poses
from tracker.ego_motion.stored import load_poses, save_poses
from tracker.errors import InputError, MissingDataError
from tracker.kitti import KittiSequence
from tracker.types import Sweep

AUTO, POSES, OXTS, ODOMETRY, NONE = "auto", "poses", "oxts", "odometry", "none"
REFINED, REFINED_SMOOTH = "refined", "refined-smooth"
EGO_MODES = (AUTO, OXTS, POSES, ODOMETRY, REFINED, REFINED_SMOOTH, NONE)
PRIORS = (OXTS, POSES, ODOMETRY, NONE)  # that a refinement can be told to start from
MOST_FLAGGED = 0.5  # share of the poses; more of them guessed are no odometry

Progress = Callable[[str, int, int], None]  # what is under way, how much of it is done, of how much

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EgoConfig:
    """Where poses come from, and whether points are moved to one instant.

    `auto` takes recorded poses (a file of poses, or else oxts), or else refines odometry, or else has none.
    """

    mode: str = AUTO  # one of EGO_MODES; `refined:odometry` and its like name what a refinement starts from
    deskew: bool = False  # move each object's points to one instant by the motion during the sweep
    correct_beam_angles: bool = False  # in odometry: KITTI's 0.205 degrees

    def __post_init__(self) -> None:
        """Refuse a mode that does not exist."""
        is_refined = self.kind in (REFINED, REFINED_SMOOTH)
        if self.kind not in EGO_MODES or (":" in self.mode and not (is_refined and self.prior in PRIORS)):
            starts = ", ".join(f"{REFINED}:{prior}" for prior in PRIORS)
            raise InputError(f"unknown ego poses {self.mode!r}; expected one of {', '.join(EGO_MODES)}, or {starts}")

    @property
    def kind(self) -> str:
        """The mode without what it starts from."""
        return self.mode.partition(":")[0]

    @property
    def prior(self) -> str:
        """What a refinement starts from; `auto`: the first of poses, oxts and odometry that is there."""
        return self.mode.partition(":")[2] or AUTO

    @property
    def recorded(self) -> str:
        """Which of the poses that come with a data set are read."""
        wanted = self.prior if self.kind in (REFINED, REFINED_SMOOTH) else self.kind
        return NONE if wanted == ODOMETRY else wanted


def with_ego(
    sequence: KittiSequence,
    config: EgoConfig,
    cache: Path | None = None,
    in_world: bool = True,
    progress: Progress | None = None,
) -> KittiSequence:
    """Give a sequence poses of the kind asked for.

    Estimated poses are kept in the cache, and taken from there as long as scans, tables, settings and version are the
    same.

    Args:
        sequence: opened with `recorded=config.recorded`.
        config: where poses come from.
        cache: folder in which estimated poses are kept; None to keep none.
        in_world: velocities are wanted in the world; otherwise `auto` estimates nothing, and points are moved to the
            instants at which objects are seen.
        progress: told of every frame of an estimate.

    Raises:
        MissingDataError: the scans hold nothing to estimate poses from.
        MissingLibraryError: what estimates them is not installed.
        DataError: a scan is damaged.
    """
    if config.deskew:
        sequence = replace(sequence, sweep=Sweep(np.zeros(6), to_frame_time=in_world))
    is_left_open = config.kind == AUTO
    if is_left_open:
        config = replace(config, mode=best_estimate() if sequence.poses is None and in_world else NONE)
    if config.kind not in (ODOMETRY, REFINED, REFINED_SMOOTH):
        return sequence
    poses = _estimated_or_kept(sequence, config, cache, progress)
    if len(poses.flagged) > MOST_FLAGGED * len(sequence):
        what = (
            f"sequence {sequence.name}: {len(poses.flagged)} of {len(sequence)} scans hold nothing static to register"
        )
        if not is_left_open:
            raise MissingDataError(what)
        _log.warning("%s: no ego poses", what)
        return sequence
    if poses.flagged:
        _log.warning("sequence %s: the poses of %d frames are guesses", sequence.name, len(poses.flagged))
    return replace(
        sequence,
        poses=poses.T_world_lidar,
        ego=poses.source,
        step_covariances=poses.step_covariances,
        flagged=poses.flagged,
    )


def best_estimate() -> str:
    """Name the best mode that estimates poses from scans alone, of those whose libraries are here.

    Odometry by itself is several times worse than refined, wherever it was measured (docs/ego-motion.md).
    """
    if not has_kiss_icp():
        return NONE
    return f"{REFINED}:{ODOMETRY}" if importlib.util.find_spec("small_gicp") is not None else ODOMETRY


def estimate_poses(
    sequence: KittiSequence, estimator: EgoEstimator, source: str, progress: Callable[[int, int], None] | None = None
) -> EgoPoses:
    """Run an estimator over a sequence, scan by scan; one scan is in memory at a time.

    Raises:
        MissingDataError: the estimator cannot even guess, for example because frames lack the poses it starts from.
    """
    transforms, flagged = [], []
    covariances, steps = np.full((2, len(sequence), 3, 3), np.nan)
    for frame in sequence.frames():
        pose = estimator.update(frame)
        if pose is None:
            raise MissingDataError(f"sequence {sequence.name}: frame {frame.index} has no pose to start from")
        transforms.append(pose.T_world_lidar)
        for table, covariance in ((covariances, pose.covariance), (steps, pose.step_covariance)):
            if covariance is not None:
                table[frame.index] = covariance
        if pose.is_flagged:
            flagged.append(frame.index)
        if progress is not None:
            progress(frame.index + 1, len(sequence))
    return EgoPoses(np.array(transforms), source, covariances, steps, tuple(flagged))


def _estimated_or_kept(
    sequence: KittiSequence, config: EgoConfig, cache: Path | None, progress: Progress | None
) -> EgoPoses:
    about = _about(sequence, config)
    path = None if cache is None else cache / f"{sequence.name}.{config.mode.replace(':', '-')}.npz"
    kept = None if path is None else load_poses(path, about)
    if kept is not None:
        return kept
    poses = _estimate(sequence, config, progress)
    if path is not None:
        save_poses(path, poses, about)
    return poses


def _about(sequence: KittiSequence, config: EgoConfig) -> str:
    """Say all that decides what an estimate comes to."""
    settings = (OdometrySettings(), RefineSettings(), SmoothSettings())
    content = {
        "regmot": version("regmot"),
        "config": asdict(config),
        "settings": [asdict(part) for part in settings],
        "fingerprint": sequence.fingerprint(),
    }
    return json.dumps(content, sort_keys=True)


def _estimate(sequence: KittiSequence, config: EgoConfig, progress: Progress | None) -> EgoPoses:
    estimator, source = create_ego_estimator(config, sequence.ego if sequence.poses is not None else None)
    what = f"{sequence.name}: ego poses, {source}"
    told = None if progress is None else lambda done, total: progress(what, done, total)
    poses = estimate_poses(sequence, estimator, source, told)
    return smooth_poses(poses, sequence.timestamps) if config.kind == REFINED_SMOOTH else poses


def create_ego_estimator(config: EgoConfig, recorded: str | None = None) -> tuple[EgoEstimator, str]:
    """Make the online estimator of a mode, and say what it is.

    Args:
        config: `odometry`, `refined` or `refined-smooth` (of which it is the causal part).
        recorded: what the poses in the frames are, where they have any.

    Raises:
        InputError: the mode estimates nothing.
        MissingLibraryError: what it needs is not installed.
    """
    if config.kind not in (ODOMETRY, REFINED, REFINED_SMOOTH):
        raise InputError(f"ego poses {config.mode!r} are not estimated from scans")
    if config.kind == ODOMETRY:
        return _odometry(config), ODOMETRY
    name = "refined and smoothed" if config.kind == REFINED_SMOOTH else "refined"
    if recorded is not None and config.prior != ODOMETRY:
        return Refiner(RecordedPoses()), f"{name} from {recorded}"
    if config.prior == ODOMETRY or (config.prior == AUTO and has_kiss_icp()):
        return Refiner(_odometry(config)), f"{name} from {ODOMETRY}"
    return Refiner(None), f"{name} from nothing"


def _odometry(config: EgoConfig) -> LidarOdometry:
    return LidarOdometry(OdometrySettings(correct_beam_angles=config.correct_beam_angles))
