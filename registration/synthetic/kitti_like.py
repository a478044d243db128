"""Sets of pairs like those cut from KITTI tracklets: traffic drawn from the labels' statistics, seen by an HDL-64E.

An object stands on the ground, among what may stand beside and before it; the sweep's rolling shutter bends it; a
label box with KITTI's jitter cuts it out, with the ground and the neighbours that reach into the box.  The truth is
exact: the poses that the object has when the beams pass its centre, where labels, made by looking at points, put it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from registration import planar, se3
from registration.errors import PairSetError, unknown_name
from registration.pair_set import CloudPair
from registration.synthetic import traffic
from registration.synthetic.aim import beams_towards, distance_to_box
from registration.synthetic.bodies import Body, draw_body
from registration.synthetic.lidar import HDL_64E, BeamModel, PlacedMesh, Turn, pose_after, scan
from registration.synthetic.lidar.motion import Twist
from registration.synthetic.scenery import (
    Ground,
    Neighbour,
    Occluder,
    draw_ground,
    draw_hidden_shares,
    draw_neighbour,
    draw_occluder,
    ground_patch,
    place_neighbour,
    place_occluder,
)
from registration.synthetic.traffic import Motion, Sight, Traffic, kitti_traffic
from registration.types import Point, Points, Transform

KITTI_LIKE_SETS = {
    "kitti-like-cars": ("vehicles",),
    "kitti-like-cars-persons": ("vehicles", "persons"),
}
HARD = "-hard"
CONSECUTIVE = 0.5  # share of pairs of consecutive frames; the other gaps, up to traffic.MAX_GAP, are equally likely
AIR = np.array([0.1, 0.1, 0.05])  # that a label box has around its object: length, width, height [m]
CLEARANCE = 1.2  # an object's box is no nearer to the sensor, which is on a car of its own [m]
FARTHEST = 80.0  # the centre of a box is no farther [m]
WALK = 1.8  # fastest walk of a person [m/s]


class Subject(NamedTuple):
    """What is looked at, both times.

    Attributes:
        class_name: KITTI's word.
        size: of the label box: length, width, height [m].
        body: its shape.
        neighbour: what is beside it.
        occluder: what is before it, at one time at least.
    """

    class_name: str
    size: Point
    body: Body
    neighbour: Neighbour | None
    occluder: Occluder | None


class Look(NamedTuple):
    """The subject at one time.

    Attributes:
        sight: where it is.
        motion: how it moves.
        ground: what it stands on.
        hidden: share of its angular width that is hidden.
        walked: way that it has gone, for a body that walks [m].
        jitter: of its label: along, across and above its axes [m], and in yaw [rad].
    """

    sight: Sight
    motion: Motion
    ground: Ground
    hidden: float
    walked: float
    jitter: Float64[np.ndarray, "4"]


@dataclass(frozen=True)
class KittiLikeScenes:
    """Recipe of a set that follows the statistics of KITTI's tracklets.

    Regular sets pair frames up to `traffic.MAX_GAP` apart, between which the object keeps its motion relative to the
    sensor.  Hard ones pair frames at least as far apart between which it turned by 45 degrees or more; both places
    are drawn then.  As in the sets cut from KITTI, the second cloud is moved to the first one's ground.

    Attributes:
        name: of the set.
        groups: whose statistics are followed, each as often as it has labels.
        is_hard: pairs far apart instead of near ones.
        beam_model: the sensor.
        allow_empty: whether a cloud may be empty.
    """

    name: str
    groups: tuple[str, ...]
    is_hard: bool = False
    beam_model: BeamModel = HDL_64E
    allow_empty: bool = False

    def describe(self) -> dict[str, Any]:
        """Tell all that decides what pairs come out."""
        return {
            "classes": [name for group in self.groups for name in traffic.GROUPS[group]],
            "is_hard": self.is_hard,
            "statistics": "KITTI tracking labels of the sequences " + " ".join(traffic.source_sequences()),
            "meshes": "parametric families",
            "beam_model": self.beam_model.name,
            "allow_empty": self.allow_empty,
        }

    def check(self, parts: Sequence[str]) -> None:
        """Nothing can be missing: bodies are drawn, and the statistics come with the package."""

    def draw(self, part: str, rng: np.random.Generator) -> CloudPair | None:
        """Draw an object in traffic and look at it twice; None where it would be too near or too far."""
        weights = np.array([kitti_traffic(group).n_boxes for group in self.groups], dtype=np.float64)
        statistics = kitti_traffic(self.groups[int(rng.choice(len(self.groups), p=weights / weights.sum()))])
        class_name = statistics.class_name(rng)
        size = statistics.size(class_name, rng)
        gap, sights, motions = (_far_apart if self.is_hard else _near)(statistics, rng)
        if not all(_is_in_sight(sight, size) for sight in sights):
            return None
        hidden = _hidden_shares(sights[0].range_m, gap, statistics, rng)
        subject = Subject(
            class_name,
            size,
            body=draw_body(class_name, rng, size - AIR),
            neighbour=draw_neighbour(size, statistics, rng),
            occluder=draw_occluder(max(hidden), statistics, rng) if any(hidden) else None,
        )
        looks = self._looks(sights, motions, hidden, gap, statistics, rng)
        clouds = [self.see(subject, look, rng) for look in looks]
        return _pair(subject, looks, clouds, gap)

    def _looks(
        self,
        sights: tuple[Sight, Sight],
        motions: tuple[Motion, Motion],
        hidden: tuple[float, float],
        gap: int,
        statistics: Traffic,
        rng: np.random.Generator,
    ) -> tuple[Look, Look]:
        """Draw what else differs between the two times."""
        ground = draw_ground(sights[0], statistics, rng)
        grounds = (ground, draw_ground(sights[1], statistics, rng) if self.is_hard else ground)
        walked = (0.0, float(rng.uniform(0.0, WALK)) * gap * traffic.PERIOD)
        jitters = [statistics.jitter(sight.range_m, rng) for sight in sights]
        first, second = (Look(*parts) for parts in zip(sights, motions, grounds, hidden, walked, jitters, strict=True))
        return first, second

    def see(self, subject: Subject, look: Look, rng: np.random.Generator) -> tuple[Points, int]:
        """Scan the subject and what is around it once.

        Returns:
            the points in its label's box [m], and the number of things that stand before it.
        """
        T_lidar_box = _true_pose(look, subject.size)
        T_lidar_obj = T_lidar_box @ se3.from_yaw(0.0, np.array([0.0, 0.0, -0.5 * subject.size[2]]))
        objects = [PlacedMesh(subject.body.mesh(look.walked), T_lidar_obj)]
        if subject.neighbour is not None:
            objects.append(place_neighbour(subject.neighbour, T_lidar_obj, look.ground))
        twist = _twist(look.sight, look.motion)
        # Scans place things as they are when the beams point forward; a label encloses what was seen later, or before.
        T_forward_now = pose_after(twist, -_passing_time(self.beam_model, look.sight.bearing))
        objects = [PlacedMesh(mesh, T_forward_now @ T, twist) for mesh, T, _ in objects]  # a neighbour moves along
        occluder = subject.occluder
        before = occluder and place_occluder(occluder, look.sight, subject.size, look.hidden, look.ground)
        objects += [] if before is None else [before]
        patch = ground_patch(look.ground, look.sight.xy, 2.0 * float(np.linalg.norm(subject.size)))
        slack = 0.5 * self.beam_model.period * _speed(look) + float(np.abs(look.jitter[:3]).max())
        sweep = scan(objects, beams_towards(self.beam_model, T_lidar_box, subject.size, slack), rng, patch)
        T_box_label = se3.from_yaw(float(look.jitter[3]), look.jitter[:3])
        T_label_lidar = se3.invert(T_lidar_box @ T_box_label)
        is_inside = np.abs(se3.transform(T_label_lidar, sweep.points_lidar)) <= 0.5 * subject.size
        return sweep.points_lidar[is_inside.all(axis=1)], int(before is not None)


def kitti_like_names() -> list[str]:
    """List the sets that `kitti_like_scenes` knows."""
    return [name + suffix for name in KITTI_LIKE_SETS for suffix in ("", HARD)]


def kitti_like_scenes(name: str) -> KittiLikeScenes:
    """Set up the recipe of a set.

    Raises:
        PairSetError: no such set.
    """
    if name not in kitti_like_names():
        raise PairSetError(unknown_name("set of pairs", name, kitti_like_names()))
    return KittiLikeScenes(name, KITTI_LIKE_SETS[name.removesuffix(HARD)], is_hard=name.endswith(HARD))


def _near(statistics: Traffic, rng: np.random.Generator) -> tuple[int, tuple[Sight, Sight], tuple[Motion, Motion]]:
    """Draw how many frames lie between the looks, and where the object is then: it keeps its motion."""
    gap = 1 if rng.uniform() < CONSECUTIVE else int(rng.integers(2, traffic.MAX_GAP + 1))
    sight = statistics.sight(rng)
    motion = statistics.motion(sight, rng)
    T_end = pose_after(_twist(sight, motion), gap * traffic.PERIOD) @ se3.from_yaw(
        sight.yaw, np.array([*sight.xy, 0.0])
    )
    x, y = T_end[:2, 3]
    end = Sight(float(np.hypot(x, y)), float(np.arctan2(y, x)), se3.yaw(T_end))
    return gap, (sight, end), (motion, motion)


def _far_apart(statistics: Traffic, rng: np.random.Generator) -> tuple[int, tuple[Sight, Sight], tuple[Motion, Motion]]:
    """Draw how many frames lie between the looks, and where the object is then."""
    gap, (start, end) = statistics.hard_gap(rng), statistics.hard_sights(rng)
    return gap, (start, end), (statistics.motion(start, rng), statistics.motion(end, rng))


def _hidden_shares(range_m: float, gap: int, statistics: Traffic, rng: np.random.Generator) -> tuple[float, float]:
    """Draw the hidden share of the object's width at both looks."""
    first = statistics.occlusion(range_m, rng)
    return draw_hidden_shares((first, statistics.occlusion_later(first, gap, rng)), gap, rng)


