"""Estimated poses on disk, beside the segments: taken again as long as they were made of the same."""

import logging
import zipfile
from pathlib import Path

import numpy as np

from tracker.ego_motion.contract import EgoPoses
from tracker.files import whole_file

FORMAT = "regmot-ego-poses 1"

_log = logging.getLogger(__name__)
# What NumPy and zipfile raise on damaged archives, by where the damage is.
_DAMAGES = (OSError, ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile)


def save_poses(path: Path, poses: EgoPoses, about: str) -> None:
    """Write poses; `about` says what they were made of."""
    with whole_file(path, "wb") as file:
        np.savez(
            file,
            format=np.array(FORMAT),
            about=np.array(about),
            source=np.array(poses.source),
            T_world_lidar=poses.T_world_lidar,
            covariances=poses.covariances,
            step_covariances=poses.step_covariances,
            flagged=np.array(poses.flagged, dtype=np.int64),
        )


def load_poses(path: Path, about: str) -> EgoPoses | None:
    """Read poses that were made of the same; None where there are none, or others, or a damaged file."""
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as archive:
            if str(archive["format"]) != FORMAT or str(archive["about"]) != about:
                return None
            return EgoPoses(
                T_world_lidar=archive["T_world_lidar"],
                source=str(archive["source"]),
                covariances=archive["covariances"],
                step_covariances=archive["step_covariances"],
                flagged=tuple(archive["flagged"].tolist()),
            )
    except _DAMAGES as error:
        _log.warning("%s: damaged (%s); estimated anew", path, error)
        return None
