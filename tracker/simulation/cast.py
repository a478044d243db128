"""The cast of a scene: who is in it, that nobody gets into anybody's way, and who looks on."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from registration import se3
from registration.synthetic.bodies import Body, draw_body
from registration.synthetic.meshes import Mesh
from registration.types import Point
from tracker.errors import InputError
from tracker.kitti.writer import SIMULATED_CALIBRATION
from tracker.simulation.footprints import Track, corners, outline, separations
from tracker.simulation.planning import STEP, Occupancy, Style, plan_speed
from tracker.simulation.scenes import PERIOD, Actor, Scene
from tracker.simulation.speeds import SpeedProfile
from tracker.simulation.trajectories import Curve, Drive, EgoDrive, Standing
from tracker.simulation.walkers import draw_walker

IMU_HEIGHT = 0.93  # of the ego car's IMU above the ground [m]
EGO_SIZE = np.array([4.75, 1.82, 1.5])  # [m]
EGO_CENTER = np.array([1.35, -0.31])  # of the ego car, seen from its IMU [m]
MAX_FRAMES = 300
ATTEMPTS = 30  # at a cast that has room for the ego car
MARGIN = 0.2  # between any two [m]
PERSONS = ("Pedestrian", "Person_sitting")
LABELS = {"Bus": "Misc"}  # bodies for which KITTI has no word of its own

_LEAD = 1.0  # how long before the first sweep, and after the last, everybody is looked after [s]
_STRIDE = round(STEP / PERIOD)


Steps = Int64[np.ndarray, " _"]


class Stop(NamedTuple):
    """A place on a path that is closed for a time: a red light.

    Attributes:
        s: where [m].
        start: from when [s].
        end: until when [s].
    """

    s: float
    start: float
    end: float


class Character(NamedTuple):
    """Who may join a cast.

    Attributes:
        class_name: KITTI's word.
        body: what it looks like.
    """

    class_name: str
    body: Body

    @property
    def axle_x(self) -> float:
        """What follows a path: about the rear axle, or a person's hips [m]."""
        return 0.0 if self.class_name in PERSONS else -0.28 * float(self.body.size[0])


@dataclass(frozen=True)
class _Member:
    """Somebody in the cast, or, without a character, something that nobody may run into; in the site's frame."""

    who: Character | None
    motion: Drive | Standing
    track: Track
    size: Point


