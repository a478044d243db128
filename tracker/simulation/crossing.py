"""A scene at a signalled crossing: who drives straight, who turns, and who waits."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from registration import se3
from registration.synthetic.meshes import Material, Mesh, merge
from tracker.simulation.cast import Cast, Stop, cast_with_ego
from tracker.simulation.planning import Style
from tracker.simulation.roadside import bar, houses_along, place, traffic_light, trees_along
from tracker.simulation.scenes import Scene
from tracker.simulation.trajectories import Curve, curve_from_curvature

LANE, CYCLE_LANE = 1.8, 4.5  # to the right of the middle of a road [m]
KERB, WALK, POSTS, HOUSES = 6.0, 9.0, 6.8, 11.6
STOP_LINE = 15.0  # from the middle of the crossing [m]
FAR = 220.0  # where a way begins, before the middle [m]
EXIT = 340.0  # how far it goes on behind it [m]
BUILT = 230.0  # how far houses reach [m]
GREEN, CYCLE = 9.5, 24.0  # how long it is green, and from green to green [s]
LEFT_RADIUS, RIGHT_RADIUS, RAMP = 11.5, 8.0, 4.0  # of turns [m]

_CLASSES = ("Car", "Van", "Truck", "Bus")
_WALKING = Style(1.4, acceleration=0.8, braking=0.8, time_gap=0.3, min_gap=0.4, lateral=1.0, caution=0.4)
_RIDING = Style(5.0, acceleration=0.9, braking=1.5, time_gap=0.8, min_gap=1.0, lateral=1.5, caution=0.6)


def crossing_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: two streets cross at signals, which stop the ones while the others go.

    Cars, vans, trucks and buses drive at up to 14 m/s, stop at red, start at green, and turn, giving way to those who
    come towards them, to cyclists and to persons on the crossings.  The ego car is among them, and goes straight or
    turns.  Accelerations are -4 to 2.3 m/s^2 along the way, and up to 3.2 m/s^2 across it.  The seed draws the
    signals' phase, and who comes when and goes where.

    Args:
        seed: of the scene.
        n_frames: number of sweeps, 10 a second.

    Raises:
        InputError: fewer than 1 or more than 300 frames.
    """
    rng = np.random.default_rng([seed, 3])
    green = float(rng.uniform(-5.0, 8.0))  # when the ego car's street gets green
    cast = cast_with_ego(rng, n_frames, lambda cast: _fill(cast, green))
    return cast.scene("crossing", _background(rng), float(rng.uniform(-np.pi, np.pi)))


def _fill(cast: Cast, green: float) -> None:
    _walkers(cast, green)
    _cyclists(cast, green)
    _vehicles(cast, green)


def closed(green: float, axis: int, cast: Cast, go: float = GREEN) -> list[tuple[float, float]]:
    """List when a street's signals are red [s]: axis 0 has green from `green` on for `go`, axis 1 half a cycle on."""
    starts = green + axis * 0.5 * CYCLE + CYCLE * np.arange(-2, 4)
    return [(float(start) + go, float(start) + CYCLE) for start in starts if start < cast.times[-1]]


@cache
def route(arm: int, move: str) -> Curve:
    """Draw a way over the crossing; s = 0 is the middle for one who goes straight, and s = -15 the stop line for all.

    Args:
        arm: where it comes from: 0 is the west, then counter-clockwise seen by who drives in: 1 south, 2 east, 3 north.
        move: `straight`, `left` or `right`.
    """
    start = np.array([-FAR, -LANE])
    if move == "straight":
        pieces = [(FAR + EXIT, 0.0)]
    else:
        radius = LEFT_RADIUS if move == "left" else RIGHT_RADIUS
        bend = (1.0 if move == "left" else -1.0) / radius
        turn = [(RAMP, bend), (0.5 * np.pi * radius - RAMP, bend), (RAMP, 0.0)]
        ahead = float(curve_from_curvature(np.zeros(2), 0.0, turn).points[-1, 0])
        pieces = [(FAR + np.sign(bend) * LANE - ahead, 0.0), *turn, (EXIT, 0.0)]
    return curve_from_curvature(start, 0.0, pieces, s_start=-FAR).moved(_turned(arm))


def _turned(arm: int) -> np.ndarray:
    return se3.from_yaw(0.5 * np.pi * arm, np.zeros(3))


def _beside(arm: int, offset: float, reach: float) -> Curve:
    """Draw a straight way that passes the middle at s = 0, `offset` to its right."""
    curve = curve_from_curvature(np.array([-reach, -offset]), 0.0, [(2.0 * reach, 0.0)], s_start=-reach)
    return curve.moved(_turned(arm))


