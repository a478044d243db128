"""A scene of stop and go: cars around the ego car brake hard and speed up again, over and over."""

import numpy as np

from registration.synthetic.meshes import Mesh, merge
from tracker.simulation.cast import Cast
from tracker.simulation.roadside import guard_rail, houses_along, trees_along
from tracker.simulation.scenes import Scene
from tracker.simulation.speeds import Speed, SpeedChange
from tracker.simulation.trajectories import Curve, curve_from_curvature

BEHIND = 120.0  # how far the road reaches behind the ego car's first place [m]
SPEED = 13.0  # of the ego car, and of the others on average [m/s]
LANES = (-3.5, 0.0, 3.5)  # to the left of the ego car's way [m]
ONCOMING = 9.0
NEAREST = 24.0  # of the ego car's neighbours in its own lane, at first [m]
CYCLE = (7.0, 9.0)  # from one braking to the next [s]
AMOUNT = (5.0, 8.0)  # by which the speed changes [m/s]
BRAKING, SPEEDING_UP = (1.9, 2.3), (2.8, 3.4)  # how long either takes [s]


def braking_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: on a road with three lanes each way everybody but the ego car brakes hard, again and again.

    The ego car drives at a steady 13 m/s; the others by turns 2 to 5 m/s faster and slower than that.  They brake at
    3 to 7.5 m/s^2 and speed up at 1.9 to 4.1 m/s^2, each with jumps of the acceleration 0.8 s long; those across stay
    below 1.5 m/s^2.  So there are some four clear steps of the acceleration a second, 5 to 60 m away.  The seed
    draws who drives where, when they brake and how hard, and the bends.

    Arguments and errors are those of a `SceneRecipe`.
    """
    rng = np.random.default_rng([seed, 6])
    cast = Cast(rng, n_frames)
    reach = 1.2 * SPEED * cast.end + 140.0
    line = _line(reach, rng)
    cast.lead_ego(line, 0.0, Speed(SPEED))
    for offset in LANES:
        _lane(cast, line.parallel(offset), (-50.0, 70.0), NEAREST if offset == 0.0 else 0.0)
    for offset in (ONCOMING, ONCOMING + 3.5):
        _lane(cast, line.parallel(offset).reversed(), (-reach - SPEED * cast.end, 50.0), 0.0)
    return cast.scene("braking", _background(line, reach, rng), float(rng.uniform(-np.pi, np.pi)))


def _line(reach: float, rng: np.random.Generator) -> Curve:
    """Draw the ego car's way: straights and wide bends."""
    pieces: list[tuple[float, float]] = [(BEHIND, 0.0)]
    while sum(length for length, _ in pieces) < BEHIND + reach:
        bend = float(rng.choice([-1.0, 1.0]) / rng.uniform(300.0, 700.0))
        pieces += [(float(rng.uniform(20.0, 80.0)), 0.0), (40.0, bend), (float(rng.uniform(20.0, 60.0)), bend),
                   (40.0, 0.0)]  # fmt: skip
    return curve_from_curvature(np.zeros(2), 0.0, pieces, s_start=-BEHIND)


def _lane(cast: Cast, path: Curve, ends: tuple[float, float], free: float) -> None:
    """Set out a lane's cars between two places; none within `free` of the ego car's [m]."""
    rng = cast.rng
    s = ends[0] + float(rng.uniform(0.0, 20.0))
    while s < ends[1]:
        if abs(s) > free:
            who = cast.draw(str(rng.choice(["Car", "Van", "Truck"], p=[0.85, 0.12, 0.03])))
            cast.lead(who, path, s, _stop_and_go(cast.end, rng))
        s += float(rng.uniform(26.0, 40.0))


def _stop_and_go(end: float, rng: np.random.Generator) -> Speed:
    """Draw a speed that goes down and up again and again, and is `SPEED` on average."""
    cycle, amount = float(rng.uniform(*CYCLE)), float(rng.uniform(*AMOUNT))
    braking, speeding_up = float(rng.uniform(*BRAKING)), float(rng.uniform(*SPEEDING_UP))
    slow = float(rng.uniform(0.25, 0.45)) * (cycle - braking - speeding_up)
    changes = []
    for start in np.arange(-cycle - float(rng.uniform(0.0, cycle)), end + cycle, cycle).tolist():
        changes += [SpeedChange(start, braking, -amount), SpeedChange(start + braking + slow, speeding_up, amount)]
    share = (slow + 0.5 * (braking + speeding_up)) / cycle  # of the time that the speed is down
    return Speed(SPEED + share * amount, tuple(changes))


def _background(line: Curve, reach: float, rng: np.random.Generator) -> Mesh:
    """Build a rail between the directions, and trees and houses on both sides."""
    ends = (-100.0, reach)
    parts = [*guard_rail(line, *ends, 6.2)]
    for offset in (-14.0, 22.0):
        parts += houses_along(line, ends, offset, rng)
        parts += trees_along(line, ends, offset - float(np.sign(offset)) * 3.5, rng)
    return merge(parts)