class Cast:
    """Collects a scene's actors one after the other; each gives way to all who came before.

    Whoever would still touch another is not taken.  Places are those of the site: any level frame; z = 0 is the ground.

    Args:
        rng: source of bodies.
        n_frames: length of the scene.

    Raises:
        InputError: fewer than 1 or more than 300 frames.
    """

    def __init__(self, rng: np.random.Generator, n_frames: int) -> None:
        if not 1 <= n_frames <= MAX_FRAMES:
            raise InputError(f"a scene has 1 to {MAX_FRAMES} frames, got {n_frames}")
        self.rng = rng
        self.n_frames = n_frames
        n_lead = round(_LEAD / PERIOD)
        self.times = PERIOD * np.arange(-n_lead, n_frames + n_lead + 1)
        self._members: list[_Member] = []
        self._ego: Drive | None = None

    @property
    def has_ego(self) -> bool:
        """Whether the car with the sensor has found its place."""
        return self._ego is not None

    @property
    def end(self) -> float:
        """Time of the last sweep [s]."""
        return PERIOD * (self.n_frames - 1)

    def draw(self, class_name: str, size: Point | None = None) -> Character:
        """Draw somebody of a class, or a bus, and, if a size is given, of that length, width and height [m]."""
        if class_name == "Pedestrian" and size is None:
            return Character(class_name, draw_walker(self.rng))
        return Character(LABELS.get(class_name, class_name), draw_body(class_name, self.rng, size))

    def draw_standing(self) -> Character:
        """Draw a person who stands."""
        return Character("Pedestrian", draw_walker(self.rng, is_standing=True))

    def enter(self, who: Character, path: Curve, s: float, style: Style, stops: Sequence[Stop] = ()) -> bool:
        """Let somebody go along a path at speeds that suit everybody who is there already.

        Args:
            who: enters.
            path: of the rear axle, or of a person's hips.
            s: where on it the axle is a second before the first sweep [m].
            style: of the driver.
            stops: red lights on the path.

        Returns:
            Whether there was room.
        """
        length, width, _ = who.body.size
        ends = (-0.5 * float(length) - who.axle_x, 0.5 * float(length) - who.axle_x)
        occupancy = self._occupancy(path, 0.5 * float(width) + 0.35, stops)
        speed = plan_speed(path, s, style, ends, occupancy, self.times[::_STRIDE])
        if speed.speeds.min() < style.slowest:
            return False
        return self._join(who, Drive(path, speed, s - speed.distance(self.times[0]), 0.0, who.axle_x))

    def lead(self, who: Character, path: Curve, s: float, speed: SpeedProfile) -> bool:
        """Let somebody go along a path as it likes, the axle at s at time 0; False when someone is in the way."""
        return self._join(who, Drive(path, speed, s, 0.0, who.axle_x))

    def stand(self, who: Character, x: float, y: float, yaw: float) -> bool:
        """Let somebody stand, or a car be parked; False when someone is in the way."""
        return self._join(who, Standing(se3.from_yaw(yaw, np.array([x, y, 0.0]))))

    def close(self, x: float, y: float, yaw: float, length: float, width: float) -> None:
        """Keep everybody who comes later out of a rectangle around (x, y)."""
        motion = Standing(se3.from_yaw(yaw, np.array([x, y, 0.0])))
        size = np.array([length, width, 1.0])
        self._members.append(_Member(None, motion, np.tile([x, y, yaw], (len(self.times), 1)), size))

    def drive_ego(self, path: Curve, s: float, style: Style, stops: Sequence[Stop] = ()) -> bool:
        """Let the car with the sensor go along a path, its middle on it; as `enter`, and nobody else is the ego car."""
        path = path.parallel(-float(EGO_CENTER[1]))
        occupancy = self._occupancy(path, 0.5 * float(EGO_SIZE[1]) + 0.7, stops)
        ends = (float(EGO_CENTER[0] - 0.5 * EGO_SIZE[0]), float(EGO_CENTER[0] + 0.5 * EGO_SIZE[0]))
        speed = plan_speed(path, s, style, ends, occupancy, self.times[::_STRIDE])
        if speed.speeds.min() < style.slowest:
            return False
        return self.lead_ego(path, s - speed.distance(self.times[0]), speed)

    def lead_ego(self, path: Curve, s: float, speed: SpeedProfile) -> bool:
        """Let the car with the sensor go along a path as it likes: its IMU is at s on it at time 0."""
        drive = Drive(path, speed, s, 0.0)
        track = drive.track(self.times)
        c, d = np.cos(track[:, 2]), np.sin(track[:, 2])
        track[:, 0] += EGO_CENTER[0] * c - EGO_CENTER[1] * d
        track[:, 1] += EGO_CENTER[0] * d + EGO_CENTER[1] * c
        member = _Member(None, drive, track, EGO_SIZE)
        if not self._is_free(member):
            return False
        self._members.append(member)
        self._ego = drive
        return True

    def scene(self, name: str, background: Mesh, heading: float) -> Scene:
        """Move everything into the world, which starts at the ego car's IMU.

        Args:
            name: of the scene.
            background: what never moves, in the site's frame.
            heading: of the ego car at time 0 in the world, north of east [rad].

        Raises:
            InputError: there is no ego car.
        """
        if self._ego is None:
            raise InputError("a scene needs a car with the sensor")
        T_world_site = se3.from_yaw(heading, np.zeros(3)) @ se3.invert(self._ego.pose(0.0))
        T_world_ground = se3.from_yaw(0.0, np.array([0.0, 0.0, -IMU_HEIGHT])) @ T_world_site
        paths = {id(member.motion.curve): member.motion.curve.moved(T_world_site)
                 for member in self._members if isinstance(member.motion, Drive)}  # fmt: skip
        actors: list[Actor] = []
        for who, motion in ((member.who, member.motion) for member in self._members):
            if who is not None:
                there = (dataclasses.replace(motion, curve=paths[id(motion.curve)], z=-IMU_HEIGHT)
                         if isinstance(motion, Drive) else Standing(T_world_ground @ motion.T_world_obj))  # fmt: skip
                actors.append(Actor(len(actors), *who, there))
        ego = EgoDrive(dataclasses.replace(self._ego, curve=paths[id(self._ego.curve)]))
        ground = background.moved(T_world_ground)
        return Scene(name, tuple(actors), ground, -IMU_HEIGHT, ego, SIMULATED_CALIBRATION, self.n_frames)

    def _join(self, who: Character, motion: Drive | Standing) -> bool:
        member = _Member(who, motion, motion.track(self.times), who.body.size)
        if self._is_free(member):
            self._members.append(member)
            return True
        return False

    def _is_free(self, new: _Member) -> bool:
        """Tell whether a newcomer never comes near anybody."""
        if not self._members:
            return True
        tracks = np.stack([member.track for member in self._members])
        sizes = np.stack([member.size[:2] for member in self._members])
        reach = 0.5 * (np.hypot(*sizes.T) + np.hypot(*new.size[:2])) + MARGIN
        apart = np.hypot(tracks[..., 0] - new.track[:, 0], tracks[..., 1] - new.track[:, 1])
        who, when = np.nonzero(apart < reach[:, None])
        theirs = corners(tracks[who, when], sizes[who])
        ours = corners(new.track[when], np.broadcast_to(new.size[:2], (len(when), 2)))
        return bool((separations(ours, theirs) > MARGIN).all())

    def _near(self, tree: cKDTree, clearance: float) -> list[tuple[_Member, Steps]]:
        """List who comes near a path, and at which steps; for those who stand, one is enough."""
        if not self._members:
            return []
        centers = np.array([member.track[::_STRIDE, :2] for member in self._members])
        reach = clearance + 0.5 + 0.5 * np.array([np.hypot(*member.size[:2]) for member in self._members])
        is_near = tree.query(centers, distance_upper_bound=float(reach.max()))[0] < reach[:, None]
        return [(self._members[i], np.flatnonzero(is_near[i])) for i in np.flatnonzero(is_near.any(axis=1))]

    def _occupancy(self, path: Curve, clearance: float, stops: Sequence[Stop]) -> Occupancy:
        """Find out which part of a path everybody takes at each step."""
        times = self.times[::_STRIDE]
        s = np.arange(path.s[0], path.s[-1], 0.5)
        way = path.track(s)
        tree = cKDTree(way[:, :2])
        parts = []
        for member, when in self._near(tree, clearance):
            part = _part(tree, member, clearance, when)
            if part is not None:
                parts.append(_measured(part, s, way, member))
        for stop in stops:
            is_closed = (stop.start <= times) & (times < stop.end)
            parts.append(np.where(is_closed, np.array([[stop.s], [stop.s + 0.5], [0.0]]), np.nan))
        low, high, pace = np.stack(parts, axis=1) if parts else np.zeros((3, 0, len(times)))
        return Occupancy(low, high, np.nan_to_num(pace))


