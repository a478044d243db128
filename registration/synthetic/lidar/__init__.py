"""The LiDAR that looks at meshes: beam models, and sweeps of them ray-cast over whatever stands or moves around."""

from registration.synthetic.lidar.beams import BeamModel, Jitter, Rays, Turn, fire, ray_directions
from registration.synthetic.lidar.casting import PlacedMesh
from registration.synthetic.lidar.lasers import Rings, firing_lags, ring_of, rings
from registration.synthetic.lidar.motion import pose_after, twist_between
from registration.synthetic.lidar.sweep import GROUND, Sweep, level_ground, scan
from registration.synthetic.lidar.tables import (
    HDL_64E,
    HDL_64E_KITTI,
    OS1_128,
    SYMMETRIC_64,
    VLP_16,
    VLP_32C,
    beam_model,
    beam_models,
    read_beam_table,
)

__all__ = [
    "GROUND",
    "HDL_64E",
    "HDL_64E_KITTI",
    "OS1_128",
    "SYMMETRIC_64",
    "VLP_16",
    "VLP_32C",
    "BeamModel",
    "Jitter",
    "PlacedMesh",
    "Rays",
    "Rings",
    "Sweep",
    "Turn",
    "beam_model",
    "beam_models",
    "fire",
    "firing_lags",
    "level_ground",
    "pose_after",
    "ray_directions",
    "read_beam_table",
    "ring_of",
    "rings",
    "scan",
    "twist_between",
]
