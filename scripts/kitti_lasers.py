"""Measure to which sides the lasers of KITTI's sensor look that fire together, for the beam table `hdl-64e-kitti.csv`.

python -m regmot.kitti_lasers ROOT [SEQUENCE]

The head's azimuth is recorded in steps of 0.09 degrees, of which a firing takes two; as it turns by less than that, one
firing in six or seven takes a single one.  All lasers of a firing share it, so that a ring's short steps lie where
another ring's do, shifted by the angle between the two lasers.
"""

import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from registration.synthetic.lidar import HDL_64E, ring_of
from registration.types import Points
from tracker.kitti import open_sequence

from .console import print_table

SHORT = (0.06, 0.115)  # a single step of the encoder [deg]
FIELD = 46.0  # scans of 0000 show that much to either side [deg]
LEAST_SHORT = 15  # short steps of a ring in a scan, for it to count
BIN, FARTHEST = 0.03, 20.0  # of the histogram of shifts [deg]
REFERENCE = 16  # the ring that others are compared with

Rings = list[Float64[np.ndarray, " n"]]


def main() -> None:
    """Print what each laser's azimuth is against the middle of all, with how many short steps agree."""
    root, name = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "0000"
    scans = [
        short_steps(frame.points_lidar)
        for frame in open_sequence(root, name).frames()
        if frame.points_lidar is not None
    ]
    found = [shift(scans, ring, REFERENCE) for ring in range(HDL_64E.n_beams)]
    middle = 0.5 * (max(f[0] for f in found) + min(f[0] for f in found))
    rows = [
        [f"{np.rad2deg(elevation):.3f}", f"{degrees - middle:.2f}", f"{100 * share:.0f} %"]
        for elevation, (degrees, share) in zip(HDL_64E.elevations, found, strict=True)
    ]
    print_table(["elevation [deg]", "azimuth offset [deg]", "agree"], rows)


def short_steps(points_lidar: Points) -> Rings:
    """Find where the encoder took a single step, ring by ring [deg]."""
    azimuth = np.rad2deg(np.arctan2(points_lidar[:, 1], points_lidar[:, 0]))
    ring, _ = ring_of(points_lidar, HDL_64E)
    found = []
    for number in range(HDL_64E.n_beams):
        own = np.sort(azimuth[(ring == number) & (np.abs(azimuth) < FIELD)])
        steps = np.diff(own)
        found.append(own[1:][(steps > SHORT[0]) & (steps < SHORT[1])])
    return found


def shift(scans: list[Rings], ring: int, reference: int) -> tuple[float, float]:
    """Give the angle from one ring to another [deg] at which most short steps agree, and the share of these."""
    pairs = [
        (rings[ring], rings[reference])
        for rings in scans
        if min(len(rings[k]) for k in (ring, reference)) >= LEAST_SHORT
    ]
    shifts = np.concatenate([(own[:, None] - other).ravel() for own, other in pairs])
    edges = np.arange(-FARTHEST, FARTHEST, BIN)
    counts = np.convolve(np.histogram(shifts, edges)[0], np.ones(5), "same")
    best = edges[int(counts.argmax())] + 0.5 * BIN
    near = shifts[np.abs(shifts - best) < 2.5 * BIN]
    return float(np.median(near)), len(near) / sum(min(len(own), len(other)) for own, other in pairs)


if __name__ == "__main__":
    main()
