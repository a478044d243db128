"""The benchmark puts a learned method beside its network's plain way, and it is faster."""

import numpy as np

from evaluation import streaming


def test_a_learned_method_is_timed_beside_its_plain_way():
    stream = list(streaming.generated_stream(np.random.default_rng(0), n_frames=8, n_objects=4))
    timings = streaming.time_streams([stream], ["centroid", "alignnet"])
    assert [(t.what, t.peer) for t in timings] == [
        ("centroid: a transform", streaming.PEER),
        ("alignnet: a transform", streaming.PEER),
        ("alignnet: a transform by itself", streaming.PLAIN),
    ]
    assert 0.0 < timings[2].ratio < 0.5  # 0.1 on a quiet machine
