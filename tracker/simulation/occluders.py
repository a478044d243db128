"""What hides labelled objects though nobody labelled it: walls, poles, hedges, put in by the labels' own word."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float64

from registration import se3
from registration.synthetic.meshes import Material, Mesh, box_mesh
from registration.types import Transform
from tracker.simulation.smoothed_tracks import Track, smoothed
from tracker.types import Box

# Share of an object's width that is hidden, by the label's code: 1 is "partly", 2 is "largely" occluded; 3 is unknown.
SHARES = {1: 0.3, 2: 0.6}
SPREAD = 0.1  # of a track's own share about it, at most

SMALLEST_SHARE = 0.08  # nothing is put in for less
GAP = 0.35  # between an object and what hides it [m]
NEAREST = 2.0  # nothing is put in nearer to the sensor than this [m]
OVERHANG = 0.3  # of a panel above the object [m]
THICKNESS = 0.06  # [m]
_SAMPLES = 64  # of an object's width


@dataclass(frozen=True)
class Hiding:
    """How a track is hidden over its life, whoever does it.

    Attributes:
        side: from which side, seen from the sensor: +1 the left, -1 the right.
        shares: of its width, by frame.
    """

    side: int
    shares: dict[int, float]

    def at(self, frame: int) -> tuple[float, int]:
        """Give the share that is hidden in a frame, and the side."""
        return self.shares.get(frame, 0.0), self.side


def draw_hiding(track: Track, rng: np.random.Generator) -> Hiding:
    """Draw how a track is hidden where its labels say so: by how much, from which side; both stay over its life.

    Labels change from one frame to the next; the share follows them smoothly.
    """
    side = 1 if rng.uniform() < 0.5 else -1
    shift = float(rng.uniform(-SPREAD, SPREAD))
    shares: dict[int, float] = {}
    for part in track.stretches:
        frames = range(part.first, part.first + len(part.times))
        wanted = np.array([SHARES.get(track.occlusion[frame], -shift) + shift for frame in frames])
        values = np.clip(smoothed(wanted[:, None], np.arange(len(wanted), dtype=np.float64))[:, 0], 0.0, 0.9)
        shares.update(zip(frames, values.tolist(), strict=True))
    return Hiding(side, shares)


def occluders(box: Box, boxes: Sequence[Box], hidden: tuple[float, int]) -> list[tuple[Mesh, Transform]]:
    """Put a panel before an object that the other objects hide less than its label says; often none is needed.

    A panel stands close to the object, so that it hides little else, and covers its width from one side.

    Args:
        box: of the object.
        boxes: all of the frame.
        hidden: which share of its width is to be hidden, from which side (`Hiding.at`).

    Returns:
        Meshes and their poses T_lidar_obj.
    """
    share, side = hidden
    edges = _panel_edges(box, boxes, share, side) if share > SMALLEST_SHARE else None
    panel = None if edges is None else _panel(box, edges)
    return [] if panel is None else [panel]


def _panel_edges(box: Box, boxes: Sequence[Box], share: float, side: int) -> tuple[float, float] | None:
    """Find between which azimuths a panel hides what is still missing; None where others hide enough [rad]."""
    bearing = _bearing(box)
    low, high = azimuths(box, bearing)
    samples = bearing + np.linspace(low, high, _SAMPLES)
    covered = _covered(box, boxes, samples)
    missing = share - float(covered.mean())
    if missing < SMALLEST_SHARE:
        return None
    inwards = samples[::-1] if side > 0 else samples
    is_free = ~(covered[::-1] if side > 0 else covered)
    last = int(np.searchsorted(np.cumsum(is_free), round(missing * _SAMPLES)))
    start, end = inwards[0], inwards[min(last, _SAMPLES - 1)]
    return float(min(start, end)), float(max(start, end))


def _covered(box: Box, boxes: Sequence[Box], samples: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Tell which azimuths nearer boxes stand in."""
    range_m = np.hypot(*box.center_lidar[:2])
    covered = np.zeros(len(samples), dtype=bool)
    for other in boxes:
        if other.track_id != box.track_id and np.hypot(*other.center_lidar[:2]) < range_m:
            bearing = _bearing(other)
            low, high = azimuths(other, bearing)
            off = _wrapped(samples - bearing)
            covered |= (low <= off) & (off <= high)
    return covered


def azimuths(box: Box, bearing: float) -> tuple[float, float]:
    """Give the edges of a box, seen from the sensor, relative to a bearing [rad]."""
    corners = box.corners_lidar
    off = _wrapped(np.arctan2(corners[:, 1], corners[:, 0]) - bearing)
    return float(off.min()), float(off.max())


def _panel(box: Box, edges: tuple[float, float]) -> tuple[Mesh, Transform] | None:
    """Stand a panel between the sensor and a box; None where there is no room for it."""
    corners = box.corners_lidar
    distance = float(np.hypot(corners[:, 0], corners[:, 1]).min()) - GAP
    if distance < NEAREST:
        return None
    middle, half = 0.5 * (edges[0] + edges[1]), 0.5 * (edges[1] - edges[0])
    width = 2.0 * distance * np.tan(half)
    bottom, height = float(corners[:, 2].min()), float(box.size[2]) + OVERHANG
    at = np.array([distance * np.cos(middle), distance * np.sin(middle), bottom])
    return _panel_mesh(round(width / 0.02), round(height / 0.02)), se3.from_yaw(middle, at)


@lru_cache(maxsize=4096)
def _panel_mesh(width: int, height: int) -> Mesh:
    """Build a panel across the x-axis; one mesh for each size, in steps of 2 cm."""
    return box_mesh(np.array([THICKNESS, 0.02 * max(width, 1), 0.02 * height]), Material.MASONRY)


def _bearing(box: Box) -> float:
    return float(np.arctan2(box.center_lidar[1], box.center_lidar[0]))


def _wrapped(angles: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    return np.angle(np.exp(1j * angles))