def _is_in_sight(sight: Sight, size: Point) -> bool:
    """Tell whether an object is before the sensor, on a road of its own, and not too far."""
    free = distance_to_box(se3.from_yaw(sight.yaw, np.array([*sight.xy, 0.0])), size)
    return bool(free >= CLEARANCE and sight.range_m <= FARTHEST and abs(sight.bearing) <= 0.5 * np.pi)


def _twist(sight: Sight, motion: Motion) -> Twist:
    """Write an object's motion relative to the sensor as a twist in the sensor's axes."""
    x, y = sight.xy
    at_sensor = planar.rotation(sight.yaw) @ motion.velocity - motion.turn_rate * np.array([-y, x])
    return np.array([*at_sensor, 0.0, 0.0, 0.0, motion.turn_rate])


def _passing_time(beam_model: BeamModel, bearing: float) -> float:
    """Tell when the beams pass a bearing [rad], after the moment when they point forward [s]."""
    sense = -1.0 if beam_model.turn == Turn.CLOCKWISE else 1.0
    return sense * beam_model.period * bearing / (2.0 * np.pi)


def _speed(look: Look) -> float:
    """Bound the speed of any point of the subject relative to the sensor [m/s]."""
    return float(np.hypot(*look.motion.velocity)) + 5.0 * abs(look.motion.turn_rate)


