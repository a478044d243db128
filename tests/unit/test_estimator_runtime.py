"""What an estimator costs: who is given what, whose turn it is, what counts, and on how many cores."""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from regmot import timings

from evaluation import cores, estimator_runtime, streaming
from evaluation.compare import run_causal
from evaluation.cores import Cost, Effort, cost, effort
from evaluation.estimator_runtime import PEER, TABLE, WARM_UP_FRAMES, EstimatorCost, in_turn, time_estimators
from tests.kitti_folder import pose_rows, things, write, write_tracking
from tracker.errors import InputError, UnknownEstimatorError
from tracker.estimators import create_estimator
from tracker.estimators.centroid_kalman import CentroidKalman
from tracker.kitti import open_sequence
from tracker.store import cut_sequence

N_FRAMES, MISSING = 12, 9
CLASSES = ("Car", "Van")


class Recorder(CentroidKalman):
    """An estimator that keeps what it is given, and says in a common book whenever it is its turn."""

    def __init__(self, name, book):
        super().__init__()
        self.label, self.book, self.given = name, book, []

    def step(self, segments, timestamp, T_world_lidar):
        self.book.append(self.label)
        self.given.append((segments, timestamp, T_world_lidar))
        return super().step(segments, timestamp, T_world_lidar)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Cut a car in all frames, and a van from frame 2 on that is empty in frame 3; frame 9 has no scan."""
    folder = tmp_path_factory.mktemp("kitti")
    training = write_tracking(folder, n_frames=N_FRAMES, missing=(MISSING,))
    write(training / "poses" / "0000.txt", pose_rows(N_FRAMES))
    return cut_sequence(open_sequence(folder, "0000"), folder / "segments")


@pytest.fixture
def recorded(store, monkeypatch):
    """Time two recorders; gives them, the pairs that the ICP got, the book of turns, and the rows."""
    book, recorders, aligned = [], {}, []
    monkeypatch.setattr(
        estimator_runtime, "create_estimator", lambda name, seed: recorders.setdefault(name, Recorder(name, book))
    )
    align = streaming.PairByPair.align

    def align_recorded(icp, pairs):
        book.append(PEER)
        aligned.append(pairs)
        return align(icp, pairs)

    monkeypatch.setattr(streaming.PairByPair, "align", align_recorded)
    rows = time_estimators([store], ["one", "two"], CLASSES)
    return recorders, aligned, book, rows


def test_an_estimator_gets_what_compare_gives_it(store, recorded):
    compared = Recorder("compared", [])
    run_causal(compared, store, CLASSES, "world")
    for recorder in recorded[0].values():
        assert len(recorder.given) == N_FRAMES
        for (segments, t, T), (segments_compared, t_compared, T_compared) in zip(
            recorder.given, compared.given, strict=True
        ):
            assert t == t_compared
            np.testing.assert_array_equal(T, T_compared)
            assert list(segments) == list(segments_compared)
            for key, segment in segments.items():
                np.testing.assert_array_equal(segment.points_lidar, segments_compared[key].points_lidar)


def test_the_icp_gets_each_object_that_has_points_in_two_frames_in_a_row(recorded):
    assert len(recorded[1]) == N_FRAMES
    for k, pairs in enumerate(recorded[1]):
        is_gap = k == 0 or MISSING in (k, k - 1)
        before, now = ({t.track_id: t.n_points for t in things(i) if t.class_name in CLASSES} for i in (k - 1, k))
        expected = [(before[i], n) for i, n in now.items() if not is_gap and n and before.get(i)]
        assert sorted((len(a), len(b)) for a, b in pairs) == sorted(expected)


def test_only_frames_with_pairs_after_the_first_few_count(recorded):
    rows = recorded[3]
    n_frames = N_FRAMES - WARM_UP_FRAMES - 2  # neither the frame without a scan nor the one after it
    assert [(row.what, row.n_frames, row.n_objects) for row in rows] == [
        (name, n_frames, 2 * n_frames) for name in ("one", "two", PEER)
    ]


def test_each_has_one_turn_a_frame_and_every_one_comes_first_equally_often(recorded):
    book = recorded[2]
    by_frame = [book[i : i + 3] for i in range(0, len(book), 3)]
    assert len(by_frame) == N_FRAMES
    assert all(sorted(frame) == sorted(["one", "two", PEER]) for frame in by_frame)
    assert [sum(frame[0] == name for frame in by_frame) for name in ("one", "two", PEER)] == [N_FRAMES // 3] * 3
    assert in_turn(["a", "b", "c"], 4) == ["b", "c", "a"]


def test_each_sequence_starts_with_a_new_estimator_and_without_its_first_frames(store, monkeypatch):
    made = []

    def create(name, seed):
        made.append((name, seed))
        return create_estimator(name)

    monkeypatch.setattr(estimator_runtime, "create_estimator", create)
    one = time_estimators([store], ["centroid-kf"], CLASSES, 5)
    two = time_estimators([store, store], ["centroid-kf"], CLASSES, 5)
    assert made == [("centroid-kf", 5)] * 3
    assert (two[0].n_frames, two[0].n_objects) == (2 * one[0].n_frames, 2 * one[0].n_objects)


def test_a_row_has_the_tables_figures_and_the_peers_share_is_1(recorded):
    for row in recorded[3]:
        figures = row.row()
        assert list(figures) == [key for _, key, _ in TABLE]
        assert all(value > 0.0 for key, value in figures.items() if key != "what")
    peer = recorded[3][-1].row()
    assert (peer["what"], peer["median_ratio"], peer["mean_ratio"]) == (PEER, 1.0, 1.0)
    ours, theirs = Cost(2.0, 3.0, 2.5, 1.0), Cost(4.0, 4.0, 8.0, 2.0)
    shares = EstimatorCost("ours", 1, 1, ours, theirs).row()
    assert (shares["median_ratio"], shares["mean_ratio"]) == (2.0 / 4.0, 3.0 / 4.0)


def test_a_cost_is_a_median_over_frames_and_a_sum_over_objects():
    spent = [Effort(1, 0.004, 0.003, 0.003), Effort(2, 0.004, 0.004, 0.002), Effort(5, 0.005, 0.005, 0.003)]
    found = cost(spent)
    assert found.median_ms == pytest.approx(4.0 / 2)
    assert found.mean_ms == pytest.approx((4.0 + 4.0 + 5.0) / 8)
    assert found.cpu_ms == pytest.approx((3.0 + 4.0 + 5.0) / 8)
    assert found.threads == pytest.approx((3 + 4 + 5) / (3 + 2 + 3))


def test_an_effort_tells_what_other_threads_did():
    def spin():
        while time.thread_time() < 0.02:
            pass

    def elsewhere():
        thread = threading.Thread(target=spin)
        thread.start()
        thread.join()

    found = effort(elsewhere, 3)
    assert found.n == 3
    assert found.cpu - found.own_cpu >= 0.019
    assert found.wall >= 0.019


@pytest.mark.parametrize(
    ("names", "classes", "error", "message"),
    [
        (("adh-3d", "adh-3d"), CLASSES, InputError, "estimators has adh-3d twice"),
        ((), CLASSES, InputError, "estimators is empty"),
        (("icq",), CLASSES, UnknownEstimatorError, "Did you mean 'icp'?"),
        (("centroid-kf",), ("Tram",), InputError, "no pair of consecutive segments of Tram after the first 5 frames"),
    ],
)
def test_what_cannot_be_timed_is_refused(store, names, classes, error, message):
    with pytest.raises(error) as raised:
        time_estimators([store], names, classes)
    assert message in str(raised.value)


def test_methods_that_never_have_a_pair_are_refused_too():
    with pytest.raises(InputError, match="expected more than 3 frames .* got 0"):
        streaming.time_streams([[{1: np.ones((5, 3))}]], ["centroid"])


ONE_THREAD = """
import os
from evaluation.cores import effort, keep_to_one_core
is_bound = keep_to_one_core()
import numpy as np
from evaluation.runtime import car_points
from evaluation.streaming import PairByPair
from registration.libraries import load_open3d
icp, rng = PairByPair(load_open3d("a test")), np.random.default_rng(0)
pairs = [(car_points(rng, 5000), car_points(rng, 5000))]
icp.align(pairs)
spent = effort(lambda: icp.align(pairs), 1)
print(is_bound, os.environ["OMP_NUM_THREADS"], len(os.sched_getaffinity(0)), spent.cpu < 1.1 * spent.own_cpu)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to a core")
def test_one_core_is_one_thread_of_open3d_too():
    environment = {key: value for key, value in os.environ.items() if key != cores.THREADS}
    found = subprocess.run([sys.executable, "-c", ONE_THREAD], env=environment, capture_output=True, text=True)
    assert found.stdout.split() == ["True", "1", "1", "True"], found.stderr


