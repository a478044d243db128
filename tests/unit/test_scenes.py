"""The traffic scenes: plausible motions, nobody in anybody's way, and what each scene is there for."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from evaluation.delay import acceleration_steps
from registration import se3
from registration.synthetic.bodies import RigidBody
from registration.synthetic.lidar import HDL_64E, BeamModel
from registration.synthetic.meshes import merge
from tracker.errors import InputError
from tracker.simulation import create_scene
from tracker.simulation.cast import EGO_CENTER, EGO_SIZE, Cast, Stop, cast_with_ego
from tracker.simulation.catalogue import SCENES
from tracker.simulation.folder import simulate_frame
from tracker.simulation.footprints import corners, separations
from tracker.simulation.planning import Occupancy, Style, plan_speed
from tracker.simulation.scenes import CLASSES, Scene
from tracker.simulation.speeds import SampledSpeed, Speed
from tracker.simulation.trajectories import Standing, curve_from_curvature

COARSE = BeamModel("coarse", HDL_64E.elevations[::4], float(np.deg2rad(0.7)))
NEW = ["highway", "crossing", "parked-row", "roundabout", "crowd", "braking"]
LONG = {"highway": 110, "crossing": 180, "parked-row": 300, "roundabout": 200, "crowd": 40, "braking": 100}
SHORT = 30  # frames with seed 1; those above with seed 0
# What their docstrings say: hardest braking, acceleration, and the one across [m/s^2]; the highest speed [m/s].
RANGES = {
    "highway": (4.0, 1.8, 2.5, 36.0),
    "crossing": (4.0, 2.3, 3.2, 14.5),
    "parked-row": (0.5, 0.5, 1.6, 16.0),
    "roundabout": (4.0, 2.2, 3.3, 13.2),
    "crowd": (3.0, 1.1, 2.0, 5.2),
    "braking": (7.5, 4.1, 1.5, 18.1),
}
CASES = [(name, 0, n_frames) for name, n_frames in LONG.items()] + [(name, 1, SHORT) for name in NEW]
STRAIGHT = curve_from_curvature(np.zeros(2), 0.0, [(300.0, 0.0)])


@cache
def scene_of(name: str, seed: int, n_frames: int) -> Scene:
    return create_scene(name, seed, n_frames)


def times_of(scene: Scene, step: float = 0.1) -> np.ndarray:
    """Half a sweep before the first and half a sweep after the last belong to the scene: the sensor is turning."""
    return np.arange(-0.05, (scene.n_frames - 1) * scene.period + 0.06, step)


def tracks_of(scene: Scene, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give places and sizes of the ego car, then of all actors."""
    drives = [scene.ego.drive, *(actor.motion for actor in scene.actors)]
    tracks = np.stack([drive.track(times) for drive in drives])
    c, s = np.cos(tracks[0, :, 2]), np.sin(tracks[0, :, 2])
    tracks[0, :, :2] += np.column_stack([c, s]) * EGO_CENTER[0] + np.column_stack([-s, c]) * EGO_CENTER[1]
    return tracks, np.stack([EGO_SIZE, *(actor.body.size for actor in scene.actors)])


def motions(scene: Scene, times: np.ndarray, h: float = 0.01) -> dict[str, np.ndarray]:
    """Differentiate the ways of the axles of all that drive, and of the ego car's."""
    drives = [scene.ego.drive, *(a.motion for a in scene.actors if not isinstance(a.motion, Standing))]
    before, now, after = (
        np.stack([dataclasses.replace(d, axle_x=0.0).track(times + dt) for d in drives]) for dt in (-h, 0.0, h)
    )
    velocity, pull = (after - before)[..., :2] / (2 * h), (after - 2 * now + before)[..., :2] / h**2
    c, s = np.cos(now[..., 2]), np.sin(now[..., 2])
    return {
        "speed": velocity[..., 0] * c + velocity[..., 1] * s,
        "slip": -velocity[..., 0] * s + velocity[..., 1] * c,
        "along": pull[..., 0] * c + pull[..., 1] * s,
        "across": -pull[..., 0] * s + pull[..., 1] * c,
        "yaw": np.unwrap(now[..., 2], axis=1),
    }


# --- what holds for all scenes