def _walkers(cast: Cast, green: float) -> None:
    """Let persons walk beside the streets, and cross the other one when their own has green."""
    rng = cast.rng
    for i in range(16):
        arm = i % 4
        offset = float(rng.choice([-1.0, 1.0]) * (WALK + rng.uniform(-0.9, 0.9)))
        path = _beside(arm, offset, 90.0)
        stops = [Stop(-KERB - 0.5, *times) for times in closed(green, arm % 2, cast, go=3.5)]
        style = Style(float(rng.uniform(1.1, 1.7)), *_rest(_WALKING))
        s = float(rng.uniform(-24.0, -7.5)) if rng.uniform() < 0.75 else float(rng.uniform(8.0, 40.0))
        cast.enter(cast.draw("Pedestrian"), path, s, style, stops)


def _cyclists(cast: Cast, green: float) -> None:
    """Let cyclists ride straight on in their lanes."""
    rng = cast.rng
    for i in range(10):
        arm = i % 4
        path = _beside(arm, CYCLE_LANE + float(rng.uniform(-0.25, 0.25)), BUILT)
        stops = [Stop(-STOP_LINE, *times) for times in closed(green, arm % 2, cast)]
        style = Style(float(rng.uniform(3.8, 6.5)), *_rest(_RIDING))
        cast.enter(cast.draw("Cyclist"), path, float(rng.uniform(-110.0, 40.0)), style, stops)


def _rest(style: Style) -> Sequence[float]:
    return (style.acceleration, style.braking, style.time_gap, style.min_gap, style.lateral, style.caution)


def _vehicles(cast: Cast, green: float) -> None:
    """Let vehicles come from all sides, first those who come first; of them, who goes straight before who turns."""
    rng = cast.rng
    stops = [[Stop(-STOP_LINE, *times) for times in closed(green, arm % 2, cast)] for arm in range(4)]
    ego_s = float(rng.uniform(-62.0, -24.0))
    for arm in range(4):  # those who have passed
        for s in np.cumsum(rng.uniform([15.0, 14.0], [40.0, 40.0]))[: rng.integers(1, 3)][::-1].tolist():
            cast.enter(cast.draw("Car"), route(arm, "straight"), s, Style(float(rng.uniform(10.0, 13.0))), stops[arm])
    queue = [(-ego_s, "straight", 0, True)]
    for arm in range(4):
        s = 17.0 + float(rng.uniform(0.0, 15.0))
        while s < FAR - 8.0:
            move = str(rng.choice(["straight", "left", "right"], p=[0.5, 0.25, 0.25]))
            if arm or abs(s + ego_s) > 9.0:
                queue.append((s, move, arm, False))
            s += float(rng.uniform(9.0, 26.0 if s < 70.0 else 48.0))
    for way, move, arm, is_ego in sorted(queue, key=lambda one: one[0] + (0.0 if one[1] == "straight" else 6.0)):
        if is_ego:
            _ego(cast, ego_s, stops[0])
            continue
        name = str(rng.choice(_CLASSES, p=[0.74, 0.12, 0.08, 0.06])) if move == "straight" else "Car"
        style = Style(float(rng.uniform(10.5, 14.0)), acceleration=float(rng.uniform(1.3, 2.1)), lateral=2.0)
        cast.enter(cast.draw(name), route(arm, move), -way, style, stops[arm])


def _ego(cast: Cast, s: float, stops: Sequence[Stop]) -> None:
    """Let the ego car go straight or turn, if need be straight, later."""
    moves = [str(cast.rng.choice(["straight", "straight", "left", "right"])), "straight", "straight", "straight"]
    for i, move in enumerate(moves):
        if cast.drive_ego(route(0, move), s - 2.5 * i, Style(float(cast.rng.uniform(11.0, 13.0))), stops):
            return


def _background(rng: np.random.Generator) -> Mesh:
    """Build kerbs, houses, posts and signals on all four arms."""
    parts = []
    for arm in range(4):
        T_site_arm = _turned(arm)
        line = _beside(0, 0.0, BUILT)
        corner = curve_from_curvature(np.array([-12.0, -KERB]), 0.0, [(1e-3, -1 / 6.0), (3.0 * np.pi, -1 / 6.0)])
        here = [bar(corner, np.linspace(0.0, corner.s[-1], 9), 0.0, (0.0, 0.12, 0.18), Material.MASONRY)]
        for side in (-1.0, 1.0):
            here.append(bar(line, np.array([-BUILT, -12.0]), side * KERB, (0.0, 0.12, 0.18), Material.MASONRY))
            here += houses_along(line, (-BUILT, -HOUSES - (13.0 if arm % 2 else 0.0)), side * HOUSES, rng)
            here += trees_along(line, (-150.0, -18.0), side * POSTS, rng)
        here.append(place(traffic_light(), -STOP_LINE + 1.2, -POSTS))
        parts.append(merge(here).moved(T_site_arm))
    return merge(parts)