def _true_pose(look: Look, size: Point) -> Transform:
    """Stand the subject's box on the ground: T_lidar_box, origin at its centre."""
    xy = look.sight.xy
    return se3.from_yaw(look.sight.yaw, np.array([*xy, look.ground.z(xy) + 0.5 * size[2]]))


def _pair(subject: Subject, looks: tuple[Look, Look], clouds: list[tuple[Points, int]], gap: int) -> CloudPair:
    """Put both looks on one ground, and say what is true of them."""
    start, end = (_true_pose(look, subject.size) for look in looks)
    level = np.array([0.0, 0.0, start[2, 3] - end[2, 3]])
    yaw = looks[0].sight.yaw
    (source, n_first), (target, n_second) = clouds
    extra = {
        "class": subject.class_name,
        "gap": gap,
        "dt": gap * traffic.PERIOD,
        "range": looks[0].sight.range_m,
        "size": subject.size.tolist(),
        "n_occluders": [n_first, n_second],
        "hidden": [look.hidden for look in looks],
        "has_neighbour": subject.neighbour is not None,
        "label_jitter": [look.jitter.tolist() for look in looks],
    }
    return CloudPair(
        source=source,
        target=target + level,
        start_position=start[:3, 3].copy(),
        end_position=end[:3, 3] + level,
        start_angle=yaw,
        end_angle=yaw + planar.wrap(looks[1].sight.yaw - yaw),
        extra=extra,
    )
