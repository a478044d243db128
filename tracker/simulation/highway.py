"""A scene on a highway: oncoming traffic behind a guard rail, trucks, cars that overtake."""

import dataclasses

import numpy as np

from registration.synthetic.meshes import Material, Mesh, merge
from tracker.simulation.cast import Cast, Character, cast_with_ego
from tracker.simulation.planning import Style
from tracker.simulation.roadside import bar, box_at, bush, gantry, guard_rail, pose_beside, sign, tree
from tracker.simulation.scenes import Scene
from tracker.simulation.trajectories import Curve, curve_from_curvature

LANES = (3.6, 7.25, 10.9)  # middle of the lanes, from that of the median; the fast one first [m]
MEDIAN_RAIL, OUTER_RAIL = 1.0, 15.4  # [m]
BEHIND = 320.0  # how far the road reaches behind the ego car's first place [m]
SPEEDS = ((32.0, 35.5), (27.5, 31.0), (22.0, 25.5))  # drivers' wishes in each lane of the ego car's side [m/s]
ONCOMING_SPEEDS = ((31.0, 33.5), (27.0, 30.5), (22.0, 25.5))
EGO_SPEEDS = (28.0, 31.0)
CHANGE_TIME = 4.5  # of a change of lanes [s]


def highway_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: the ego car drives at 18 to 31 m/s on a highway with three lanes each way.

    Trucks and slow cars keep right, faster ones overtake the ego car or are overtaken by it, some change lanes, and
    the traffic of the other side passes behind two guard rails: the largest relative speed is 55 to 65 m/s.  Speeds
    are 17 to 36 m/s; accelerations -4 to 1.8 m/s^2 along the way, and up to 2.5 m/s^2 across it.  The seed draws who
    drives where and how fast, who changes lanes, and the bends.

    Arguments and errors are those of a `SceneRecipe`.
    """
    rng = np.random.default_rng([seed, 1])
    reach = 3.4 * n_frames + 420.0
    line = _line(reach, rng)
    cast = cast_with_ego(rng, n_frames, lambda cast: _with_ego(cast, line))
    _oncoming(cast, line, reach)
    ground = _background(line, 31.0 * cast.end + 130.0, rng)
    return cast.scene("highway", ground, float(rng.uniform(-np.pi, np.pi)))


def _line(reach: float, rng: np.random.Generator) -> Curve:
    """Draw the middle of the median: straights and wide bends; s = 0 is where the ego car is at first."""
    pieces, length, way = [], float(rng.uniform(60.0, 300.0)), 0.0
    while way < BEHIND + reach + 34.0 * 40.0:
        bend = float(rng.choice([-1.0, 1.0]) / rng.uniform(1000.0, 2200.0))
        arc = float(rng.uniform(120.0, 300.0))
        pieces += [(length, 0.0), (110.0, bend), (arc, bend), (110.0, 0.0)]
        way += length + 220.0 + arc
        length = float(rng.uniform(60.0, 250.0))
    return curve_from_curvature(np.zeros(2), 0.0, pieces, s_start=-BEHIND, spacing=0.5)


def _changing(line: Curve, before: float, after: float, s: float, length: float) -> Curve:
    """Draw the way of one who changes lanes at s: from an offset to the left of the line to another one."""

    def offset(at: np.ndarray) -> np.ndarray:
        x = np.clip((at - s) / length, 0.0, 1.0)
        return before + (after - before) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)

    return line.beside(offset)


def _with_ego(cast: Cast, line: Curve) -> None:
    """Set out those on the ego car's side, and itself, from the first to the last."""
    rng = cast.rng
    starts = [(-25.0, -1, 1 + int(rng.integers(2)))]  # the ego car: place, no number, lane
    for lane, (gap, ends) in enumerate((((32.0, 80.0), (-300.0, 150.0)), ((32.0, 75.0), (-160.0, 330.0)),
                                        ((34.0, 80.0), (-70.0, 420.0)))):  # fmt: skip
        s = ends[0] + float(rng.uniform(0.0, 60.0))
        while s < ends[1]:
            if abs(s + 25.0) > 22.0 or lane != starts[0][2]:
                starts.append((s, len(starts), lane))
            s += float(rng.uniform(*gap))
    lanes = [line.parallel(-y) for y in LANES]
    for s, number, lane in sorted(starts, reverse=True):
        if number < 0:
            _ego(cast, line, s, lane)
            continue
        style = Style(float(rng.uniform(*SPEEDS[lane])), time_gap=float(rng.uniform(0.9, 1.5)), lateral=3.0,
                      slowest=19.0)  # fmt: skip
        who = cast.draw(_class_name(lane, rng))
        is_changing = rng.uniform() < 0.7 and who.class_name in ("Car", "Van")
        is_done = is_changing and any(_change(cast, who, line, (s, lane), style) for _ in range(5))
        if not is_done:
            cast.enter(who, lanes[lane], s, style)


