"""The weights in the package: what they say of themselves, and that each is for the objects it is named for."""

import numpy as np
import pytest

import registration
from registration import planar, se3
from registration.alignnet import checkpoint
from registration.synthetic.bodies import draw_body
from registration.synthetic.lidar import HDL_64E, PlacedMesh, scan

NAMES = ("alignnet", "alignnet-persons")
LARGEST = 10_000_000  # bytes of a file in the wheel


def seen_twice(class_name, seed):
    """Scan an object 10 m away before and after a known motion: two clouds, the centre in the first, the motion."""
    rng = np.random.default_rng(seed)
    body = draw_body(class_name, rng)
    start = se3.from_yaw(rng.uniform(-np.pi, np.pi), np.array([10.0, rng.uniform(-2.0, 2.0), -0.9]))
    move = np.array([0.5, -0.3, 0.05])
    end = se3.from_yaw(se3.yaw(start) + move[2], start[:3, 3] + [move[0], move[1], 0.0])
    clouds = [scan([PlacedMesh(body.mesh(0.0), T)], HDL_64E, rng).points_lidar for T in (start, end)]
    return *clouds, start[:3, 3], move


def sets_of(about):
    """List the sets of a training, and of those that it went on from, the last one first."""
    sets = list(about["data"])
    return sets + (sets_of(about["started_from"]) if about["started_from"] else [])


def is_simulated(about):
    """Say whether a set's pairs are generated from our shapes, or all its sequences made by our simulator."""
    if "sequences" not in about:
        return "parametric families" in str(about["meshes"]) and about["seed"] >= 0
    return all(about["simulation"][name]["seed"] >= 0 for name in about["sequences"])


@pytest.mark.parametrize("name", NAMES)
def test_weights_say_where_they_come_from(name):
    path = checkpoint.shipped(name)
    network, about = checkpoint.read_weights(path)
    assert path.stat().st_size < LARGEST
    assert any("persons" in each["name"] for each in about.data) == (name == "alignnet-persons")
    sets = sets_of(about.fields())
    assert len(sets) > len(about.data)  # what the training began with was trained too
    assert all(is_simulated(each) for each in sets)  # no KITTI scan
    assert about.validation["share_20cm_10deg_80m"] > 0.9
    assert all(bool(tensor.isfinite().all()) for tensor in network.state_dict().values())


@pytest.mark.parametrize("name", NAMES)
def test_cars_are_registered_to_centimetres(name):
    method = registration.create(name)
    off = [error(method, *seen_twice("Car", seed)) for seed in range(8)]
    assert np.sqrt(np.mean(np.square(off), axis=0))[0] < 0.06
    assert np.rad2deg(np.median([turn for _, turn in off])) < 1.0


def test_persons_are_registered_by_the_weights_for_persons_only():
    pairs = [seen_twice("Pedestrian", seed) for seed in range(12)]
    shifts = {name: [error(registration.create(name), *pair)[0] for pair in pairs] for name in NAMES}
    rmse = {name: np.sqrt(np.mean(np.square(off))) for name, off in shifts.items()}
    assert rmse["alignnet-persons"] < 0.1
    assert rmse["alignnet"] > 2.0 * rmse["alignnet-persons"]


@pytest.mark.parametrize("name", NAMES)
def test_the_refined_method_is_there_too(name):
    method = registration.create(f"{name}+icp")
    assert method.name == f"{name}+icp"
    assert error(method, *seen_twice("Car", 0))[0] < 0.1


def test_the_shipped_network_is_in_bfloat16_what_it_is_in_float32():
    fast, exact = (registration.create("alignnet", precision=precision) for precision in ("bfloat16", "float32"))
    for seed in range(6):
        source, target, center, _ = seen_twice("Car", seed)
        a, b = (method.register(source, target).motion_about(center) for method in (fast, exact))
        np.testing.assert_allclose(a, b, rtol=0.0, atol=0.01)


def error(method, source, target, center, move):
    """Give how far off a method is: of the centre [m], and of the turn [rad]."""
    off = method.register(source, target).motion_about(center) - move
    return float(np.hypot(*off[:2])), abs(planar.wrap(float(off[2])))
