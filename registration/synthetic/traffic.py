"""Statistics of labelled traffic around a car, and how to draw from them: places, headings, motions, boxes, jitter.

The numbers are summaries (histograms, quantiles, covariances) of KITTI's tracking labels in `kitti_traffic.json`;
`scripts/kitti_statistics.py` derives them.  "Relative" is relative to the sensor, which moves.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from registration import planar
from registration.errors import SimulationError, unknown_name
from registration.types import Point

STATISTICS_PATH = Path(__file__).with_name("kitti_traffic.json")

GROUPS = {"vehicles": ("Car", "Van"), "persons": ("Pedestrian",)}
PERIOD = 0.1  # between two frames [s]
MAX_GAP = 10  # frames, of pairs that are not hard, and the least of those that are
HARD_TURN = np.deg2rad(45.0)  # the least between the looks of a hard pair
BESIDE = 1.0  # free space to a neighbour at most [m]
TURNING = 0.08  # a relative turn rate above this is no noise [rad/s]

# Histograms: values outside the edges count in the nearest bin.
RANGE_EDGES = np.array([1.5, 5.0, 7.5, 10.0, 12.5, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0, 70.0, 80.0])
BEARING_EDGES = np.deg2rad(np.arange(-90.0, 91.0, 7.5))
FAR_EDGES = np.array([0.0, 10.0, 20.0, 40.0, 80.0])
SIDE_EDGES = np.deg2rad([-90.0, -20.0, -5.0, 5.0, 20.0, 90.0])
LANE_EDGES = np.array([-80.0, -4.5, -1.5, 1.5, 4.5, 80.0])  # y in the sensor's axes [m]
N_HEADINGS = 48
N_KINDS = 3  # of headings: away, towards, across
N_LEVELS = 3  # of occlusion: visible, partly, largely hidden
LEVELS = np.array([
    0.001, 0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5,
    0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 0.975, 0.99, 0.999,
])  # fmt: skip
MAX_DEVIATION = 2.5  # of a size, in standard deviations

Values = Float64[np.ndarray, " n"]
Bins = Int64[np.ndarray, " n"]


class Sight(NamedTuple):
    """Where an object is, seen from the sensor.

    Attributes:
        range_m: horizontal distance of its centre.
        bearing: of its centre [rad].
        yaw: its heading [rad].
    """

    range_m: float
    bearing: float
    yaw: float

    @property
    def xy(self) -> Float64[np.ndarray, "2"]:
        """Its centre [m]."""
        return self.range_m * np.array([np.cos(self.bearing), np.sin(self.bearing)])


class Motion(NamedTuple):
    """How an object moves relative to the sensor.

    Attributes:
        velocity: of its centre, in its own axes [m/s].
        turn_rate: [rad/s].
    """

    velocity: Float64[np.ndarray, "2"]
    turn_rate: float


def bins_of(values: Values, edges: Float64[np.ndarray, " k"]) -> Bins:
    """Find the bin of each value; those outside count in the nearest."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def heading_bin(heading: Values) -> Bins:
    """Find the bins of angles [rad], the first of which starts at -pi."""
    share = (heading + np.pi) / (2.0 * np.pi)
    return np.floor(N_HEADINGS * (share % 1.0)).astype(np.int64) % N_HEADINGS


def heading_kind(yaw: Values) -> Bins:
    """Tell headings [rad] that go with the sensor's (0) from those against it (1) and across (2)."""
    forward = np.cos(yaw)
    limit = np.cos(np.deg2rad(45.0))
    return np.where(forward > limit, 0, np.where(forward < -limit, 1, 2)).astype(np.int64)


def count_places(place: Float64[np.ndarray, "n 2"], weight: Values | None = None) -> Float64[np.ndarray, "r b"]:
    """Count places (range [m], bearing [rad]) in the joint histogram; those beyond 80 m do not count."""
    near = place[:, 0] <= RANGE_EDGES[-1]
    counts = np.zeros((len(RANGE_EDGES) - 1, len(BEARING_EDGES) - 1))
    rows = bins_of(place[near, 0], RANGE_EDGES), bins_of(place[near, 1], BEARING_EDGES)
    np.add.at(counts, rows, 1.0 if weight is None else weight[near])
    return counts