@pytest.mark.parametrize(("name", "seed", "n_frames"), CASES)
def test_nobody_touches_anybody_else_or_the_ego_car(name, seed, n_frames):
    scene = scene_of(name, seed, n_frames)
    tracks, sizes = tracks_of(scene, times_of(scene))
    reach = 0.5 * np.hypot(sizes[:, 0], sizes[:, 1])
    for i in range(len(tracks) - 1):
        apart = np.linalg.norm(tracks[i + 1 :, :, :2] - tracks[i, :, :2], axis=-1)
        who, when = np.nonzero(apart < reach[i] + reach[i + 1 :, None] + 0.3)
        ours = corners(tracks[i, when], np.broadcast_to(sizes[i, :2], (len(who), 2)))
        gaps = separations(ours, corners(tracks[i + 1 :][who, when], sizes[i + 1 :][who, :2]))
        assert gaps.min(initial=1.0) > 0.1, f"{i - 1} and {i + who[gaps.argmin()]}"


@pytest.mark.parametrize(("name", "seed", "n_frames"), CASES)
def test_nobody_runs_into_what_stands_around(name, seed, n_frames):
    scene = scene_of(name, seed, n_frames)
    points, heights = background_lines(scene)
    tracks, sizes = tracks_of(scene, times_of(scene, 0.5))
    tree = cKDTree(points)
    for track, size in zip(tracks, sizes, strict=True):
        near = tree.query_ball_point(track[:, :2], 0.5 * np.hypot(*size[:2]))
        for (x, y, yaw), index in zip(track, near, strict=True):
            shifted = points[index] - [x, y]
            along = shifted @ [np.cos(yaw), np.sin(yaw)]
            across = shifted @ [-np.sin(yaw), np.cos(yaw)]
            inside = (np.abs(along) < 0.5 * size[0]) & (np.abs(across) < 0.5 * size[1])
            assert not (inside & (heights[index] < size[2])).any(), f"{name}: at {x:.1f}, {y:.1f}"


