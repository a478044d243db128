"""The scene of the embedded default: a drive through a street with parked cars, traffic and a junction."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from registration import se3
from registration.synthetic.bodies import Body, RigidBody, WalkingBody
from registration.synthetic.cars import HATCHBACK, SEDAN, SUV, VAN, CarShape, car, varied
from registration.synthetic.meshes import Material
from registration.types import Transform
from tracker.errors import InputError
from tracker.kitti.writer import SIMULATED_CALIBRATION
from tracker.simulation.background import street_background
from tracker.simulation.scenes import PERIOD, Actor, Scene
from tracker.simulation.trajectories import (
    Curve,
    Drive,
    EgoDrive,
    Motion,
    Speed,
    SpeedChange,
    Standing,
    curve_from_curvature,
)

IMU_HEIGHT = 0.93  # of the ego car's IMU above the ground [m]
HEADING = 0.35  # of the street at the start, north of east [rad]
BEHIND = 60.0  # how far the street reaches behind the start [m]
JUNCTION = 62.0  # where a side street crosses, along the street [m]
MAX_FRAMES = 600

# Offsets to the left of the ego car's lane, which is the street's line [m].
LEFT_LANE, ONCOMING_LANE = 3.2, 6.6
PARKED_RIGHT, PARKED_LEFT = -3.30, 9.6
WALK_RIGHT, WALK_RIGHT_FAR, WALK_LEFT, WALK_LEFT_FAR = -5.8, -6.7, 12.0, 12.9
APPROACH = 34.0  # of the car that turns: its way until it turns [m]
SIDE_LANE = 1.7  # of the side street's traffic that heads left, beyond its middle [m]

_KINDS = (SEDAN, HATCHBACK, SUV, VAN)
_PAINTS = (Material.PAINT_LIGHT, Material.PAINT_SILVER, Material.PAINT_SILVER, Material.PAINT_DARK)


@dataclass
class _Cast:
    """Collects the actors of a scene, and gives them numbers in the order of their entrance."""

    street: Curve
    rng: np.random.Generator
    actors: list[Actor] = field(default_factory=list)

    def add(self, class_name: str, body: Body, motion: Motion) -> None:
        self.actors.append(Actor(len(self.actors), class_name, body, motion))

    def drive(self, shape: CarShape, curve: Curve, s_start: float, speed: Speed) -> None:
        """Let a car of this kind drive along a curve; `s_start` is that of its rear axle."""
        shape = varied(shape, self.rng)
        motion = Drive(curve, speed, s_start, -IMU_HEIGHT, shape.rear_axle_x)
        self.add(_class_name(shape), self._painted(shape), motion)

    def park(self, shape: CarShape, T_world_obj: Transform) -> None:
        """Let a car of this kind stand."""
        self.add(_class_name(shape), self._painted(shape), Standing(T_world_obj))

    def walk(self, curve: Curve, s_start: float, speed: float) -> None:
        """Let a person walk along a curve."""
        body = WalkingBody(float(self.rng.uniform(1.58, 1.88)), float(self.rng.uniform(0.0, 2.0 * np.pi)))
        self.add("Pedestrian", body, Drive(curve, Speed(speed), s_start, -IMU_HEIGHT))

    def _painted(self, shape: CarShape) -> RigidBody:
        return RigidBody(car(shape, _PAINTS[self.rng.integers(len(_PAINTS))]))


def street_scene(seed: int = 0, n_frames: int = 100) -> Scene:
    """Set the scene: the ego car drives through a bending street, 7 to 10 m/s fast, braking for the car ahead.

    There are parked cars on both sides, those on the right within 3 to 5 m; a car ahead that brakes and speeds up;
    cars in the lane to the left that overtake; a follower; oncoming traffic, one of which turns into the side street;
    a car that crosses, one that stops at the junction; vans; and persons on both walks.  The seed draws the shapes,
    paints, gaps and small differences of speed; who meets whom and where stays the same.

    Args:
        seed: of the scene; its random numbers are its own, apart from those of the sensor.
        n_frames: number of sweeps, 10 a second.

    Raises:
        InputError: fewer than 1 or more than 600 frames: the street is not that long.
    """
    if not 1 <= n_frames <= MAX_FRAMES:
        raise InputError(f"the street scene has 1 to {MAX_FRAMES} frames, got {n_frames}")
    rng = np.random.default_rng([seed, 0])
    street = _street(12.0 * PERIOD * n_frames + 100.0)
    cast = _Cast(street, rng)
    _same_direction(cast)
    _oncoming(cast, 20.0 * PERIOD * n_frames + 50.0)
    _junction(cast)
    _persons(cast)
    _parked(cast, 11.0 * PERIOD * n_frames + 15.0)
    ego = Drive(street, _ego_speed(), 0.0, 0.0)
    return Scene(
        name="street",
        actors=tuple(cast.actors),
        background=street_background(street, JUNCTION, -IMU_HEIGHT, rng),
        ground_z=-IMU_HEIGHT,
        ego=EgoDrive(ego),
        calibration=SIMULATED_CALIBRATION,
        n_frames=n_frames,
    )


def _street(length: float) -> Curve:
    """Draw the street's line; s = 0 is where the ego car starts."""
    start = -BEHIND * np.array([np.cos(HEADING), np.sin(HEADING)])
    bend, back = 1.0 / 110.0, -1.0 / 160.0
    pieces = [
        (BEHIND + 14.0, 0.0), (10.0, bend), (15.0, bend), (10.0, 0.0),  # a bend to the left before the junction
        (66.0, 0.0), (20.0, back), (30.0, back), (20.0, 0.0), (max(length - 185.0, 10.0), 0.0),  # one to the right
    ]  # fmt: skip
    return curve_from_curvature(start, HEADING, pieces, s_start=-BEHIND)