@dataclass(frozen=True)
class Traffic:
    """Statistics of one group of classes; every method draws from them.

    Attributes:
        tables: the group's part of the JSON file.
    """

    tables: dict[str, Any]

    @property
    def n_boxes(self) -> int:
        """Number of labels that were summarised."""
        return int(self.tables["n_boxes"])

    def class_name(self, rng: np.random.Generator) -> str:
        """Draw a class as often as it is seen."""
        return draw_share({name: found["share"] for name, found in self.tables["classes"].items()}, rng)

    def size(self, class_name: str, rng: np.random.Generator) -> Point:
        """Draw length, width, height of a label box [m]."""
        found = self.tables["classes"][class_name]
        normal = np.clip(rng.standard_normal(3), -MAX_DEVIATION, MAX_DEVIATION)
        return np.exp(np.array(found["log_size"]) + np.linalg.cholesky(np.array(found["log_size_cov"])) @ normal)

    def sight(self, rng: np.random.Generator) -> Sight:
        """Draw where an object is and where it heads."""
        range_m, bearing = draw_place(self.tables["place"], rng)
        far, side = _bin(range_m, FAR_EDGES), _bin(bearing, SIDE_EDGES)
        heading = draw_heading(self.tables["heading"][far][side], rng)
        return Sight(range_m, bearing, planar.wrap(bearing + heading))

    def motion(self, sight: Sight, rng: np.random.Generator) -> Motion:
        """Draw how an object there moves."""
        kind = int(heading_kind(np.array([sight.yaw]))[0])
        turn_rate = draw_quantile(self.tables["turn_rate"][kind], rng)
        is_turning = int(abs(turn_rate) >= TURNING)
        lane = _bin(float(sight.xy[1]), LANE_EDGES)
        along = draw_quantile(self.tables["speed"][is_turning][kind][lane], rng)
        across = draw_quantile(self.tables["sideways"][is_turning][kind], rng)
        by_ego = rng.uniform() < self.tables["ego_turns"][kind]
        if is_turning and by_ego:
            across += turn_rate * float(sight.xy @ [np.cos(sight.yaw), np.sin(sight.yaw)])
        return Motion(np.array([along, across]), turn_rate)

    def ground(self, range_m: float, rng: np.random.Generator) -> float:
        """Draw the height of the ground below an object, seen from the sensor [m]."""
        return draw_quantile(self.tables["ground"][_bin(range_m, FAR_EDGES)], rng)

    def occlusion(self, range_m: float, rng: np.random.Generator) -> int:
        """Draw how far an object is hidden, in KITTI's levels."""
        return draw_row(self.tables["occlusion"][_bin(range_m, FAR_EDGES)], rng)

    def occlusion_later(self, level: int, gap: int, rng: np.random.Generator) -> int:
        """Draw its level `gap` frames later."""
        return draw_row(self.tables["occlusion_later"][min(gap, MAX_GAP) - 1][level], rng)

    def jitter(self, range_m: float, rng: np.random.Generator) -> Float64[np.ndarray, "4"]:
        """Draw how far a label is off: along, across and above the object's axes [m], and in yaw [rad]."""
        columns = self.tables["jitter"][_bin(range_m, FAR_EDGES)]
        return np.array([draw_quantile(column, rng) for column in columns])

    def beside(self, rng: np.random.Generator) -> tuple[str, float, int] | None:
        """Draw a neighbour: its class, the free space [m], and 0 before, 1 behind, 2 left, 3 right; None for none."""
        table = self.tables["beside"]
        if rng.uniform() >= table["share"]:
            return None
        side = draw_row(table["sides"], rng)
        return draw_share(table["classes"], rng), draw_quantile(table["gap"], rng), side

    def before(self, rng: np.random.Generator) -> tuple[str | None, float]:
        """Draw what hides an object: its class, None for no road user; and its distance as a share of the object's."""
        table = self.tables["before"]
        return draw_share(table["classes"], rng) or None, draw_quantile(table["depth"], rng)

    def hard_gap(self, rng: np.random.Generator) -> int:
        """Draw how many frames lie between the two looks of a hard pair."""
        return max(MAX_GAP, round(draw_quantile(self.tables["hard"]["gap"], rng)))

    def hard_sights(self, rng: np.random.Generator) -> tuple[Sight, Sight]:
        """Draw where an object is at the two looks of a hard pair."""
        table = self.tables["hard"]
        (start_range, start_bearing), end = draw_place(table["start"], rng), draw_place(table["end"], rng)
        yaw = start_bearing + draw_heading(table["heading"], rng)
        turn = max(HARD_TURN, draw_quantile(table["turn"], rng)) * (1.0 if rng.uniform() < table["left"] else -1.0)
        return Sight(start_range, start_bearing, planar.wrap(yaw)), Sight(*end, planar.wrap(yaw + turn))


@lru_cache
def kitti_traffic(group: str) -> Traffic:
    """Load the statistics of `vehicles` or `persons`.

    Raises:
        SimulationError: no such group.
    """
    if group not in GROUPS:
        raise SimulationError(unknown_name("group of classes", group, GROUPS))
    return Traffic(_statistics()[group])


def source_sequences() -> list[str]:
    """List the sequences that the statistics come from."""
    return list(_statistics()["sequences"])


def _statistics() -> dict[str, Any]:
    return dict(json.loads(STATISTICS_PATH.read_text()))


def draw_quantile(quantiles: list[float], rng: np.random.Generator) -> float:
    """Draw a value whose quantiles at LEVELS are known: linear between them, and no farther than the outermost."""
    return float(np.interp(rng.uniform(), LEVELS, quantiles))


def draw_share(shares: dict[str, float], rng: np.random.Generator) -> str:
    """Draw a name as often as its share says."""
    return list(shares)[draw_row(list(shares.values()), rng)]


def draw_row(weights: list[float], rng: np.random.Generator) -> int:
    """Draw the index of a weight, as often as it weighs."""
    p = np.array(weights)
    return int(rng.choice(len(p), p=p / p.sum()))


def draw_place(counts: list[list[float]], rng: np.random.Generator) -> tuple[float, float]:
    """Draw range [m] and bearing [rad] from their joint histogram."""
    row, column = divmod(draw_row(np.array(counts).ravel().tolist(), rng), len(BEARING_EDGES) - 1)
    return _within(RANGE_EDGES, row, rng), _within(BEARING_EDGES, column, rng)


def draw_heading(counts: list[float], rng: np.random.Generator) -> float:
    """Draw a heading [rad] from its histogram; one that was never seen is any."""
    k = draw_row(counts if any(counts) else [1.0] * N_HEADINGS, rng)
    return float(2.0 * np.pi * (k + rng.uniform()) / N_HEADINGS - np.pi)


def _bin(value: float, edges: Float64[np.ndarray, " k"]) -> int:
    return int(bins_of(np.array([value]), edges)[0])


def _within(edges: Float64[np.ndarray, " k"], k: int, rng: np.random.Generator) -> float:
    return float(rng.uniform(edges[k], edges[k + 1]))
