"""What a velocity costs: estimators step through sequences, and Open3D's ICP takes its turn in every frame."""

import gc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from evaluation.compare import check_list
from evaluation.cores import Cost, Effort, cost, effort
from evaluation.streaming import PairByPair
from registration.libraries import load_open3d
from registration.types import Points
from tracker.errors import InputError
from tracker.estimators import create_estimator
from tracker.store import SegmentStore
from tracker.tracklets import of_classes
from tracker.types import Segment

PEER = "Open3D point-to-point ICP"
WARM_UP_FRAMES = 5  # of each sequence: what is compiled or loaded on first use, and tracks that are new, do not count

# name, attribute, format: the columns of the table
TABLE = (
    ("an object and frame", "what", "{}"),
    ("frames", "n_frames", "{}"),
    ("objects", "n_objects", "{}"),
    ("median [ms]", "median_ms", "{:.2f}"),
    ("mean [ms]", "mean_ms", "{:.2f}"),
    ("CPU [ms]", "cpu_ms", "{:.2f}"),
    ("threads", "threads", "{:.2f}"),
    ("median / ICP's", "median_ratio", "{:.2f}"),
    ("mean / ICP's", "mean_ratio", "{:.2f}"),
)

Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True, slots=True)
class EstimatorCost:
    """A row of the table: an estimator, or the peer, over the frames and objects that all of them had.

    Attributes:
        what: name of an estimator, or PEER.
        n_frames, n_objects: timed; an object counts once in each frame in which it has points, as in the frame before.
        cost: of an object in a frame.
        peer: that of Open3D's ICP in the same frames.
    """

    what: str
    n_frames: int
    n_objects: int
    cost: Cost
    peer: Cost

    def row(self) -> dict[str, str | int | float]:
        """Give the figures by the names that TABLE knows; ratios are shares of the peer's."""
        return {
            "what": self.what,
            "n_frames": self.n_frames,
            "n_objects": self.n_objects,
            "median_ms": self.cost.median_ms,
            "mean_ms": self.cost.mean_ms,
            "cpu_ms": self.cost.cpu_ms,
            "threads": self.cost.threads,
            "median_ratio": self.cost.median_ms / self.peer.median_ms,
            "mean_ratio": self.cost.mean_ms / self.peer.mean_ms,
        }


def time_estimators(
    stores: Sequence[SegmentStore],
    names: Sequence[str],
    classes: Sequence[str],
    seed: int = 0,
    progress: Progress | None = None,
) -> list[EstimatorCost]:
    """Let estimators step through sequences as `compare` has them do, taking turns frame by frame with Open3D's ICP.

    In each frame an estimator gets all segments at once, those of new tracks and empty ones too, in the world where the
    store has poses.  The ICP gets the same frame's pairs of consecutive segments, one by one, and makes its own clouds
    of both.  Both are divided by the number of pairs; frames without any, and the first of each sequence, are left
    out.  Who comes first changes from frame to frame.

    Args:
        stores: one a sequence.
        names: of estimators.
        classes: of objects.
        seed: for methods that draw random numbers.
        progress: told of every frame.

    Returns:
        a row for each estimator, in order, and one for the peer.

    Raises:
        InputError: no name, one twice, or nothing to time.
        UnknownEstimatorError: no such estimator.
        RegistrationError: a method that cannot be used, or no Open3D.
    """
    check_list("estimators", names)
    icp = PairByPair(load_open3d("the comparison with Open3D's ICP"))
    efforts: dict[str, list[Effort]] = {name: [] for name in (*names, PEER)}
    for store in stores:
        _time_sequence(store, classes, seed, icp, efforts, progress)
    if not efforts[PEER]:
        what = f"no pair of consecutive segments of {', '.join(classes)} after the first {WARM_UP_FRAMES} frames"
        raise InputError(f"{what} of {', '.join(str(store.folder) for store in stores) or 'no sequence'} to time")
    n_objects = sum(e.n for e in efforts[PEER])
    costs = {name: cost(spent) for name, spent in efforts.items()}
    return [EstimatorCost(name, len(efforts[PEER]), n_objects, costs[name], costs[PEER]) for name in efforts]


def _time_sequence(
    store: SegmentStore,
    classes: Sequence[str],
    seed: int,
    icp: PairByPair,
    efforts: Mapping[str, list[Effort]],
    progress: Progress | None,
) -> None:
    """Go through a sequence from its start with new estimators, and add what each frame took."""
    estimators = {name: create_estimator(name, seed=seed) for name in efforts if name != PEER}
    gc.collect()  # what loading libraries leaves behind is on nobody's bill; what estimators do is
    last: Mapping[int, Segment] = {}
    for k, frame in enumerate(store.frames()):
        segments = of_classes(frame.segments, classes)
        pairs = consecutive(last, segments)
        turns: dict[str, Callable[[], object]] = {PEER: partial(icp.align, pairs)}
        for name, estimator in estimators.items():
            turns[name] = partial(estimator.step, segments, frame.timestamp, frame.T_world_lidar)
        for name in in_turn(list(turns), k):
            spent = effort(turns[name], len(pairs))
            if pairs and k >= WARM_UP_FRAMES:
                efforts[name].append(spent)
        last = segments
        if progress is not None:
            progress("timing estimators", k + 1, len(store))


def consecutive(last: Mapping[int, Segment], now: Mapping[int, Segment]) -> list[tuple[Points, Points]]:
    """Pair the points of objects that have some in two frames, the earlier ones first."""
    pairs = [(last[key].points_lidar, segment.points_lidar) for key, segment in now.items() if key in last]
    return [(before, after) for before, after in pairs if len(before) and len(after)]


def in_turn(names: Sequence[str], k: int) -> list[str]:
    """Give the order of a frame: in the next one, each comes a place earlier, and the first comes last."""
    first = k % len(names)
    return [*names[first:], *names[:first]]
