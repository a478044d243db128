"""KITTI tracking folders with exact truth, ray-cast: traffic scenes of our own, and labelled traffic played again."""

from tracker.simulation.catalogue import create_scene
from tracker.simulation.folder import Recording, simulate
from tracker.simulation.from_labels import LabelPlay, simulate_labels
from tracker.simulation.jitter import BoxJitter

__all__ = ["BoxJitter", "LabelPlay", "Recording", "create_scene", "simulate", "simulate_labels"]
