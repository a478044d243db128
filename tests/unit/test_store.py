"""Segments on disk: exact, resumable, never half-made, and never at the cost of somebody else's files."""

import json
import os
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.kitti_folder import dont_care_row, label_row, pose_rows, scan, stamp, things, write, write_tracking
from tracker import store as store_module
from tracker.errors import DataError, MissingDataError
from tracker.kitti import open_sequence
from tracker.store import cut_sequence
from tracker.tracklets import cut
from tracker.types import Sweep

LONG_AGO = 1_000_000_000  # [s]: a time of writing that no new file has


@pytest.fixture(autouse=True)
def _two_frames_a_part(monkeypatch):
    monkeypatch.setattr(store_module, "FRAMES_PER_PART", 2)


@pytest.fixture
def training(tmp_path):
    return write_tracking(tmp_path, n_frames=5, missing=(3,))


def opened(training):
    return open_sequence(training.parent, "0000")


def cut_into(training, folder, **settings):
    return cut_sequence(opened(training), folder, **settings)


def age(folder):
    """Set back the times of all files, so that what is written again shows."""
    for path in folder.iterdir():
        os.utime(path, (LONG_AGO, LONG_AGO))


def rewritten(folder):
    return sorted(path.name for path in folder.iterdir() if path.stat().st_mtime != LONG_AGO)


def assert_equal_frames(found, expected):
    """Compare two streams of segmented frames to the last bit."""
    found, expected = list(found), list(expected)
    assert [frame.index for frame in found] == [frame.index for frame in expected]
    for a, b in zip(found, expected, strict=True):
        assert a.timestamp == b.timestamp
        assert (a.T_world_lidar is None) == (b.T_world_lidar is None)
        assert (a.ego_step_covariance is None) == (b.ego_step_covariance is None)
        assert a.seen_at == b.seen_at
        if a.T_world_lidar is not None:
            np.testing.assert_array_equal(a.T_world_lidar, b.T_world_lidar)
        assert list(a.boxes) == list(b.boxes)
        assert list(a.segments) == list(b.segments)
        for key, box in a.boxes.items():
            other = b.boxes[key]
            np.testing.assert_array_equal(box.T_lidar_obj, other.T_lidar_obj)
            np.testing.assert_array_equal(box.size, other.size)
            for name in ("track_id", "class_name", "truncation", "occlusion"):
                assert getattr(box, name) == getattr(other, name)
        for key, segment in a.segments.items():
            other = b.segments[key]
            np.testing.assert_array_equal(segment.points_lidar, other.points_lidar)
            assert segment.points_lidar.dtype == np.float64
            for name in ("track_id", "class_name", "frame", "timestamp", "ground_z_lidar"):
                assert getattr(segment, name) == getattr(other, name)


# --- round trip


@pytest.mark.parametrize("to_frame_time", [True, False])
def test_looks_at_objects_and_points_moved_to_them_come_back(training, tmp_path, to_frame_time):
    write(training / "poses" / "0000.txt", pose_rows(5))
    sequence = replace(opened(training), sweep=Sweep(np.zeros(6), to_frame_time=to_frame_time), flagged=(2,))
    store = cut_sequence(sequence, tmp_path / "store")
    assert store.manifest["deskewed"] is True
    for found, frame in zip(store.frames(), sequence.frames(), strict=True):
        expected = cut(frame)
        assert found.seen_at == expected.seen_at
        assert len(set(found.seen_at.values())) > 1
        assert (found.ego_step_covariance is not None) == (frame.index in (2, 3))
        for key, segment in expected.segments.items():
            read = found.segments[key]
            assert read.timestamp == segment.timestamp == pytest.approx(found.time_of(key), abs=1e-3)
            assert read.timestamp - read.seen_after == pytest.approx(frame.timestamp)
            assert (read.sweep.period, read.sweep.to_frame_time) == (segment.sweep.period, to_frame_time)
            np.testing.assert_array_equal(read.sweep.twist_lidar, segment.sweep.twist_lidar)
            np.testing.assert_allclose(found.segments[key].points_lidar, segment.points_lidar, atol=1e-5)  # float32
    assert cut_sequence(opened(training), tmp_path / "store").manifest["deskewed"] is False


