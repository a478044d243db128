"""Objects: windows of their places, those of their headings, and the looks that belong to their frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from tracker.estimators.fused import track_kernels
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.look import Look
from tracker.estimators.fused.look_numbers import N_COLUMNS, TIME, numbers_of
from tracker.estimators.fused.sensor import TURNS, Sensor
from tracker.estimators.fused.window import MotionModel, Rows, Windows

Vectors = Float64[np.ndarray, "k 2"]

MOST_CENTERS = 20  # looks that count for where an object's centre is
NOWHERE = np.full(2, np.nan)


@dataclass
class Track:
    """One object.

    Attributes:
        row: of what is known of it, see `Tracks`.
        looks: one for each frame of its windows, but for the frame that is being looked at.
    """

    row: int
    looks: list[Look]

    def append(self, look: Look, n_frames: int) -> None:
        """Take the latest look; the oldest one leaves where there are more than `n_frames`."""
        self.looks.append(look)
        if len(self.looks) > n_frames:
            self.looks.pop(0)


class Tracks:
    """What is known of objects, a row for each.

    Attributes:
        places: of their reference points.
        turns: of their headings, as they look in axes that may turn themselves.
        looks: numbers of the looks at each frame of these windows, see `look_numbers` (C, n, columns).
        centers: of the objects relative to their places, in the axes of their first looks [m]: means over `n_centers`
            looks, of which no more than MOST_CENTERS count (C, 2).
        n_centers: (C).
    """

    def __init__(self, place: MotionModel, turn: MotionModel) -> None:
        """Take the models of the motion of places, and of headings; there are no objects yet."""
        self.places, self.turns = Windows(place, 2), Windows(turn, 1)
        n = self.places.n_rows
        self.looks = np.zeros((n, place.n_frames, N_COLUMNS))
        self.centers, self.n_centers = np.zeros((n, 2)), np.zeros(n, np.int64)
        self._free = list(range(n))[::-1]
        self._densities = float(place.density), float(turn.density)

    def start(self, looks: Sequence[Look], axes: Heading, rate_sd: float) -> list[Track]:
        """Begin objects at the middles of looks.

        Args:
            looks: at the objects.
            axes: whose latest frame it is.
            rate_sd: standard deviation of their velocities, along each axis [m/s].
        """
        while len(self._free) < len(looks):
            self._make_room()
        at = np.array([self._free.pop() for _ in looks], dtype=np.int64)
        middles = [0.5 * (look.points.min(axis=0) + look.points.max(axis=0))[:2] for look in looks]
        self.looks[at, 0] = [numbers_of(look) for look in looks]
        self.centers[at], self.n_centers[at] = 0.0, 0
        times = np.ascontiguousarray(self.looks[at, 0, TIME])
        self.places.start(at, times, axes, np.array(middles), rate_sd)
        self.turns.start(at, times, axes, np.zeros((len(at), 1)))
        return [Track(row, [look]) for row, look in zip(at.tolist(), looks, strict=True)]

    def drop(self, track: Track) -> None:
        """Let another object have its row."""
        self._free.append(track.row)

    def _make_room(self) -> None:
        n = self.places.n_rows
        self.places.make_room()
        self.turns.make_room()
        self.looks, self.centers = np.concatenate([self.looks] * 2), np.concatenate([self.centers] * 2)
        self.n_centers = np.concatenate([self.n_centers] * 2)
        self._free = [*range(2 * n - 1, n - 1, -1), *self._free]

    def advance(self, at: Rows, new: Sequence[Look], axes: Heading, pose_turn_sd: float) -> None:
        """Expect objects where their motion leads, in axes whose turn may be off by so much [rad]."""
        numbers = np.array([numbers_of(look) for look in new])
        track_kernels.advance(
            self.places.rows,
            *self.turns.rows[:2],
            self.looks,
            at,
            numbers,
            axes.turned(),
            self._densities,
            pose_turn_sd,
        )

    def look_back(self, at: Rows, looks: Sequence[Look], refers_to_center: bool) -> None:
        """Find objects' centres, as the network sees them in the latest looks, and note when the beams met them.

        Labels lie where the beams met the objects, so from frame to frame they move by what the object does between
        those moments, which for what passes by at 30 m/s and 4 m are a tenth less (or, on the right, more) than a frame
        apart.
        """
        shifts, state = np.array([look.shift for look in looks]), self._state()
        if refers_to_center:
            centers = [look.learned.center() for look in looks]
            seen = np.array([NOWHERE if center is None else center for center in centers])
            track_kernels.refer(*state, self.n_centers, at, seen + shifts, MOST_CENTERS)
        sensor = looks[0].sensor  # that of all looks of a frame
        track_kernels.note_met(*state, self.looks, at, shifts, sensor.numbers(), TURNS)

    def velocities_against(self, at: Rows, sensor: Sensor) -> Vectors:
        """Give how fast objects moved over their latest steps against a sensor [m/s]."""
        sizes, *state = self._state()
        times = self.places.rows.frames.times
        found: Vectors = track_kernels.against(sizes, times, *state, at, sensor.numbers())
        return found

    def _state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        places, turns = self.places.rows.frames, self.turns.rows.frames
        return places.sizes, places.state, turns.state, self.centers


def straightened(known: Tracks, tracks: Sequence[Track], at: Rows, new: Sequence[Look]) -> list[Look]:
    """Undo the motion of objects during the sweep in new looks, and in first ones, whose motion was not known.

    Where nothing is known of the motion, nothing is undone.
    """
    looks, counts = list(new), known.places.rows.comparisons.counts[at].tolist()
    bent = [
        k
        for k, (track, look) in enumerate(zip(tracks, new, strict=True))
        if counts[k] and (look.passed is not None or track.looks[-1].passed is not None)
    ]
    if bent:
        velocities = known.velocities_against(at[bent], new[0].sensor)
        for k, velocity in zip(bent, velocities, strict=True):
            tracks[k].looks[-1] = tracks[k].looks[-1].straightened(velocity)
            looks[k] = new[k].straightened(velocity)
    return looks
