"""Sets of pairs on disk: the authors' format, read and written; their quirks; damage."""

import json

import numpy as np
import pytest

from registration import se3
from registration.errors import PairSetError
from registration.pair_set import CloudPair, PairSet, write_pair_set


def pair(seed=0, **extra):
    rng = np.random.default_rng(seed)
    start, end = np.array([10.0, 2.0, 0.5]), np.array([10.4, 2.1, 0.5])
    source = (rng.normal(size=(20, 3)) + start).astype(np.float32).astype(np.float64)
    return CloudPair(source, source[:15] + 0.25, start, end, 0.3, 0.35, extra)


@pytest.fixture
def folder(tmp_path):
    parts = ["train", "test", "val", "train"]
    write_pair_set(tmp_path / "set", ((p, pair(i, seq=i)) for i, p in enumerate(parts)), {"name": "mine"})
    return tmp_path / "set"


def test_what_is_written_is_read_again(folder):
    found, expected = PairSet(folder).read(1), pair(1, seq=1)
    np.testing.assert_array_equal(found.source, expected.source)
    np.testing.assert_allclose(found.target, expected.target, atol=1e-6)
    np.testing.assert_array_equal(found.end_position, expected.end_position)
    assert (found.start_angle, found.end_angle) == (0.3, 0.35)
    assert found.extra["seq"] == 1


def test_the_true_motion_turns_about_the_start_and_then_shifts():
    p = pair()
    moved = se3.transform(p.T_target_source, (p.start_position + [1.0, 0.0, 0.0])[None])[0]
    turned = [np.cos(0.05), np.sin(0.05), 0.0]
    np.testing.assert_allclose(moved, p.start_position + [0.4, 0.1, 0.0] + turned, atol=1e-12)


def test_the_transform_on_disk_is_the_true_motion(folder):
    stored = np.load(folder / "transform" / "00000002.npy")
    np.testing.assert_array_equal(stored, PairSet(folder).read(2).T_target_source)


def test_parts_are_kept_and_val_lists_validation_and_then_test_as_the_authors_do(folder):
    found = PairSet(folder)
    assert (found.ids("train"), found.ids("val"), found.ids("test")) == ([0, 3], [2], [1])
    assert (folder / "split" / "val.txt").read_text() == "2\n1\n"
    assert len(list(found.pairs("train"))) == 2


def test_meta_has_the_authors_keys_and_number_format(folder):
    meta = json.loads((folder / "meta" / "00000000.json").read_text())
    assert np.loadtxt(meta["translation"].splitlines()).tolist() == pytest.approx([0.4, 0.1, 0.0])
    assert meta["rel_angle"] == pytest.approx(0.05)
    assert {"start_position", "end_position", "start_angle", "end_angle"} <= meta.keys()


def test_a_released_synthetic_set_tests_from_position_1000_on(folder):
    (folder / "split" / "test.txt").unlink()
    (folder / "split" / "val.txt").write_text("".join(f"{k % 4}\n" for k in range(1000)) + "3\n")
    assert len(PairSet(folder).ids("val")) == 1000
    assert PairSet(folder).ids("test") == [3]


def test_a_released_kitti_set_tests_by_track_id(folder):
    (folder / "split" / "test.txt").unlink()
    (folder / "split" / "val.txt").write_text("0\n1\n2\n")
    for id_, track in ((0, 6), (1, 5), (2, 10)):
        path = folder / "meta" / f"{id_:08d}.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), "trackids": [track, track]}))
    assert PairSet(folder).ids("test") == [0, 2]
    assert PairSet(folder).ids("val") == [1]


def test_mirrored_angles_turn_the_other_way(folder):
    assert PairSet(folder, mirrored_angles=True).read(0).end_angle == -0.35


def test_coloured_clouds_lose_their_colours(folder):
    path = folder / "pointcloud1" / "00000000.npy"
    np.save(path, np.hstack([np.load(path), np.full((20, 3), 255.0)]).astype(np.float32))
    assert PairSet(folder).read(0).source.shape == (20, 3)


def test_a_full_folder_is_left_alone(folder):
    with pytest.raises(PairSetError, match="holds something already"):
        write_pair_set(folder, [("train", pair())], {})
    assert PairSet(folder).ids("train") == [0, 3]


def test_a_set_that_fails_half_way_leaves_nothing_in_its_place(tmp_path):
    def failing():
        yield "train", pair()
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_pair_set(tmp_path / "set", failing(), {})
    assert not (tmp_path / "set").exists()
    assert PairSet(write_pair_set(tmp_path / "set", [("val", pair())], {}).folder).ids("val") == [0]


def test_no_pair_is_an_error(tmp_path):
    with pytest.raises(PairSetError, match="there is no pair to write"):
        write_pair_set(tmp_path / "set", [], {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("meta/00000000.json", b"{", r"00000000\.json: expected a pair's JSON record"),
        ("meta/00000000.json", b'{"start_position": "1 2"}', r"00000000\.json: expected positions and angles"),
        ("pointcloud1/00000000.npy", b"\x93NUMPY", r"pointcloud1/00000000\.npy: expected a cloud"),
        ("split/train.txt", b"one\n", r"train\.txt: expected an integer id a line"),
    ],
)
def test_damage_is_an_error_that_names_the_file(folder, file, content, message):
    (folder / file).write_bytes(content)
    with pytest.raises(PairSetError, match=message):
        list(PairSet(folder).pairs("train"))


def test_a_cloud_with_nan_is_refused(folder):
    np.save(folder / "pointcloud2" / "00000000.npy", np.full((3, 3), np.nan))
    with pytest.raises(PairSetError, match="expected a finite"):
        PairSet(folder).read(0)


def test_a_folder_without_pairs_is_refused(tmp_path):
    with pytest.raises(PairSetError, match="found no meta"):
        PairSet(tmp_path)


def test_an_unknown_part_is_refused(folder):
    with pytest.raises(PairSetError, match="unknown part 'training'"):
        PairSet(folder).ids("training")
