"""A scene at a roundabout: everybody turns, the ego car too."""

from functools import cache

import numpy as np

from registration import se3
from registration.synthetic.meshes import Material, Mesh, cylinder, merge
from tracker.simulation.cast import Cast, cast_with_ego
from tracker.simulation.planning import Style
from tracker.simulation.roadside import bar, box_at, bush, houses_along, place, sign, tree, trees_along
from tracker.simulation.scenes import Scene
from tracker.simulation.trajectories import Curve, curve_from_curvature

RADIUS, ISLAND, OUTER = 16.0, 11.5, 20.0  # of the ring's lane, of its island, and of its outer kerb [m]
LANE = 2.7  # to the right of the middle of an arm [m]
KERB = 4.9
ENTRY_RADIUS = 13.0  # of the bends into the ring and out of it [m]
RAMP = 5.0  # over which a bend becomes another [m]
FAR, EXIT = 150.0, 260.0  # lengths of the straight ways to the roundabout and from it [m]
WALK = 30.5  # where persons cross the arms, from the middle [m]
HOUSES = 36.0
SMALL_TRUCK = np.array([6.4, 2.2, 2.9])  # [m]

_CLASSES = ("Car", "Van", "Truck", "Cyclist")


def roundabout_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: a roundabout with one lane and four arms, which the ego car enters too.

    Cars, vans, trucks and cyclists turn all the time, at up to 7 m/s on the ring and 13 m/s on the arms; who comes
    later waits for a gap, and for persons who cross the arms.  Accelerations are -4 to 2.2 m/s^2 along the way, and up
    to 3.3 m/s^2 across it.  The seed draws who comes from where, leaves where, and when, and so who waits for whom.

    Args:
        seed: of the scene.
        n_frames: number of sweeps, 10 a second.

    Raises:
        InputError: fewer than 1 or more than 300 frames.
    """
    rng = np.random.default_rng([seed, 4])
    cast = cast_with_ego(rng, n_frames, _fill)
    return cast.scene("roundabout", _background(rng), float(rng.uniform(-np.pi, np.pi)))


@cache
def route(arm: int, n_exits: int) -> Curve:
    """Draw a way through the roundabout; s = 0 is where the straight way to it ends.

    Args:
        arm: where it comes from: 0 is the west, then counter-clockwise seen from above: 1 south, 2 east, 3 north.
        n_exits: which exit it takes: 1 turns right, 2 goes straight on, 3 turns left, 4 turns back.
    """
    aside = LANE + ENTRY_RADIUS
    angle = float(np.arcsin(aside / (RADIUS + ENTRY_RADIUS)))  # from the arm's axis to where the bends meet
    entry, ring = 0.5 * np.pi - angle, 0.5 * np.pi * n_exits - 2.0 * angle
    bends = [(FAR, 0.0), (entry * ENTRY_RADIUS, -1.0 / ENTRY_RADIUS), (ring * RADIUS, 1.0 / RADIUS),
             (entry * ENTRY_RADIUS, -1.0 / ENTRY_RADIUS), (EXIT, 0.0)]  # fmt: skip
    curve = curve_from_curvature(np.zeros(2), 0.0, _ramped(bends), s_start=-FAR)
    half_way = (entry * ENTRY_RADIUS) + 0.5 * ring * RADIUS
    x, y, yaw = curve.track(np.array([half_way]))[0]
    center = np.array([x - RADIUS * np.sin(yaw), y + RADIUS * np.cos(yaw), 0.0])
    return curve.moved(se3.from_yaw(0.5 * np.pi * arm, np.zeros(3)) @ se3.from_yaw(0.0, -center))


def _ramped(bends: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Let the curvature change over ramps, half of which each of the two neighbours gives; the angles stay."""
    pieces: list[tuple[float, float]] = []
    for i, (length, curvature) in enumerate(bends):
        is_first, is_last = i == 0, i == len(bends) - 1
        pieces.append((length - RAMP * (0.5 if is_first or is_last else 1.0), curvature))
        if not is_last:
            pieces.append((RAMP, bends[i + 1][1]))
    return pieces


def _fill(cast: Cast) -> None:
    _walkers(cast)
    _vehicles(cast)