def _lane(street: Curve, offset: float) -> Curve:
    return street.parallel(offset)


def _ego_speed() -> Speed:
    return Speed(9.0, (SpeedChange(1.8, 2.2, -2.0), SpeedChange(5.0, 3.0, 2.6)))


def _same_direction(cast: _Cast) -> None:
    """Set out the cars that drive with the ego car: all end at its speed, so that the scene may last."""
    street, left = cast.street, _lane(cast.street, LEFT_LANE)
    end = 9.6
    leader = Speed(9.0, (SpeedChange(1.0, 2.4, -3.2), SpeedChange(3.8, 3.2, end - 5.8)))
    follower = Speed(9.0, (SpeedChange(2.5, 2.2, -2.0), SpeedChange(5.8, 3.2, end - 7.0)))
    cast.drive(HATCHBACK, street, 18.0, leader)
    cast.drive(SUV, street, -13.5, follower)
    cast.drive(SEDAN, left, -7.0, Speed(10.3, (SpeedChange(5.5, 2.0, end - 10.3),)))
    cast.drive(HATCHBACK, left, -33.0, Speed(12.2, (SpeedChange(7.0, 2.5, end - 12.2),)))
    cast.drive(VAN, left, 25.0, Speed(9.2, (SpeedChange(0.8, 2.0, -1.8), SpeedChange(4.0, 2.5, end - 7.4))))


def _oncoming(cast: _Cast, reach: float) -> None:
    """Set out oncoming cars: one through, one that turns into the side street, and those who wait for it."""
    lane = _lane(cast.street, ONCOMING_LANE).reversed()
    cast.drive(SUV, lane, -66.0, Speed(10.0, (SpeedChange(1.0, 2.5, 1.2),)))
    turn = _turn(cast.street)
    cast.drive(SEDAN, turn, 0.0, Speed(10.0, (SpeedChange(0.9, 3.0, -5.8), SpeedChange(8.8, 2.5, 3.0))))
    delays = (SpeedChange(2.2, 2.4, -3.0), SpeedChange(5.8, 3.0, 3.0))
    for row, s_start in enumerate(np.arange(142.0, max(reach, 150.0), 34.0)):
        shape = (VAN, HATCHBACK, SEDAN, SUV)[row % 4]
        gap = float(cast.rng.uniform(-3.0, 3.0)) if row else 0.0
        cast.drive(shape, lane, -float(s_start) + gap, Speed(10.0, delays))