@pytest.mark.parametrize(
    ("settings", "lasers"),
    [
        (None, "HDL-64E-KITTI"),
        ({"rolling_shutter": False, "beam_model": "HDL-64E"}, "HDL-64E"),
        ({"rolling_shutter": False, "beam_model": "mine"}, None),
    ],
)
def test_a_store_says_whether_scans_are_simulated_and_raw_sweeps_as_all_but_some_simulated_ones_are(
    training, tmp_path, settings, lasers
):
    if settings is not None:
        (training / "simulation.json").write_text(json.dumps({"sequences": {"0000": settings}}))
    frames = list(cut_sequence(opened(training), tmp_path / "store").frames())
    segments = [segment for frame in frames for segment in frame.segments.values()]
    found = {(segment.is_swept, segment.lasers, segment.is_simulated) for segment in segments}
    assert found == {(settings is None, lasers, settings is not None)}


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"sequences": {"0000": 1}}'])
def test_a_damaged_record_of_a_simulator_is_an_error(training, text):
    (training / "simulation.json").write_text(text)
    with pytest.raises(DataError, match="simulation.json.*record"):
        opened(training)


@pytest.mark.parametrize("has_poses", [False, True])
def test_what_is_read_is_what_was_cut_to_the_last_bit(training, tmp_path, has_poses):
    write(training / "times" / "0000.txt", "".join(f"{stamp(k)}\n" for k in range(5)))
    if has_poses:
        write(training / "poses" / "0000.txt", pose_rows(5))
    store = cut_into(training, tmp_path / "store")
    assert len(store) == 5
    assert_equal_frames(store.frames(), [cut(frame) for frame in opened(training).frames()])
    assert [len(frame.segments) for frame in store.frames()] == [2, 2, 3, 0, 3]  # frame 3 has no scan


def test_a_box_without_points_has_an_empty_segment_again(tmp_path):
    store = cut_into(write_tracking(tmp_path, n_frames=4), tmp_path / "store")
    frame = list(store.frames())[3]
    assert frame.segments[1].points_lidar.shape == (0, 3)
    assert len(frame.segments[0].points_lidar) == 12


def test_frames_without_any_object_are_kept(training, tmp_path):
    rows = dont_care_row(0) + "".join(label_row(4, thing) for thing in things(4))
    write(training / "label_02" / "0000.txt", rows)
    store = cut_into(training, tmp_path / "store")
    assert [list(frame.boxes) for frame in store.frames()] == [[], [], [], [], [1, 0, 3]]


def test_a_sequence_without_any_object_is_kept(training, tmp_path):
    write(training / "label_02" / "0000.txt", "")
    store = cut_into(training, tmp_path / "store")
    assert [(frame.index, frame.boxes, frame.segments) for frame in store.frames()] == [(k, {}, {}) for k in range(5)]


def test_the_manifest_says_what_was_cut(training, tmp_path):
    manifest = cut_into(training, tmp_path / "store").manifest
    assert manifest == json.loads((tmp_path / "store" / "0000" / "manifest.json").read_text())
    keys = ("format", "version", "sequence", "clock", "ego", "n_frames", "missing_scans")
    assert [manifest[key] for key in keys] == ["regmot-segments", 5, "0000", "nominal 10 Hz", "none", 5, [3]]


