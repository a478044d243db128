"""A scene past parked cars: the ego car drives, and nothing else moves."""

import numpy as np

from registration.synthetic.meshes import Mesh, merge
from tracker.simulation.cast import Cast
from tracker.simulation.roadside import bush, hedge, houses_along, pose_beside, trees_along
from tracker.simulation.scenes import Scene
from tracker.simulation.speeds import Speed, SpeedChange
from tracker.simulation.trajectories import Curve, curve_from_curvature

BEHIND = 90.0  # how far the street reaches behind the ego car's first place [m]
SPEED = 15.0  # [m/s]


def parked_row_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: the ego car drives at 14 to 16 m/s along rows of parked cars, 5 to 15 m beside it.

    Some are parked along the street, some across it, and a few slantwise.  All truth is 0 m/s; accelerations of the
    ego car stay within 0.5 m/s^2 along the way, and 1.6 m/s^2 across it.  The seed draws the rows, the gaps, the cars
    and the bends.

    Args:
        seed: of the scene.
        n_frames: number of sweeps, 10 a second.

    Raises:
        InputError: fewer than 1 or more than 300 frames.
    """
    rng = np.random.default_rng([seed, 2])
    cast = Cast(rng, n_frames)
    end = 16.0 * cast.end + 90.0
    line = _line(end + 60.0, rng)
    changes = tuple(SpeedChange(float(start), 4.0, float(amount)) for start, amount in
                    zip(np.arange(1.0, 29.0, 7.0), 0.9 * rng.choice([-1.0, 1.0]) * np.array([1, -1, -1, 1]),
                        strict=True))  # fmt: skip
    cast.lead_ego(line, 0.0, Speed(SPEED, changes))
    for side in (-1.0, 1.0):
        nearest = float(rng.uniform(5.0, 7.0))
        _row(cast, line, end, (side * nearest, 0.0))
        slant = float(rng.choice([0.5 * np.pi, 0.5 * np.pi, np.deg2rad(60.0)]))
        _row(cast, line, end, (side * float(rng.uniform(nearest + 5.4, 14.6)), slant))
    ground = _background(line, end, rng)
    return cast.scene("parked-row", ground, float(rng.uniform(-np.pi, np.pi)))


def _line(length: float, rng: np.random.Generator) -> Curve:
    """Draw the ego car's way: straights, and bends wide enough for its speed."""
    pieces: list[tuple[float, float]] = [(BEHIND, 0.0)]
    while sum(piece for piece, _ in pieces) < BEHIND + length:
        bend = float(rng.choice([-1.0, 1.0]) / rng.uniform(180.0, 420.0))
        pieces += [(float(rng.uniform(20.0, 80.0)), 0.0), (30.0, bend), (float(rng.uniform(20.0, 50.0)), bend),
                   (30.0, 0.0)]  # fmt: skip
    return curve_from_curvature(np.zeros(2), 0.0, pieces, s_start=-BEHIND)


def _row(cast: Cast, line: Curve, end: float, row: tuple[float, float]) -> None:
    """Park cars in a row: its offset to the left [m], and the angle between the cars and the street [rad]."""
    (offset, slant), rng = row, cast.rng
    s, filled = -60.0, float(rng.uniform(0.25, 0.5))
    while s < end:
        pitch = float(rng.uniform(6.2, 7.8)) if slant == 0.0 else float(rng.uniform(2.9, 3.3)) / np.sin(slant)
        if rng.uniform() < filled * (1.0 if slant == 0.0 else 0.45):
            T_site_place = pose_beside(line, s, offset + float(np.clip(rng.normal(0.0, 0.08), -0.2, 0.2)))
            yaw = float(np.arctan2(T_site_place[1, 0], T_site_place[0, 0]) + slant + rng.normal(0.0, 0.015))
            backwards = np.pi if rng.uniform() < 0.3 else 0.0
            who = cast.draw("Van" if rng.uniform() < 0.1 else "Car")
            cast.stand(who, float(T_site_place[0, 3]), float(T_site_place[1, 3]), yaw + backwards)
        s += pitch
        if rng.uniform() < 0.05:
            s += float(rng.uniform(8.0, 25.0))  # a gateway


def _background(line: Curve, end: float, rng: np.random.Generator) -> Mesh:
    """Build houses on one side, and hedges and bushes on the other."""
    side = float(rng.choice([-1.0, 1.0]))
    parts = houses_along(line, (-70.0, end + 40.0), side * 20.0, rng)
    parts += trees_along(line, (-70.0, end + 40.0), side * 18.4, rng)
    s = -70.0
    while s < end + 40.0:
        length = float(rng.uniform(5.0, 12.0))
        parts.append(hedge(length, 0.9, float(rng.uniform(1.0, 2.2))).moved(pose_beside(line, s, -side * 19.5)))
        parts.append(bush(rng, 2.2).moved(pose_beside(line, s, -side * float(rng.uniform(23.0, 40.0)))))
        s += length + float(rng.uniform(0.5, 8.0))
    return merge(parts)
