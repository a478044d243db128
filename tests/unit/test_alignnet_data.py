"""Pairs become batches without loss, and whatever augmentation does to the clouds it does to the truth."""

from dataclasses import fields, replace

import numpy as np
import pytest

from registration import planar
from registration.alignnet import dataset
from registration.alignnet.augment import LEAST, AugmentSettings, augment
from registration.alignnet.dataset import Batch, repeated
from registration.alignnet.errors import TrainingError
from registration.pair_set import PairSet, write_pair_set
from tests import learned

ALL = AugmentSettings(
    jitter=0.01,
    turn=True,
    mirror=0.5,
    swap=0.5,
    occlusion=0.5,
    thinning=0.5,
    rings=0.5,
    gaps=0.5,
    crop=0.5,
    clutter=0.5,
)


def batch(n=6, seed=0):
    return dataset.draw(learned.packed(n), np.arange(n), 1000, np.random.default_rng(seed))


def clouds_of(found: Batch):
    return [found.points[found.cloud == k] for k in range(found.n_clouds)]


def in_object(found: Batch):
    """Bring each cloud to the axes of its object: what no motion of the object may change."""
    return [
        (cloud - center) @ np.pad(planar.rotation(heading), (0, 1)) + [0, 0, 0]
        for cloud, center, heading in zip(clouds_of(found), found.center, found.heading, strict=True)
    ]


@pytest.fixture
def pair_set(tmp_path):
    rng = np.random.default_rng(0)
    pairs = [(part, learned.pair(rng)) for part in ("train",) * 5 + ("val",) * 2]
    return write_pair_set(tmp_path / "set", pairs, {"name": "test"})


def test_packing_keeps_every_pair(pair_set, tmp_path):
    packed = dataset.pack(pair_set, "train", tmp_path / "packed")
    assert len(packed) == 5
    for k, pair in enumerate(pair_set.pairs("train")):
        for which, (cloud, center, heading) in enumerate(
            ((pair.source, pair.start_position, pair.start_angle), (pair.target, pair.end_position, pair.end_angle))
        ):
            c = 2 * k + which
            np.testing.assert_array_equal(packed.points[packed.begin[c] : packed.begin[c + 1]], cloud)
            np.testing.assert_array_equal(packed.center[c], center)
            assert packed.heading[c] == heading


def test_a_set_is_read_once_and_again_when_it_is_another_one(pair_set, tmp_path, monkeypatch):
    dataset.pack(pair_set, "train", tmp_path / "packed")
    with monkeypatch.context() as patch:
        patch.setattr(PairSet, "read", lambda *_: pytest.fail("read again"))
        dataset.pack(pair_set, "train", tmp_path / "packed")
    assert len(dataset.pack(pair_set, "val", tmp_path / "packed")) == 2


def test_an_empty_part_is_refused(pair_set, tmp_path):
    with pytest.raises(TrainingError, match="'test' holds no pair"):
        dataset.pack(pair_set, "test", tmp_path / "packed")


def test_sets_are_joined_one_behind_the_other():
    one, other = learned.packed(2, seed=1), learned.packed(3, seed=2)
    both = dataset.join([one, other])
    assert len(both) == 5
    np.testing.assert_array_equal(both.points[both.begin[4] : both.begin[5]], other.points[: other.begin[1]])


def test_large_clouds_are_thinned_at_random_without_repetition():
    found = dataset.limited(batch(), 20, np.random.default_rng(0))
    sizes = np.bincount(found.cloud)
    assert sizes.max() == 20
    assert (np.diff(found.cloud) >= 0).all()
    assert len(np.unique(found.points, axis=0)) == len(found.points)
    assert (found.n_seen >= sizes).all()


def test_tensors_are_relative_to_the_mean_of_the_points():
    (source, target), (truth, _) = dataset.to_tensors(batch())
    whole = batch()
    middle = whole.points[whole.cloud == 2].astype(np.float64).mean(axis=0)
    np.testing.assert_allclose(source.points[source.cloud == 2].mean(dim=0), np.zeros(3), atol=1e-5)
    np.testing.assert_allclose(source.sensor[2], -middle[:2], atol=1e-4)
    np.testing.assert_allclose(truth.center[2], whole.center[2] - middle, atol=1e-4)
    assert int(target.cloud[0]) == 0


def test_turned_pairs_are_the_same_objects_elsewhere():
    before, after = batch(), augment(batch(), AugmentSettings(turn=True), np.random.default_rng(1))
    for a, b in zip(in_object(before), in_object(after), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)
    np.testing.assert_allclose(
        np.hypot(*before.center.T[:2]), np.hypot(*after.center.T[:2]), rtol=1e-12, err_msg="not about the sensor"
    )
    assert np.abs(before.heading - after.heading).max() > 0.1