def _turn(street: Curve) -> Curve:
    """Draw the way of an oncoming car that turns right into the side street; its s = 0 is well before the turn."""
    radius, ramp = 8.0, 4.0
    pieces = [(ramp, -1.0 / radius), (0.5 * np.pi * radius - ramp, -1.0 / radius), (ramp, 0.0)]
    probe = curve_from_curvature(np.zeros(2), 0.0, pieces)
    ahead = float(probe.points[-1, 0])  # how far the turn reaches ahead before it leads sideways
    s_turn = JUNCTION + SIDE_LANE + ahead
    start = s_turn + APPROACH
    x, y = _beside(street, start, ONCOMING_LANE)
    yaw = street.yaw(start) + np.pi
    return curve_from_curvature(np.array([x, y]), yaw, [(APPROACH, 0.0), *pieces, (400.0, 0.0)])


def _beside(street: Curve, s: float, offset: float) -> Float64[np.ndarray, "2"]:
    """Find the point `offset` to the left of the street at s."""
    yaw = street.yaw(s)
    return street.position(s) + offset * np.array([-np.sin(yaw), np.cos(yaw)])


def _junction(cast: _Cast) -> None:
    """Let one car cross the street from right to left, and one stop for the traffic."""
    start = _beside(cast.street, JUNCTION + SIDE_LANE, -80.0)
    side = curve_from_curvature(start, cast.street.yaw(JUNCTION) + 0.5 * np.pi, [(800.0, 0.0)], s_start=-80.0)
    crossing = Speed(8.0, (SpeedChange(1.5, 2.0, 1.5),))
    cast.drive(SEDAN, side, -16.0, crossing)
    cast.drive(SUV, side, -30.5, Speed(7.0, (SpeedChange(0.6, 4.2, -7.0),)))


def _persons(cast: _Cast) -> None:
    """Let persons walk on both sides."""
    offsets = (WALK_RIGHT, WALK_RIGHT_FAR, WALK_LEFT, WALK_LEFT_FAR)
    near, far, left, left_far = (_lane(cast.street, offset) for offset in offsets)
    cast.walk(near, 13.0, 1.35)
    cast.walk(far.reversed(), -46.0, 1.2)
    cast.walk(far, 72.0, 1.45)
    cast.walk(left, 24.0, 1.3)
    cast.walk(left_far.reversed(), -52.0, 1.5)


def _parked(cast: _Cast, end: float) -> None:
    """Line both kerbs with parked cars, with gaps, and none in the junction."""
    for offset, emptiness, is_facing in ((PARKED_RIGHT, 0.30, False), (PARKED_LEFT, 0.45, True)):
        s = -14.0
        while s < end:
            kind = _KINDS[cast.rng.choice(len(_KINDS), p=[0.32, 0.36, 0.24, 0.08])]
            if cast.rng.uniform() > emptiness and abs(s - JUNCTION) > 12.0:
                pose = _parked_pose(cast, s, offset, is_facing)
                cast.park(varied(kind, cast.rng), pose)
            s += float(cast.rng.uniform(6.0, 7.6))


def _parked_pose(cast: _Cast, s: float, offset: float, is_facing: bool) -> Transform:
    """Park beside the kerb, a little crooked."""
    sideways, crooked = cast.rng.normal(0.0, [0.06, 0.012])
    x, y = _beside(cast.street, s, offset + float(np.clip(sideways, -0.12, 0.12)))
    yaw = cast.street.yaw(s) + float(crooked) + (np.pi if is_facing else 0.0)
    return se3.from_yaw(yaw, np.array([x, y, -IMU_HEIGHT]))


def _class_name(shape: CarShape) -> str:
    """KITTI calls a car with a tall box a van."""
    return "Car" if shape.has_rear_windows else "Van"