def background_lines(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Sample the edges of all triangles above kerb height, seen from above, and how high their lowest point is."""
    corners_3d = scene.background.vertices[scene.background.triangles] - [0.0, 0.0, scene.ground_z]
    z = corners_3d[..., 2]
    standing = corners_3d[(z.max(axis=1) > 0.2) & (z.min(axis=1) < 4.5)]
    lowest = standing[..., 2].min(axis=1)
    points, heights = [], []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, way = standing[:, a, :2], standing[:, b, :2] - standing[:, a, :2]
        n = np.ceil(np.linalg.norm(way, axis=1) / 0.3).astype(int) + 1
        row = np.repeat(np.arange(len(n)), n)
        share = (np.arange(len(row)) - np.repeat(np.cumsum(n) - n, n)) / np.maximum(n[row] - 1, 1)
        points.append(start[row] + share[:, None] * way[row])
        heights.append(lowest[row])
    return np.concatenate(points), np.concatenate(heights)


@pytest.mark.parametrize(("name", "seed", "n_frames"), CASES)
def test_all_motions_are_smooth_and_within_what_tyres_and_legs_can_do(name, seed, n_frames):
    scene = scene_of(name, seed, n_frames)
    times = times_of(scene, 0.05)
    moving = motions(scene, times)
    hardest_braking, acceleration, across, fastest = RANGES[name]
    assert -hardest_braking < moving["along"].min() <= moving["along"].max() < acceleration
    assert np.abs(moving["across"]).max() < across
    assert -1e-9 < moving["speed"].min() <= moving["speed"].max() < fastest
    assert np.abs(np.diff(moving["along"], axis=1)).max() < 0.05 * 16.0
    assert np.abs(np.diff(moving["yaw"], axis=1)).max() < 0.12
    assert np.abs(moving["slip"]).max() < 0.05, "wheels do not slide"


@pytest.mark.parametrize(("name", "seed", "n_frames"), CASES)
def test_everybody_stands_on_the_ground_and_keeps_one_body(name, seed, n_frames):
    scene = scene_of(name, seed, n_frames)
    for actor in scene.actors:
        T_world_obj = actor.T_world_obj(0.4)
        assert T_world_obj[2, 3] == pytest.approx(scene.ground_z, abs=1e-9)
        np.testing.assert_allclose(T_world_obj[:3, 2], [0.0, 0.0, 1.0], atol=1e-12)
        if isinstance(actor.body, RigidBody):
            assert actor.mesh(0.0) is actor.mesh(3.0), "ray casting knows meshes by their identity"
    assert [actor.track_id for actor in scene.actors] == list(range(len(scene.actors)))
    assert len(scene.background.triangles) < 60_000
    assert scene.background.vertices[:, 2].min() == pytest.approx(scene.ground_z, abs=0.8)  # bushes have roots
    np.testing.assert_allclose(scene.T_world_imu(0.0)[:3, 3], 0.0, atol=1e-9)


@pytest.mark.parametrize("name", NEW)
def test_poses_are_known_a_little_before_and_after(name):
    scene = scene_of(name, 1, SHORT)
    end = (scene.n_frames - 1) * scene.period
    for t in (0.0, end):
        poses = np.stack([scene.T_world_lidar(t + dt) for dt in (-0.05, 0.0, 0.05)])
        step = np.diff(poses[:, :3, 3], axis=0)
        np.testing.assert_allclose(step[0], step[1], atol=0.02)
        for actor in scene.actors[:10]:
            there = np.stack([actor.T_world_obj(t + dt)[:3, 3] for dt in (-0.05, 0.0, 0.05)])
            np.testing.assert_allclose(there[1] - there[0], there[2] - there[1], atol=0.02)


@pytest.mark.parametrize("name", NEW)
def test_a_seed_gives_the_same_scene_and_another_seed_another_one(name):
    scene, again = scene_of(name, 1, SHORT), create_scene(name, 1, SHORT)
    for actor, same in zip(scene.actors, again.actors, strict=True):
        np.testing.assert_array_equal(actor.T_world_obj(2.0), same.T_world_obj(2.0))
        np.testing.assert_array_equal(actor.body.size, same.body.size)
    np.testing.assert_array_equal(scene.background.vertices, again.background.vertices)
    other = scene_of(name, 0, LONG[name])
    assert seen_by_ego(scene) != seen_by_ego(other), "who meets whom changes too"


def seen_by_ego(scene: Scene) -> list[tuple[str, int]]:
    """List who comes within 15 m of the ego car, and at which second first."""
    times = np.arange(0.0, 3.9, 0.1)
    tracks, _ = tracks_of(scene, times)
    is_near = np.linalg.norm(tracks[1:, :, :2] - tracks[0, :, :2], axis=-1) < 15.0
    return [(scene.actors[i].class_name, int(times[is_near[i].argmax()])) for i in np.flatnonzero(is_near.any(axis=1))]


@pytest.mark.parametrize("name", NEW)
def test_labels_have_returns(name):
    scene = scene_of(name, 1, SHORT)
    simulated = simulate_frame(scene, 20, beam_model=COARSE)
    ids = {actor.track_id: row for row, actor in enumerate(scene.actors)}
    assert len(simulated.boxes) >= 4
    for box in simulated.boxes:
        assert (simulated.sweep.object_index == ids[box.track_id]).sum() > 0


def test_urban_is_the_street_under_its_new_name():
    urban, street = create_scene("urban", 2, 5), create_scene("street", 2, 5)
    assert (urban.name, street.name) == ("urban", "street")
    np.testing.assert_array_equal(urban.actors[3].T_world_obj(1.0), street.actors[3].T_world_obj(1.0))
    assert {*NEW, "urban", "street"} == set(SCENES)
    with pytest.raises(InputError, match=r"no scene 'higway'. Did you mean 'highway'\?"):
        create_scene("higway")


@pytest.mark.parametrize("name", NEW)
@pytest.mark.parametrize("n_frames", [0, 301])
def test_scenes_are_only_so_long(name, n_frames):
    with pytest.raises(InputError, match=f"1 to 300 frames, got {n_frames}"):
        create_scene(name, 0, n_frames)


@pytest.mark.parametrize("name", [*NEW, "urban"])
def test_a_seed_below_zero_is_refused_with_our_own_error(name):
    with pytest.raises(InputError, match="seed >= 0, got -1"):
        create_scene(name, -1, 5)


@pytest.mark.parametrize("name", ["highway", "crossing"])
def test_buses_are_labelled_with_a_word_that_kitti_has(name):
    scene = scene_of(name, 0, LONG[name])
    buses = [actor for actor in scene.actors if actor.class_name == "Misc"]
    assert buses
    assert all(actor.body.size[0] > 8.0 for actor in buses)
    assert {a.class_name for a in scene.actors} <= set(CLASSES)
    with pytest.raises(InputError, match="no class of KITTI's 'Bus'"):
        dataclasses.replace(scene.actors[0], class_name="Bus")


# --- what each scene is there for


@pytest.mark.parametrize(("seed", "n_frames"), [(0, LONG["braking"]), (1, 60)])
def test_all_but_the_ego_car_brake_hard_and_speed_up_again(seed, n_frames):
    scene = scene_of("braking", seed, n_frames)
    times = times_of(scene)
    moving, (tracks, _) = motions(scene, times), tracks_of(scene, times)
    assert np.ptp(moving["speed"][0]) < 1e-6
    braked, sped_up = moving["along"][1:].min(axis=1) < -3.0, moving["along"][1:].max(axis=1) > 1.9
    assert braked.mean() > 0.5
    assert sped_up.mean() > 0.5
    range_m = np.linalg.norm(tracks[1:, :, :2] - tracks[0, :, :2], axis=-1)
    steps = [
        row
        for track, away in zip(tracks[1:, :, :2], range_m, strict=True)
        for row in acceleration_steps(times[1:], np.diff(track, axis=0) / 0.1)
        if away[row + 1] < 60.0
    ]
    assert len(steps) >= 2.0 * scene.n_frames * scene.period, "a delay needs many of them"


@pytest.mark.parametrize(("seed", "n_frames"), [(0, LONG["highway"]), (1, SHORT)])
def test_the_highway_has_oncoming_traffic_trucks_and_changes_of_lanes(seed, n_frames):
    scene = scene_of("highway", seed, n_frames)
    times = times_of(scene)
    tracks, _ = tracks_of(scene, times)
    velocity = np.gradient(tracks[..., :2], times, axis=1)
    range_m = np.linalg.norm(tracks[1:, :, :2] - tracks[0, :, :2], axis=-1)
    relative = np.linalg.norm(velocity[1:] - velocity[0], axis=-1)
    assert 55.0 < relative[range_m < 80.0].max() < 65.0
    speed = np.linalg.norm(velocity, axis=-1)
    assert speed.min() > 17.0
    assert 18.0 < speed[0].min() <= speed[0].max() < 31.1
    classes = {actor.class_name for actor, near in zip(scene.actors, range_m.min(axis=1) < 50.0, strict=True) if near}
    assert {"Car", "Truck"} <= classes
    curvature = [np.abs(actor.motion.curve.curvatures(actor.motion.curve.s)).max() for actor in scene.actors]
    assert sum(k > 1.2e-3 for k in curvature) >= (3 if seed == 0 else 1), "some change lanes"


def test_at_the_crossing_they_stop_start_turn_and_cross():
    scene = scene_of("crossing", 0, LONG["crossing"])
    moving = motions(scene, times_of(scene))
    classes = np.array(["ego"] + [actor.class_name for actor in scene.actors if not isinstance(actor.motion, Standing)])
    is_driving = (classes != "Pedestrian") & (classes != "Cyclist")
    speed, yaw = moving["speed"][is_driving], moving["yaw"][is_driving]
    first, last = (speed > 3.0).argmax(axis=1), speed.shape[1] - 1 - (speed > 3.0)[:, ::-1].argmax(axis=1)
    stands = speed < 0.2
    assert sum(stands[i, first[i] :].any() for i in range(len(speed))) >= 3, "some stop"
    assert sum(stands[i, : last[i]].any() for i in range(len(speed))) >= 3, "some start"
    assert (np.ptp(yaw, axis=1) > 1.4).sum() >= 4, "some turn"
    directions = np.abs(np.sin(moving["yaw"][1:, 0] - moving["yaw"][0, 0]))
    assert (directions > 0.7).any()
    assert (classes == "Cyclist").sum() >= 4
    assert (classes == "Pedestrian").sum() >= 6
    assert (moving["speed"][0] > 3.0).any(), "the ego car drives"


@pytest.mark.parametrize(("seed", "n_frames"), [(0, LONG["parked-row"]), (1, SHORT)])
def test_nothing_but_the_ego_car_moves_along_the_parked_row(seed, n_frames):
    scene = scene_of("parked-row", seed, n_frames)
    assert all(isinstance(actor.motion, Standing) for actor in scene.actors)
    speed = motions(scene, times_of(scene))["speed"][0]
    assert 13.9 < speed.min() <= speed.max() < 16.1
    centers = np.stack([actor.T_world_obj(0.0)[:2, 3] for actor in scene.actors])
    beside = cKDTree(scene.ego.drive.curve.points).query(centers)[0]
    assert 4.5 < beside.min() < 7.5
    assert 11.0 < beside.max() < 15.0
    assert len(scene.actors) > 0.25 * n_frames


def test_at_the_roundabout_everybody_turns_and_the_ego_car_too():
    scene = scene_of("roundabout", 0, LONG["roundabout"])
    moving = motions(scene, times_of(scene))
    drives = np.array([True] + [a.class_name != "Pedestrian" for a in scene.actors])
    turned = np.ptp(moving["yaw"][drives], axis=1)
    assert turned[0] > 0.8, "the ego car enters"
    assert (turned[1:] > 1.0).sum() >= 4
    assert (turned > 2.0).any()
    assert moving["speed"][drives].max() < 13.2
    on_ring = np.abs(moving["across"]) > 1.2
    assert moving["speed"][on_ring].max() < 7.6


@pytest.mark.parametrize(("seed", "n_frames"), [(0, LONG["crowd"]), (1, SHORT)])
def test_the_crowd_is_close_together(seed, n_frames):
    scene = scene_of("crowd", seed, n_frames)
    tracks, _ = tracks_of(scene, times_of(scene))
    classes = np.array([actor.class_name for actor in scene.actors])
    persons = tracks[1:][classes == "Pedestrian", 0, :2]
    assert len(persons) >= 35
    assert (classes == "Cyclist").sum() >= 4
    assert ((classes == "Car") | (classes == "Van")).any()
    nearest = cKDTree(persons).query(persons, k=2)[0][:, 1]
    assert np.median(nearest) < 2.5
    apart = np.linalg.norm(tracks[1:, :, :2] - tracks[0, :, :2], axis=-1)
    assert (apart < 20.0).sum(axis=0).min() >= 8
    speed = motions(scene, times_of(scene))["speed"]
    assert speed.max() < 5.2
    assert speed[0].max() < 4.05


# --- how speeds are chosen


def occupied(*parts: tuple[float, float, float, float], n: int = 100) -> tuple[Occupancy, np.ndarray]:
    """Let others take parts (from where, to where, from when, until when) of a path."""
    times = 0.2 * np.arange(n)
    low, high = np.full((2, len(parts), n), np.nan)
    for row, (start, end, since, until) in enumerate(parts):
        when = (since <= times) & (times < until)
        low[row, when], high[row, when] = start, end
    return Occupancy(low, high, np.zeros((len(parts), n))), times


def planned(*parts: tuple[float, float, float, float]) -> SampledSpeed:
    occupancy, times = occupied(*parts)
    return plan_speed(STRAIGHT, 0.0, Style(10.0), (-1.0, 3.0), occupancy, times)


def test_a_free_driver_goes_as_fast_as_wished_and_slows_down_for_bends():
    assert np.ptp(planned().speeds) == 0.0
    curve = curve_from_curvature(np.zeros(2), 0.0, [(50.0, 0.0), (5.0, 0.1), (10.0, 0.1), (5.0, 0.0), (100.0, 0.0)])
    occupancy, times = occupied()
    speed = plan_speed(curve, 0.0, Style(10.0, lateral=2.0), (-1.0, 3.0), occupancy, times)
    assert speed.speeds.min() == pytest.approx(np.sqrt(2.0 / 0.1), rel=0.08)
    assert speed.speed(18.0) == pytest.approx(10.0, abs=0.1)


def test_a_driver_stops_before_whoever_stands_there_and_goes_on_when_the_way_is_free():
    blocked = planned((60.0, 64.0, 0.0, 99.0))
    assert blocked.speed(19.0) < 1.0
    assert 54.0 < blocked.distance(19.0) + 3.0 < 60.0
    red = planned((60.0, 60.5, 0.0, 12.0))
    assert red.distance(11.9) + 3.0 < 60.0
    assert red.speed(18.0) > 5.0


def test_a_driver_gives_way_to_one_who_crosses_but_not_to_one_who_crosses_later():
    waits = planned((60.0, 64.0, 5.0, 8.0))
    assert waits.distance(5.0) + 3.0 < 60.0
    assert waits.distance(7.9) + 3.0 < 60.0
    assert waits.distance(18.0) > 80.0
    assert np.ptp(planned((60.0, 64.0, 9.0, 12.0)).speeds) == 0.0


def test_speeds_through_samples_keep_within_them_and_have_no_jump():
    speed = SampledSpeed(np.array([0.0, 1.0, 2.0, 3.0]), np.array([2.0, 0.0, 0.0, 4.0]))
    times = np.arange(-1.0, 4.0, 0.01)
    values = np.array([speed.speed(t) for t in times])
    assert values.min() >= 0.0
    assert values.max() <= 4.0
    assert speed.speed(-1.0) == 2.0
    assert speed.speed(1.5) == 0.0
    assert np.abs(np.diff([speed.acceleration(t) for t in times])).max() < 0.3
    np.testing.assert_allclose(np.gradient(speed.distances(times), times)[1:-1], values[1:-1], atol=1e-3)
    with pytest.raises(InputError, match="never be negative"):
        SampledSpeed(np.array([0.0, 1.0]), np.array([1.0, -0.1]))


# --- the cast


def test_a_cast_takes_nobody_who_would_touch_another():
    cast = Cast(np.random.default_rng(0), 20)
    car = cast.draw("Car")
    assert cast.stand(car, 40.0, 0.0, 0.0)
    assert not cast.stand(car, 41.0, 1.0, 0.5)
    assert cast.stand(car, 40.0, 3.0, 0.0)
    cast.close(80.0, 0.0, 0.0, 1.0, 1.0)
    assert not cast.stand(car, 80.0, 0.5, 0.0)
    assert cast.enter(car, STRAIGHT, 5.0, Style(9.0))
    assert not cast.enter(car, STRAIGHT, 5.0, Style(9.0))
    assert not cast.enter(car, STRAIGHT, 15.0, Style(9.0, slowest=8.0)), "it would have to wait behind the first"


def test_the_world_of_a_scene_starts_at_the_ego_cars_imu_and_its_middle_keeps_to_its_way():
    cast = Cast(np.random.default_rng(0), 20)
    assert cast.drive_ego(STRAIGHT, 100.0, Style(8.0), [Stop(180.0, 0.0, 9.0)])
    assert cast.stand(cast.draw("Car"), 150.0, 4.0, 0.0)
    (mesh,) = (actor.mesh(0.0) for actor in cast.scene("mine", cast.draw("Van").body.mesh(0.0), 0.0).actors)
    scene = cast.scene("mine", mesh, 1.0)
    assert se3.yaw(scene.T_world_imu(0.0)) == pytest.approx(1.0, abs=0.01)
    T_ego_car = se3.invert(scene.ego.drive.pose(0.0)) @ scene.actors[0].T_world_obj(0.0)
    # The IMU is 0.31 m to the left of the middle, and 8 m from where it was a second ago.
    np.testing.assert_allclose(T_ego_car[:2, 3], [150.0 - 108.0, 4.0 - 0.31], atol=1e-6)


def test_a_scene_without_room_for_the_ego_car_says_so():
    with pytest.raises(InputError, match="needs a car with the sensor"):
        Cast(np.random.default_rng(0), 3).scene("empty", merge([]), 0.0)
    blocked = lambda cast: (cast.close(0.0, 0.0, 0.0, 9.0, 9.0), cast.lead_ego(STRAIGHT, 0.0, Speed(3.0)))  # noqa: E731
    with pytest.raises(InputError, match="no room for the car with the sensor"):
        cast_with_ego(np.random.default_rng(0), 3, blocked)


def test_separations_are_the_gaps_between_rectangles():
    ours = corners(np.zeros((3, 3)), np.tile([4.0, 2.0], (3, 1)))
    places = np.array([[0.0, 3.0, 0.0], [5.0, 0.0, 0.5 * np.pi], [1.0, 1.0, 0.0]])
    theirs = corners(places, np.tile([4.0, 2.0], (3, 1)))
    np.testing.assert_allclose(separations(ours, theirs), [1.0, 2.0, -1.0], atol=1e-12)
