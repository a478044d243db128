"""One object: its window of places, that of its heading, and the looks that belong to their frames."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from registration import planar
from tracker.estimators.fused.heading import Heading
from tracker.estimators.fused.look import Look
from tracker.estimators.fused.window import MotionModel, Vector, Window

Row = Float64[np.ndarray, " row"]
TurnRow = Float64[np.ndarray, " turn_row"]

MOST_CENTERS = 20  # looks that count for where an object's centre is


@dataclass
class Track:
    """One object.

    Attributes:
        place: its reference point.
        turn: its heading, as it looks in axes that may turn themselves.
        looks: one for each frame of these windows, but for the frame that is being looked at.
        center: of the object relative to its place, in the axes of its first look [m]: a mean over `n_centers` looks,
            of which no more than MOST_CENTERS count.
    """

    place: Window
    turn: Window
    looks: list[Look]
    center: Vector = field(default_factory=lambda: np.zeros(2))
    n_centers: int = 0

    @classmethod
    def start(cls, models: tuple[MotionModel, MotionModel], look: Look, axes: Heading) -> "Track":
        """Begin at the middle of a look.

        Args:
            models: of the motion of its place, and of its heading.
            look: at the object.
            axes: whose latest frame it is.
        """
        middle = 0.5 * (look.points.min(axis=0) + look.points.max(axis=0))[:2]
        place = Window.start(models[0], look.time, axes, middle)
        return cls(place, Window.start(models[1], look.time, axes, np.zeros(1)), [look])

    def advance(self, new: Look, axes: Heading, pose_turn_sd: float) -> None:
        """Expect the object where its motion leads, in axes whose turn may be off by so much [rad]."""
        arm = self.place.state[-1, 0] - new.sensor.place
        across = pose_turn_sd * np.array([-arm[1], arm[0]])
        has_left = self.place.advance(new.time, axes, across[:, None] * across)
        self.turn.advance(new.time, axes)
        if has_left:
            self.looks.pop(0)

    def hear(self, lag: int, step: Row | None, first: Vector, turn: TurnRow | None) -> None:
        """Take a comparison of the latest frame with the one `lag` before into account, from the next `solve` on.

        Args:
            lag: how many frames before.
            step: what is measured of the place, see `Window.take`; None: nothing.
            first: where it leads, in case nothing else is known yet.
            turn: what is measured of the turn; None: nothing.
        """
        if len(self.place) - lag == 1 and not self.place.comparisons:
            self.place.place_last(first)
        if step is not None:
            self.place.take(lag, step)
        if turn is not None:
            self.turn.take(lag, turn)

    def refer_to_center(self) -> None:
        """Let the network's opinion of the latest look count for where the centre is."""
        center = self.looks[-1].learned.center()
        if center is not None:
            away = center + self.looks[-1].shift - self.place.state[-1, 0]
            own = planar.rotation(-float(self.turn.state[-1, 0, 0])) @ away
            self.n_centers = min(self.n_centers + 1, MOST_CENTERS)
            self.center = self.center + (own - self.center) / self.n_centers

    def center_at(self, i: int) -> Vector:
        """Give the object's centre at frame i [m]."""
        found: Vector = self.place.state[i, 0] + planar.rotation(float(self.turn.state[i, 0, 0])) @ self.center
        return found


def straightened(tracks: Sequence[Track], new: Sequence[Look]) -> list[Look]:
    """Undo the motion of objects during the sweep in new looks, and in first ones, whose motion was not known.

    Where nothing is known of the motion, nothing is undone.
    """
    looks = list(new)
    known = [
        k
        for k, (track, look) in enumerate(zip(tracks, new, strict=True))
        if track.place.comparisons and (look.passed is not None or track.looks[-1].passed is not None)
    ]
    if not known:
        return looks
    places = np.array([tracks[k].place.state[-2:, 0] for k in known])
    seconds = np.array([tracks[k].place.times[-1] - tracks[k].place.times[-2] for k in known])
    velocities = (places[:, 1] - places[:, 0]) / seconds[:, None]
    velocities = velocities - new[0].sensor.carried(np.array([tracks[k].center_at(-1) for k in known]))
    for k, velocity in zip(known, velocities, strict=True):
        tracks[k].looks[-1] = tracks[k].looks[-1].straightened(velocity)
        looks[k] = new[k].straightened(velocity)
    return looks


def note_met(tracks: Sequence[Track]) -> None:
    """Note when the beams met the objects' centres in their latest looks, where velocities count by another time.

    Labels lie where the beams met the objects, so from frame to frame they move by what the object does between
    those moments, which for what passes by at 30 m/s and 4 m are a tenth less (or, on the right, more) than a frame
    apart.
    """
    tracks = [track for track in tracks if track.looks[-1].clock != track.looks[-1].time]
    if not tracks:
        return
    sensor, looks = tracks[0].looks[-1].sensor, [track.looks[-1] for track in tracks]
    centers = np.array([track.center_at(-1) - look.shift for track, look in zip(tracks, looks, strict=True)])
    for track, look, center, late in zip(tracks, looks, centers, sensor.delays(centers).tolist(), strict=True):
        track.looks[-1] = replace(look, late=late, past_end=sensor.past_end(center))
