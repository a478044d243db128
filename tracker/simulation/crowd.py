"""A scene in a crowd: the ego car creeps through a shared street full of persons and cyclists."""

from typing import NamedTuple

import numpy as np

from registration import se3
from registration.synthetic.meshes import Material, Mesh, box_mesh, cylinder, merge
from tracker.simulation.cast import Cast, Character, Stop, cast_with_ego
from tracker.simulation.planning import Style
from tracker.simulation.roadside import houses_along, pose_beside, post, tall_tree
from tracker.simulation.scenes import Scene
from tracker.simulation.trajectories import Curve, curve_from_curvature

BEHIND = 60.0  # how far the street reaches behind the ego car's first place [m]
HALF_WIDTH = 9.5  # of the street, between the houses [m]
PERSONS_PER_METRE, CYCLISTS_PER_METRE, N_CARS = 0.6, 0.08, 4
WALKS = 8.4  # how far from the middle persons walk [m]
CAR_LANE, RIDE_LANES = 3.4, (-5.4, -3.3, 4.9, 6.3)  # to the left of the ego car's way [m]
TRIES = 6  # for a place in the crowd


class _Thing(NamedTuple):
    """Something in the street that nobody runs into: its place (x, y, yaw), and its length and width [m]."""

    mesh: Mesh
    place: tuple[float, float, float]
    size: tuple[float, float]


def crowd_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: a street that persons, cyclists and a few slow cars share, close together.

    Persons walk at 0.7 to 1.9 m/s alone or side by side, along and across the street, stop and go on, or stand
    together; cyclists ride at 2.5 to 5 m/s; cars and the ego car drive at up to 4 m/s and wait for whoever is in
    front.  Accelerations are -3 to 1.1 m/s^2 along the way, and up to 2 m/s^2 across it.  The seed draws who goes
    where and when, and with whom.

    Arguments and errors are those of a `SceneRecipe`.
    """
    rng = np.random.default_rng([seed, 5])
    reach = 0.4 * n_frames + 45.0
    line = _line(reach, rng)
    ends = (-BEHIND, reach + 30.0)
    houses = [*houses_along(line, ends, HALF_WIDTH, rng), *houses_along(line, ends, -HALF_WIDTH, rng)]
    furniture = _furniture(line, reach, rng)
    cast = cast_with_ego(rng, n_frames, lambda cast: _begin(cast, line, furniture))
    _cars(cast, line)
    for _ in range(round(CYCLISTS_PER_METRE * (reach + 40.0))):
        _ride(cast, line, reach)
    for i in range(round(PERSONS_PER_METRE * (reach + 30.0))):
        s = float(rng.uniform(-30.0, reach))
        if i % 4 == 0:
            _walk_across(cast, line, s, float(rng.uniform(-4.0, cast.end)))
        else:
            (_stand_together, _walk_along, _walk_along)[i % 4 - 1](cast, line, s)
    background = merge([*houses, *(thing.mesh for thing in furniture)])
    return cast.scene("crowd", background, float(rng.uniform(-np.pi, np.pi)))


def _line(reach: float, rng: np.random.Generator) -> Curve:
    """Draw the ego car's way: a winding street."""
    pieces: list[tuple[float, float]] = [(BEHIND, 0.0)]
    while sum(length for length, _ in pieces) < BEHIND + reach + 40.0:
        bend = float(rng.choice([-1.0, 1.0]) / rng.uniform(70.0, 200.0))
        pieces += [(15.0, 0.0), (8.0, bend), (15.0, bend), (8.0, 0.0)]
    return curve_from_curvature(np.zeros(2), 0.0, pieces, s_start=-BEHIND)


def _begin(cast: Cast, line: Curve, furniture: list[_Thing]) -> None:
    """Let persons cross for whom the ego car waits, being half-way some seconds after they leave; then let it drive."""
    for thing in furniture:
        cast.close(*thing.place, *thing.size)
    leave = -5.0
    while leave < cast.end - 3.0:
        _walk_across(cast, line, 2.6 * (leave + 6.0) + float(cast.rng.uniform(2.0, 7.0)), leave)
        leave += float(cast.rng.uniform(1.5, 5.0))
    cast.drive_ego(line, -2.0, Style(float(cast.rng.uniform(2.6, 4.0)), acceleration=1.0, min_gap=1.2))


def _lane(line: Curve, offset: float, is_towards: bool) -> Curve:
    lane = line.parallel(offset)
    return lane.reversed() if is_towards else lane


def _cars(cast: Cast, line: Curve) -> None:
    """Let a few cars creep along, ahead of the ego car, behind it and towards it."""
    rng = cast.rng
    towards = _lane(line, CAR_LANE, True)
    for s in np.cumsum(rng.uniform(14.0, 40.0, N_CARS - 2)).tolist():
        style = Style(float(rng.uniform(2.5, 4.0)), acceleration=1.0, min_gap=1.2)
        cast.enter(cast.draw(str(rng.choice(["Car", "Van"]))), towards, -s, style)
    for s in (-14.0, -25.0):
        cast.enter(cast.draw("Car"), line, s, Style(float(rng.uniform(2.5, 4.0)), acceleration=1.0, min_gap=1.2))