def _change(cast: Cast, who: Character, line: Curve, start: tuple[float, int], style: Style) -> bool:
    """Let somebody change to the lane beside, sooner or later; False when there was no room."""
    (s, lane), rng = start, cast.rng
    other = lane + int(rng.choice([-1, 1]))
    other = other if 0 <= other < len(LANES) else 1
    at = s + style.speed * float(rng.uniform(1.0, max(cast.end - 2.0, 2.0)))
    path = _changing(line, -LANES[lane], -LANES[other], at, style.speed * CHANGE_TIME)
    style = dataclasses.replace(style, slowest=0.88 * style.speed)
    return cast.enter(who, path, s, style)


def _ego(cast: Cast, line: Curve, s: float, lane: int) -> None:
    """Let the ego car drive: it changes lanes if it can, or else keeps its own."""
    rng = cast.rng
    speed, other = float(rng.uniform(*EGO_SPEEDS)), lane + int(rng.choice([-1, 1] if lane == 1 else [-1]))
    is_changing = bool(rng.uniform() < 0.6)
    for attempt in range(12):
        style = Style(speed, time_gap=1.2, lateral=3.0, slowest=max(24.0 - attempt, 0.0))
        path = line.parallel(-LANES[lane])
        if is_changing and attempt < 4:
            at = s + style.speed * float(rng.uniform(2.0, 6.0))
            path = _changing(line, -LANES[lane], -LANES[other], at, style.speed * CHANGE_TIME)
        if cast.drive_ego(path, s, style):
            return
        s -= 3.0


def _oncoming(cast: Cast, line: Curve, reach: float) -> None:
    """Set out the traffic of the other side, which starts as far away as it may be met."""
    rng = cast.rng
    for lane, gap in enumerate(((55.0, 170.0), (45.0, 150.0), (45.0, 140.0))):
        path = line.parallel(LANES[lane]).reversed()
        s, farthest = 60.0 - float(rng.uniform(0.0, 80.0)), reach + 33.0 * cast.end
        while s > -farthest + 150.0:
            style = Style(float(rng.uniform(*ONCOMING_SPEEDS[lane])), lateral=3.0, slowest=19.0)
            cast.enter(cast.draw(_class_name(lane, rng)), path, s, style)
            s -= float(rng.uniform(*gap))


def _class_name(lane: int, rng: np.random.Generator) -> str:
    """Say who drives in a lane: trucks keep right."""
    shares = ((0.92, 0.08, 0.0, 0.0), (0.80, 0.14, 0.0, 0.06), (0.30, 0.12, 0.53, 0.05))[lane]
    return str(rng.choice(["Car", "Van", "Truck", "Bus"], p=shares))


def _background(line: Curve, end: float, rng: np.random.Generator) -> Mesh:
    """Build rails, signs and gantries, and what grows beside the road."""
    start = -130.0
    parts = [mesh for y in (-MEDIAN_RAIL, MEDIAN_RAIL, -OUTER_RAIL, OUTER_RAIL)
             for mesh in guard_rail(line, start, end, y)]  # fmt: skip
    for s in np.arange(start, end, 50.0):
        parts += [box_at(line, float(s), y, (0.12, 0.12, 1.0), Material.PAINT_LIGHT) for y in (-16.4, 16.4)]
    for s in np.arange(float(rng.uniform(20.0, 160.0)), end, 330.0):
        parts.append(gantry(16.4).moved(pose_beside(line, float(s), -9.1)))
    for s in np.arange(float(rng.uniform(-60.0, 60.0)), end, 140.0):
        width, height = rng.uniform([1.2, 1.0], [4.0, 2.5])
        parts.append(sign(float(width), float(height), 1.9).moved(pose_beside(line, float(s), -19.5)))
    wall = np.sort(rng.uniform(start, end, 2))
    if wall[1] - wall[0] > 20.0:  # a noise barrier
        corners = np.linspace(wall[0], wall[1], int(np.ptp(wall) / 6.0) + 2)
        parts.append(bar(line, corners, 18.5, (0.0, 3.5, 0.2), Material.MASONRY))
    for s in rng.uniform(start, end, int((end - start) / 7.0)):
        plant = tree(rng) if rng.uniform() < 0.6 else bush(rng, 2.0)
        offset = float(rng.uniform(23.0, 60.0) * rng.choice([-1.0, 1.0]))
        parts.append(plant.moved(pose_beside(line, float(s), offset)))
    return merge(parts)