def test_a_sequence_without_any_scan_is_refused_and_nothing_is_written(tmp_path):
    training = write_tracking(tmp_path, n_frames=3, missing=(0, 1, 2))
    with pytest.raises(MissingDataError, match=r"sequence 0000: none of its 3 frames has a scan \(.*000000\.bin"):
        cut_into(training, tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_progress_is_told_of_every_frame(training, tmp_path):
    told = []
    cut_into(training, tmp_path / "store", progress=lambda done, n: told.append((done, n)))
    assert sorted(set(told)) == [(k, 5) for k in (1, 2, 3, 4, 5)]
    assert told == sorted(told)


# --- again


def test_a_second_run_reads_no_scan_and_writes_no_file(training, tmp_path, monkeypatch):
    folder = cut_into(training, tmp_path / "store").folder
    age(folder)
    monkeypatch.setattr(store_module, "cut", lambda frame: pytest.fail(f"frame {frame.index} was cut again"))
    assert_equal_frames(
        cut_into(training, tmp_path / "store").frames(), [cut(frame) for frame in opened(training).frames()]
    )
    assert rewritten(folder) == []


def test_only_the_part_that_is_missing_is_cut(training, tmp_path):
    folder = cut_into(training, tmp_path / "store").folder
    (folder / "part-0001.npz").unlink()
    age(folder)
    store = cut_into(training, tmp_path / "store")
    assert rewritten(folder) == ["part-0001.npz"]
    assert_equal_frames(store.frames(), [cut(frame) for frame in opened(training).frames()])


def change_labels(training):
    path = training / "label_02" / "0000.txt"
    write(path, path.read_text().replace(" Car ", " Van "))


def change_scan(training):
    write(training / "velodyne" / "0000" / "000001.bin", scan(0).tobytes())


def add_poses(training):
    write(training / "poses" / "0000.txt", pose_rows(5))


def add_times(training):
    write(training / "times" / "0000.txt", "".join(f"{stamp(k)}\n" for k in range(5)))


def add_scan(training):
    write(training / "velodyne" / "0000" / "000003.bin", scan(3).tobytes())


@pytest.mark.parametrize("change", [change_labels, change_scan, add_poses, add_times, add_scan])
def test_a_store_of_other_files_is_made_anew(training, tmp_path, change):
    folder = cut_into(training, tmp_path / "store").folder
    age(folder)
    change(training)
    store = cut_into(training, tmp_path / "store")
    assert rewritten(folder) == ["manifest.json", "part-0000.npz", "part-0001.npz", "part-0002.npz"]
    assert_equal_frames(store.frames(), [cut(frame) for frame in opened(training).frames()])


def test_a_store_of_a_longer_sequence_leaves_no_part_behind(training, tmp_path):
    folder = cut_into(training, tmp_path / "store").folder
    (training / "velodyne" / "0000" / "000004.bin").unlink()
    write(training / "label_02" / "0000.txt", "".join(label_row(0, thing) for thing in things(0)))
    assert len(cut_into(training, tmp_path / "store")) == 3
    (training / "velodyne" / "0000" / "000002.bin").unlink()
    assert len(cut_into(training, tmp_path / "store")) == 2
    assert sorted(path.name for path in folder.iterdir()) == ["manifest.json", "part-0000.npz"]


@pytest.mark.parametrize(("key", "value"), [("version", 0), ("regmot", "0.0.1"), ("frames_per_part", 50)])
def test_a_store_of_another_version_is_made_anew(training, tmp_path, key, value):
    store = cut_into(training, tmp_path / "store")
    write(store.folder / "manifest.json", json.dumps({**store.manifest, key: value}))
    age(store.folder)
    again = cut_into(training, tmp_path / "store")
    assert again.manifest == store.manifest == json.loads((store.folder / "manifest.json").read_text())
    assert rewritten(store.folder) == ["manifest.json", "part-0000.npz", "part-0001.npz", "part-0002.npz"]


# --- stopped in the middle


class Stop(BaseException):
    """What Ctrl-C or a kill does to a running program."""


def stop_at(frame):
    def progress(done, _):
        if done == frame + 1:
            raise Stop

    return progress


@pytest.mark.parametrize(("frame", "parts"), [(0, []), (2, ["part-0000.npz"]), (4, ["part-0000.npz", "part-0001.npz"])])
def test_a_run_stopped_in_the_middle_leaves_whole_parts_only_and_the_next_goes_on(training, tmp_path, frame, parts):
    with pytest.raises(Stop):
        cut_into(training, tmp_path / "store", progress=stop_at(frame))
    folder = tmp_path / "store" / "0000"
    assert sorted(path.name for path in folder.iterdir()) == ["manifest.json", *parts]
    age(folder)
    store = cut_into(training, tmp_path / "store")
    assert rewritten(folder) == [f"part-{k:04d}.npz" for k in range(len(parts), 3)]
    assert_equal_frames(store.frames(), [cut(frame) for frame in opened(training).frames()])


def test_a_run_stopped_while_it_writes_a_part_leaves_no_half_part(training, tmp_path, monkeypatch):
    def half(file, **columns):
        file.write(b"PK\x03\x04 and no more")
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", half)
        with pytest.raises(Stop):
            cut_into(training, tmp_path / "store")
    assert not list((tmp_path / "store" / "0000").glob("*.npz"))
    store = cut_into(training, tmp_path / "store")
    assert_equal_frames(store.frames(), [cut(frame) for frame in opened(training).frames()])
    assert not list(store.folder.glob("*.unfinished"))


@pytest.mark.parametrize(
    "left", [[], ["manifest.json.unfinished"], ["part-0000.npz", "part-0002.npz", "part-0002.npz.unfinished"]]
)
def test_a_run_stopped_while_it_clears_or_founds_a_store_is_no_obstacle(training, tmp_path, left):
    folder = tmp_path / "store" / "0000"
    folder.mkdir(parents=True)
    for name in left:
        write(folder / name, b"half")
    store = cut_into(training, tmp_path / "store")
    assert_equal_frames(store.frames(), [cut(frame) for frame in opened(training).frames()])


# --- other people's files


@pytest.mark.parametrize("name", ["thesis.tex", "manifest.json", "part-0000.npz/deep.txt", "labels.npz"])
def test_a_folder_with_other_files_is_refused_and_left_alone(training, tmp_path, name):
    path = write(tmp_path / "store" / "0000" / name, '{"format": "web-app"}')
    expected = "expected (an empty folder or a store|the manifest of a store) of segments.*, got (other files|another)"
    with pytest.raises(DataError, match=expected):
        cut_into(training, tmp_path / "store")
    assert path.read_text() == '{"format": "web-app"}'


def test_a_manifest_that_is_no_json_is_refused_and_left_alone(training, tmp_path):
    path = write(tmp_path / "store" / "0000" / "manifest.json", b"\xff\x00")
    with pytest.raises(DataError, match=r"manifest\.json: expected the manifest of a store of segments"):
        cut_into(training, tmp_path / "store")
    assert path.read_bytes() == b"\xff\x00"


def test_a_file_laid_into_a_store_is_not_lost_when_the_store_is_to_be_made_anew(training, tmp_path):
    folder = cut_into(training, tmp_path / "store").folder
    write(folder / "notes.txt", "mine")
    cut_into(training, tmp_path / "store")  # nothing to clear: no harm
    change_labels(training)
    with pytest.raises(DataError, match=r"0000: expected an empty folder .*, got other files \(notes\.txt\)"):
        cut_into(training, tmp_path / "store")
    assert (folder / "notes.txt").read_text() == "mine"
    assert len(list(folder.glob("part-*.npz"))) == 3


# --- damaged parts


def cut_short(content):
    return content[: len(content) // 2]


def emptied(content):
    return b""


def overwritten(content):
    return b"\x00" * len(content)


def with_a_wrong_byte(content):
    k = content.index(np.array(things(2)[0].size).tobytes())  # in the boxes' sizes: plausible, but for the checksum
    return content[:k] + bytes([content[k] ^ 1]) + content[k + 1 :]


@pytest.mark.parametrize("damage", [cut_short, emptied, overwritten, with_a_wrong_byte])
def test_a_damaged_part_is_refused_by_name_and_can_be_cut_anew(training, tmp_path, damage):
    store = cut_into(training, tmp_path / "store")
    path = store.folder / "part-0001.npz"
    path.write_bytes(damage(path.read_bytes()))
    frames = store.frames()
    assert [next(frames).index, next(frames).index] == [0, 1]
    with pytest.raises(DataError, match=r"part-0001\.npz: expected a part of a segment store, .* delete it to have it"):
        next(frames)
    path.unlink()
    assert_equal_frames(
        cut_into(training, tmp_path / "store").frames(), [cut(frame) for frame in opened(training).frames()]
    )


def test_a_part_without_a_column_is_refused_by_name(training, tmp_path):
    store = cut_into(training, tmp_path / "store")
    np.savez(store.folder / "part-0000.npz", index=np.arange(2))
    with pytest.raises(DataError, match=r"part-0000\.npz: expected a part of a segment store.*timestamp"):
        next(store.frames())


def test_a_missing_part_is_refused_by_name(training, tmp_path):
    store = cut_into(training, tmp_path / "store")
    (store.folder / "part-0002.npz").unlink()
    with pytest.raises(DataError, match=r"part-0002\.npz: expected a part of a segment store"):
        list(store.frames())


# --- memory


def test_frames_are_read_part_by_part(training, tmp_path):
    store = cut_into(training, tmp_path / "store")
    frames = store.frames()
    next(frames)
    for name in ("part-0000.npz", "part-0001.npz", "part-0002.npz"):
        (store.folder / name).unlink()
    assert next(frames).index == 1  # of the part that is in memory
    with pytest.raises(DataError, match=r"part-0001\.npz"):
        next(frames)


@pytest.fixture
def long_store(tmp_path):
    """Cut 24 frames of one large object: 12 parts of 480 kB of float64 points each."""
    training = write_tracking(tmp_path, n_frames=0)
    car = things(0)[0]
    write(training / "label_02" / "0000.txt", "".join(label_row(k, car) for k in range(24)))
    cloud = np.tile(np.array([[*car.center, 0.5]], dtype="<f4"), (10_000, 1))
    for k in range(24):
        write(training / "velodyne" / "0000" / f"{k:06d}.bin", cloud.tobytes())
    return cut_into(training, tmp_path / "store")


def peak_of(read):
    tracemalloc.start()
    kept = read()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, kept


def test_reading_a_long_store_takes_the_memory_of_a_few_parts(long_store):
    peak, n_points = peak_of(lambda: sum(len(frame.segments[0].points_lidar) for frame in long_store.frames()))
    assert n_points == 24 * 10_000
    assert peak < 4 * 480_000 < 12 * 480_000


def test_a_segment_that_is_kept_does_not_keep_its_part_in_memory(long_store):
    segments = [frame.segments[0] for frame in long_store.frames() if frame.index % 2]
    assert len(segments) == 12
    assert all(segment.points_lidar.base is None for segment in segments)