def _part(tree: cKDTree, member: _Member, clearance: float, when: Steps) -> Float64[np.ndarray, "2 n"] | None:
    """Find the first and last point of a path that a member is on at some steps; infinite where there is none."""
    is_standing = isinstance(member.motion, Standing)
    when = when[:1] if is_standing else when
    track = member.track[::_STRIDE]
    distance, index = tree.query(outline(track[when], member.size), distance_upper_bound=clearance)
    is_on = np.isfinite(distance)
    if not is_on.any():
        return None
    part = np.full((2, len(track)), np.inf)
    part[0, when] = np.where(is_on, index, np.inf).min(axis=1)
    part[1, when] = np.where(is_on, index, -np.inf).max(axis=1)
    if is_standing:
        part[:] = part[:, :1]
    return part


def _measured(
    part: Float64[np.ndarray, "2 n"], s: Float64[np.ndarray, " m"], way: Float64[np.ndarray, "m 3"], member: _Member
) -> Float64[np.ndarray, "3 n"]:
    """Say where the part of a path begins and ends [m], and how fast its taker goes along it [m/s]; NaN for none."""
    is_on = np.isfinite(part[0])
    first, last = np.where(is_on, part, 0.0).astype(np.int64)
    velocity = np.gradient(member.track[:, :2], PERIOD, axis=0)[::_STRIDE]
    yaw = way[(first + last) // 2, 2]
    pace = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    return np.where(is_on, np.stack([s[first], s[last], pace]), np.nan)


def cast_with_ego(rng: np.random.Generator, n_frames: int, fill: Callable[[Cast], object]) -> Cast:
    """Fill a cast; from the start again when there was no room for the ego car, which is rare.

    Raises:
        InputError: there never was, or fewer than 1 or more than 300 frames.
    """
    for _ in range(ATTEMPTS):
        cast = Cast(rng, n_frames)
        fill(cast)
        if cast.has_ego:
            return cast
    raise InputError("the scene has no room for the car with the sensor; another seed may have")
