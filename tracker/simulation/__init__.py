"""Traffic scenes of our own, ray-cast into KITTI tracking folders with exact truth beside them."""

from tracker.simulation.folder import create_scene, simulate

__all__ = ["create_scene", "simulate"]