def test_who_asks_for_more_threads_is_not_bound(monkeypatch):
    monkeypatch.setattr(os, "sched_setaffinity", lambda *_: pytest.fail("bound all the same"), raising=False)
    monkeypatch.setenv(cores.THREADS, "2")
    assert not cores.keep_to_one_core()
    assert cores.in_force().endswith("OMP_NUM_THREADS: 2")


def test_without_data_estimators_run_on_a_street(monkeypatch):
    played = []

    def play(out, scene, frames, seed, progress, written):
        played.append((scene, frames, seed, written[0]))
        write_tracking(out, written[0], N_FRAMES)

    monkeypatch.setattr(timings, "play_scene", play)
    order = timings.Order(None, (), CLASSES, ("centroid",), ("centroid-kf",), growth=False, seed=3)
    found = timings.measure(order, lambda what, done, total: None)
    assert played == [("street", timings.STREET_FRAMES, 3, "0000")]
    n = N_FRAMES - WARM_UP_FRAMES
    assert [(row.what, row.n_frames, row.n_objects) for row in found.costs] == [
        ("centroid-kf", n, 2 * n), (PEER, n, 2 * n),
    ]  # fmt: skip
    (_, _, methods), (title, header, body) = timings.tables(found)
    assert [row[0] for row in methods] == ["centroid: a transform"]
    assert "OMP_NUM_THREADS" in title
    assert {len(header)} == {len(row) for row in body}