def _ride(cast: Cast, line: Curve, reach: float) -> None:
    """Let a cyclist ride along, on the right of the way."""
    rng, who = cast.rng, cast.draw("Cyclist")
    for _ in range(TRIES):
        offset = float(rng.choice(RIDE_LANES)) + float(rng.uniform(-0.3, 0.3))
        path, speed = _lane(line, offset, offset > 0.0), float(rng.uniform(2.5, 5.0))
        s = float(rng.uniform(-reach, 20.0)) if offset > 0.0 else float(rng.uniform(-40.0, reach - 20.0))
        if cast.enter(who, path, s, Style(speed, acceleration=0.8, braking=1.2, min_gap=0.8, lateral=1.2)):
            return


def _walk_across(cast: Cast, line: Curve, s: float, leave: float) -> None:
    """Let one or two persons cross the street from time `leave` on, straight or slantwise, and walk on along it."""
    rng, who = cast.rng, cast.draw("Pedestrian")
    for _ in range(TRIES):
        path = _across(line, s, float(rng.choice([-1.0, 1.0])), rng)
        if _go_together(cast, who, (path, float(rng.uniform(0.0, 0.4))), [Stop(1.2, -9.0, leave)]):
            return
        s += float(rng.uniform(-3.0, 3.0))


def _across(line: Curve, s: float, side: float, rng: np.random.Generator) -> Curve:
    """Draw a way from one side (+1: left) of the street to the other, and on along it."""
    slant = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.6))
    turn, length = np.sign(slant) * (0.5 * np.pi - abs(slant)), float(rng.uniform(5.0, 6.5))
    landing = float(rng.uniform(2.6, 4.4))
    T_site_start = pose_beside(line, s, side * WALKS)
    yaw = float(np.arctan2(T_site_start[1, 0], T_site_start[0, 0])) - side * 0.5 * np.pi + slant
    straight = (WALKS + landing) / np.cos(slant)
    forth = np.sign(slant) * side  # +1 for those who then go the way of the line
    at = s + forth * (straight * np.sin(abs(slant)) + 0.6 * length + np.arange(2.0, 62.0, 2.0))
    along = forth * line.curvatures(at) / (1.0 + side * (landing + 0.55 * length) * line.curvatures(at))
    pieces = [(straight, 0.0), (0.5 * length, 2.0 * turn / length), (0.5 * length, 0.0)]
    pieces += [(2.0, float(curvature)) for curvature in along]
    return curve_from_curvature(T_site_start[:2, 3], yaw, pieces)


def _walk_along(cast: Cast, line: Curve, s: float) -> None:
    """Let one or two persons walk along the street, beside the cars, steadily or with a stop."""
    rng, who = cast.rng, cast.draw("Pedestrian")
    for _ in range(TRIES):
        is_towards = bool(rng.uniform() < 0.5)
        path = _lane(line, float(rng.choice([-1.0, 1.0]) * rng.uniform(4.2, 8.0)), is_towards)
        start, stops = (-s if is_towards else s), []
        if rng.uniform() < 0.35:
            time = float(rng.uniform(0.0, max(cast.end - 2.0, 0.5)))
            stops = [Stop(start + 1.3 * time + 1.5, time, time + float(rng.uniform(2.5, 6.0)))]
        if _go_together(cast, who, (path, start), stops):
            return
        s += float(rng.uniform(-4.0, 4.0))


def _go_together(cast: Cast, who: Character, start: tuple[Curve, float], stops: list[Stop]) -> bool:
    """Let somebody go, and by half of all chances a second one beside; False when there was no room for the first."""
    (path, s), rng = start, cast.rng
    style = Style(float(rng.uniform(0.8, 1.8)), acceleration=0.8, braking=0.8, time_gap=0.3, min_gap=0.4, lateral=1.0,
                  caution=0.4)  # fmt: skip
    if not cast.enter(who, path, s, style, stops):
        return False
    if rng.uniform() < 0.5:
        aside = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.85, 1.0))
        cast.enter(cast.draw("Pedestrian"), path.parallel(aside), s, style, stops)
    return True


def _stand_together(cast: Cast, line: Curve, s: float) -> None:
    """Let up to four persons stand around, face to face."""
    rng = cast.rng
    T_site_middle = pose_beside(line, s, float(rng.choice([-1.0, 1.0]) * rng.uniform(4.6, 8.0)))
    x, y = T_site_middle[:2, 3]
    n, first = int(rng.integers(1, 5)), float(rng.uniform(-np.pi, np.pi))
    for angle in (first + 2.0 * np.pi * np.arange(n) / n).tolist():
        radius = float(rng.uniform(0.75, 0.95))
        yaw = angle + np.pi + float(rng.normal(0.0, 0.2))
        cast.stand(cast.draw_standing(), x + radius * np.cos(angle), y + radius * np.sin(angle), yaw)


def _furniture(line: Curve, reach: float, rng: np.random.Generator) -> list[_Thing]:
    """Set up the posts, trees, bollards and benches in the street."""
    things = []
    for s in (np.arange(-40.0, reach, 7.0) + rng.uniform(-2.0, 2.0)).tolist():
        T_site_thing = pose_beside(line, s, float(rng.choice([-7.0, 7.4])))
        x, y = T_site_thing[:2, 3].tolist()
        kinds = (box_mesh(np.array([1.8, 0.5, 0.45]), Material.MASONRY), post(), tall_tree(rng),
                 cylinder(0.1, 0.9, Material.METAL, 8))  # fmt: skip
        kind = int(rng.integers(len(kinds)))
        size = (1.8, 0.5) if kind == 0 else (0.3, 0.3)
        things.append(_Thing(kinds[kind].moved(T_site_thing), (x, y, se3.yaw(T_site_thing)), size))
    return things