def test_mirrored_pairs_are_mirrored_objects():
    before, after = batch(), augment(batch(), AugmentSettings(mirror=1.0), np.random.default_rng(1))
    for a, b in zip(in_object(before), in_object(after), strict=True):
        np.testing.assert_allclose(a * [1, -1, 1], b, atol=1e-5)


def test_swapped_pairs_run_backwards():
    before, after = batch(), augment(batch(), AugmentSettings(swap=1.0), np.random.default_rng(1))
    np.testing.assert_array_equal(after.heading, np.roll(before.heading, 6))
    for a, b in zip(clouds_of(before), clouds_of(after)[6:] + clouds_of(after)[:6], strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", ["occlusion", "thinning", "rings", "gaps", "crop"])
def test_losses_take_points_away_but_never_nearly_all(name):
    before = batch(40)
    after = augment(before, replace(AugmentSettings(), **{name: 1.0}), np.random.default_rng(2))
    assert np.bincount(after.cloud, minlength=80).min() >= LEAST
    assert len(after.points) < 0.97 * len(before.points)
    kept = {tuple(point) for point in before.points}
    assert all(tuple(point) in kept for point in after.points)
    share = np.bincount(after.cloud) / np.bincount(before.cloud)
    np.testing.assert_allclose(after.n_seen / before.n_seen, share)


def test_what_hides_an_object_stands_on_the_ground():
    """Seen by the sensor, where a point is lost all below it are; some edges are upright, some are not."""
    bearing, z = (x.ravel() for x in np.meshgrid(np.linspace(-0.2, 0.2, 20), np.linspace(-1.6, 0.0, 8), indexing="ij"))
    grid = np.column_stack([10.0 * np.cos(bearing), 10.0 * np.sin(bearing), z]).astype(np.float32)
    n = 40
    before = Batch(
        np.tile(grid, (n, 1)), np.repeat(np.arange(n), 160), np.full(n, 160.0), np.zeros((n, 3)), np.zeros(n)
    )
    after = augment(before, AugmentSettings(occlusion=1.0), np.random.default_rng(2))
    heights = []
    for cloud in clouds_of(after):
        kept = np.isin(np.arange(160), [np.flatnonzero((grid == point).all(axis=1))[0] for point in cloud]).reshape(
            20, 8
        )
        assert (np.diff(kept.astype(int), axis=1) >= 0).all()
        heights.append(kept.sum(axis=1))
    upright = [set(height) <= {0, 8} for height in heights]
    assert 0.2 * n < sum(upright) < 0.8 * n


def test_clutter_lies_at_the_foot_of_the_object():
    before = batch(40)
    after = augment(before, AugmentSettings(clutter=1.0), np.random.default_rng(3))
    known = {tuple(point) for point in before.points}
    foreign = [k for k, point in enumerate(after.points) if tuple(point) not in known]
    assert len(foreign) > 20
    for k in foreign:
        own = before.points[before.cloud == after.cloud[k]]
        assert own[:, 2].min() - 1e-4 <= after.points[k, 2] < own[:, 2].min() + 0.2
    assert (np.diff(after.cloud) >= 0).all()


def test_jitter_is_small():
    before, after = batch(), augment(batch(), AugmentSettings(jitter=0.01), np.random.default_rng(4))
    off = after.points - before.points
    assert 0.005 < off.std() < 0.02
    assert np.abs(off).max() <= 0.0501


def test_nothing_happens_unless_it_is_asked_for():
    before, after = batch(), augment(batch(), AugmentSettings(), np.random.default_rng(5))
    for field in fields(Batch):
        np.testing.assert_array_equal(getattr(before, field.name), getattr(after, field.name))


def test_the_same_seed_makes_the_same_batch_and_leaves_the_set_alone():
    packed = learned.packed(6)
    copy = packed.points.copy()
    one, other = (
        augment(dataset.draw(packed, np.arange(6), 9, rng), ALL, rng)
        for rng in (np.random.default_rng(7), np.random.default_rng(7))
    )
    for field in fields(Batch):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
    np.testing.assert_array_equal(packed.points, copy)


def test_pairs_of_near_objects_come_several_times():
    pairs = learned.packed(12)
    distance = np.hypot(*pairs.center[::2, :2].T)
    near = float(np.median(distance))
    index = repeated(pairs, near, 3)
    assert index.tolist() == [k for k in range(12) for _ in range(3 if distance[k] < near else 1)]
    assert repeated(pairs, 0.0, 3).tolist() == list(range(12))
