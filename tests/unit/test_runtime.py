"""The benchmark: who is timed against whom, on what."""

from itertools import pairwise

import numpy as np

from evaluation import runtime, streaming


def test_growth_is_timed_for_each_number_of_points_and_of_pairs():
    timings = runtime.benchmark(methods=("adh-3d",), points=(50, 100), pairs=(2,))
    assert [t.what.split(":")[0] for t in timings[1:]] == [
        "adh-3d, 50 points, 8 pairs a call", "adh-3d, 100 points, 8 pairs a call", "adh-3d, 200 points, 2 pairs a call",
    ]  # fmt: skip
    assert all(0.0 < t.ratio == t.ours_ms / t.peer_ms for t in timings)


def test_a_stream_prepares_each_segment_once_and_aligns_it_with_its_past():
    stream = list(streaming.generated_stream(np.random.default_rng(0), n_frames=5, n_objects=3))
    calls = {"prepared": 0, "aligned": 0}

    class Counting:
        name = "counting"

        def prepare(self, clouds):
            calls["prepared"] += len(clouds)
            return list(clouds)

        def align(self, pairs, priors=None):
            calls["aligned"] += len(pairs)
            assert all(len(a) == len(b) for a, b in pairs)  # the same object
            return []

        def register(self, source, target, prior=None):
            raise AssertionError("a stream aligns all pairs of a frame in one call")

    contestant = streaming.Contestant(Counting())
    for segments in stream:
        contestant.step(segments)
    assert calls == {"prepared": 15, "aligned": 12}
    assert len(contestant.ms) == 4


def test_the_generated_stream_moves():
    frames = list(streaming.generated_stream(np.random.default_rng(0), n_frames=3, n_objects=2))
    for before, after in pairwise(frames):
        shift = after[1].mean(axis=0) - before[1].mean(axis=0)
        np.testing.assert_allclose(shift, [0.05, 0.02, 0.0], atol=0.12)