def _walkers(cast: Cast) -> None:
    """Let persons cross the arms, and walk on."""
    rng = cast.rng
    for i in range(12):
        arm, direction = i % 4, float(rng.choice([-1.0, 1.0]))
        x, start = -WALK + float(rng.uniform(-0.9, 0.9)), float(rng.uniform(5.5, 24.0))
        line = curve_from_curvature(np.array([x, direction * 70.0]), -direction * 0.5 * np.pi, [(140.0, 0.0)])
        path = line.moved(se3.from_yaw(0.5 * np.pi * arm, np.zeros(3)))
        style = Style(float(rng.uniform(1.1, 1.7)), acceleration=0.8, braking=0.8, time_gap=0.3, min_gap=0.4)
        cast.enter(cast.draw("Pedestrian"), path, 70.0 - start, style)


def _vehicles(cast: Cast) -> None:
    """Let vehicles come from all sides, first those who come first."""
    rng = cast.rng
    ego_s = -float(rng.uniform(8.0, 26.0))
    queue = [(ego_s, 0, True)]
    for arm in range(4):
        s = float(rng.uniform(10.0, 26.0))  # the first is on the ring already
        while s > -FAR + 10.0:
            if arm or abs(s - ego_s) > 10.0:
                queue.append((s, arm, False))
            s -= float(rng.uniform(13.0, 45.0))
    for s, arm, is_ego in sorted(queue, reverse=True):
        if is_ego:
            _ego(cast, s)
            continue
        name = str(rng.choice(_CLASSES, p=[0.68, 0.12, 0.08, 0.12]))
        way = route(arm, int(rng.choice([1, 2, 3, 4], p=[0.28, 0.36, 0.28, 0.08])))
        speed = rng.uniform(4.0, 6.0) if name == "Cyclist" else rng.uniform(9.5, 13.0)
        push = 0.9 if name == "Cyclist" else float(rng.uniform(1.3, 2.0))
        style = Style(float(speed), acceleration=push, lateral=float(rng.uniform(1.7, 2.4)))
        cast.enter(cast.draw(name, SMALL_TRUCK if name == "Truck" else None), way, s, style)


def _ego(cast: Cast, s: float) -> None:
    for i in range(6):
        n_exits = int(cast.rng.integers(1, 4))
        if cast.drive_ego(route(0, n_exits), s - 2.0 * i, Style(float(cast.rng.uniform(9.5, 12.0)), lateral=2.2)):
            return


def _background(rng: np.random.Generator) -> Mesh:
    """Build the islands and kerbs, and what stands around."""
    circle = curve_from_curvature(np.array([0.0, -OUTER]), 0.0, [(1e-3, 1.0 / OUTER), (2.0 * np.pi * OUTER, 1 / OUTER)])
    parts = [cylinder(ISLAND, 0.14, Material.MASONRY, 40), cylinder(ISLAND - 2.5, 0.5, Material.FOLIAGE, 32)]
    for _ in range(int(rng.integers(3, 9))):
        r, angle = float(rng.uniform(0.0, ISLAND - 4.5)), float(rng.uniform(-np.pi, np.pi))
        plant = tree(rng) if rng.uniform() < 0.3 else bush(rng)
        parts.append(place(plant, r * np.cos(angle), r * np.sin(angle)))
    parts += [place(sign(1.0, 0.6, 0.5), -ISLAND * np.cos(a) * 0.93, -ISLAND * np.sin(a) * 0.93, a)
              for a in 0.5 * np.pi * np.arange(4)]  # fmt: skip
    line = curve_from_curvature(np.array([-200.0, 0.0]), 0.0, [(200.0, 0.0)], s_start=-200.0)
    for arm in range(4):
        here = [box_at(line, -WALK - 6.0, 0.0, (8.0, 1.2, 0.15), Material.MASONRY),
                box_at(line, -WALK + 5.0, 0.0, (4.0, 1.6, 0.15), Material.MASONRY)]  # fmt: skip
        kerb = np.linspace(0.0, circle.s[-1], 65)
        arc = kerb[(kerb > 0.06 * circle.s[-1]) & (kerb < 0.19 * circle.s[-1])]
        here.append(bar(circle, arc, 0.0, (0.0, 0.12, 0.18), Material.MASONRY))
        for side in (-1.0, 1.0):
            here.append(bar(line, np.array([-200.0, -33.0]), side * KERB, (0.0, 0.12, 0.18), Material.MASONRY))
            here += houses_along(line, (-200.0, -HOUSES), side * 9.5, rng)
            here += trees_along(line, (-120.0, -40.0), side * 6.2, rng)
        parts.append(merge(here).moved(se3.from_yaw(0.5 * np.pi * arm, np.zeros(3))))
    return merge(parts)
