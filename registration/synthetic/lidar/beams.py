"""What a spinning LiDAR is made of: its beams, how it turns, and how well it hears their echoes."""

import dataclasses
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float64, Int64

from registration.errors import SimulationError
from registration.types import Points

_NEVER_NEGATIVE = ("range_noise", "range_noise_growth", "slant_noise", "divergence", "min_grazing", "loss_scale")
_PER_BEAM = ("azimuth_offsets", "beam_heights", "range_offsets")


class Turn(str, Enum):
    """Which way a sensor turns, seen from above."""

    CLOCKWISE = "clockwise"
    COUNTER_CLOCKWISE = "counter-clockwise"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True)
class Jitter:
    """Noise on each coordinate of a point: clip(s N(0, 1), +-limit), s = max(minimum, slope * distance of the mesh).

    Source: protocol of the synthetic sets of AlignNet-3D (3DV 2019), section 4.

    Attributes:
        slope: standard deviation for each metre from the sensor to the mesh's centroid.
        minimum: of the standard deviation [m].
        limit: of the noise [m].
    """

    slope: float = 0.05 / 80.0
    minimum: float = 0.005
    limit: float = 0.05


@dataclass(frozen=True, slots=True)
class BeamModel:
    """A spinning LiDAR whose beams all start on its axis; each physical parameter is one attribute.

    A return is lost by chance: always with `misfire`; the more, the flatter the beam hits (`min_grazing`);
    the more, the weaker the echo is, which falls with range, slant, dark surfaces and surfaces that only catch part
    of the beam (`reach`, `fade`); and as the material says (`loss_scale`; glass).

    Attributes:
        name: as tables print it.
        elevations: angle of each beam above the horizon [rad].
        azimuth_step: turn between two firings [rad].
        azimuth_offsets: azimuth of each beam minus that of the sensor's head, counter-clockwise [rad]; None for 0.
        beam_heights: where on the axis each beam starts, above the sensor's origin [m]; None for 0.
        range_offsets: constant error of each beam's range [m]; None for 0.
        period: time of a full turn [s].
        turn: which way the head turns.
        cut_azimuth: direction of the head in which a sweep ends and the next one begins [rad].
        is_free_running: whether a sweep starts at a random fraction of an azimuth step; else always on the cut.
        height: of the sensor above the ground, where a scene does not say otherwise [m].
        min_range: nothing nearer is returned [m].
        max_range: nor farther [m].
        range_noise: standard deviation of a range [m].
        range_noise_growth: what it grows by with each metre of range [m/m].
        slant_noise: and with the depth of the beam's footprint on a slanted surface, as a share of it.
        jitter: noise on each coordinate besides; None for none.
        divergence: full angle of a beam [rad]; 0 for beams that are lines.
        echo_length: echoes nearer to each other merge into one [m].
        reach: range at which half of the echoes of a white surface hit head-on get lost [m].
        fade: how suddenly echoes get lost around their reach: exponent of range over reach.
        min_grazing: angle between beam and surface below which returns thin out [rad].
        misfire: share of pulses lost for no reason.
        loss_scale: factor on the materials' own losses (`SURFACES`); 0 for a sensor that sees all glass.
        intensity_noise: standard deviation of an intensity, relative.
    """

    name: str
    elevations: Float64[np.ndarray, " beams"]
    azimuth_step: float
    azimuth_offsets: Float64[np.ndarray, " _"] | None = None
    beam_heights: Float64[np.ndarray, " _"] | None = None
    range_offsets: Float64[np.ndarray, " _"] | None = None
    period: float = 0.1
    turn: Turn = Turn.CLOCKWISE
    cut_azimuth: float = float(np.pi)
    is_free_running: bool = True
    height: float = 1.73
    min_range: float = 0.9
    max_range: float = 120.0
    range_noise: float = 0.017
    range_noise_growth: float = 0.0
    slant_noise: float = 0.0
    jitter: Jitter | None = None
    divergence: float = 0.0
    echo_length: float = 0.75
    reach: float = 320.0
    fade: float = 6.0
    min_grazing: float = float(np.deg2rad(1.5))
    misfire: float = 0.01
    loss_scale: float = 1.0
    intensity_noise: float = 0.08

    def __post_init__(self) -> None:
        if len(self.elevations) == 0 or not 0.0 < self.azimuth_step <= np.pi:
            raise SimulationError("a beam model needs at least one beam and 0 < azimuth_step <= pi")
        if not 0.0 <= self.min_range < self.max_range:
            raise SimulationError("a beam model needs 0 <= min_range < max_range")
        if not np.all(np.abs(self.elevations) < 0.5 * np.pi):
            raise SimulationError("a beam model needs elevations between -90 and 90 degrees")
        for name in _PER_BEAM:
            values = getattr(self, name)
            if values is not None and (len(values) != self.n_beams or not np.isfinite(values).all()):
                raise SimulationError(f"a beam model needs one finite number a beam in {name}: {self.n_beams} of them")
        negative = [name for name in _NEVER_NEGATIVE if not getattr(self, name) >= 0.0]
        if negative or not (self.period > 0.0 and self.reach > 0.0):
            raise SimulationError(f"a beam model needs period and reach > 0, and {', '.join(_NEVER_NEGATIVE)} >= 0")

    @property
    def n_beams(self) -> int:
        """Number of beams."""
        return len(self.elevations)

    @property
    def n_azimuths(self) -> int:
        """Number of firings in a full turn."""
        return round(2.0 * np.pi / self.azimuth_step)

    def per_beam(self, name: str) -> Float64[np.ndarray, " beams"]:
        """Give one of `azimuth_offsets`, `beam_heights` and `range_offsets`; zeros where there are none."""
        values = getattr(self, name)
        return np.zeros(self.n_beams) if values is None else values

    def as_built(self, seed: int, range_spread: float = 0.01, azimuth_spread: float = 0.5) -> "BeamModel":
        """Draw one specimen of this model: what its calibration leaves over, the same in every sweep.

        Velodyne states 2 cm (1 sigma) for the HDL-64E before, and Glennie & Lichti ("Static calibration and analysis
        of the Velodyne HDL-64E S2", Remote Sensing 2(6), 2010) find 1.3 cm after a calibration of each laser.

        Args:
            seed: of the specimen.
            range_spread: standard deviation of the lasers' range offsets [m].
            azimuth_spread: lasers are shifted by up to this share of an azimuth step, either way.
        """
        rng = np.random.default_rng(seed)
        range_offsets = range_spread * rng.standard_normal(self.n_beams)
        shifts = self.azimuth_step * rng.uniform(-azimuth_spread, azimuth_spread, self.n_beams)
        return dataclasses.replace(
            self,
            range_offsets=self.per_beam("range_offsets") + range_offsets,
            azimuth_offsets=self.per_beam("azimuth_offsets") + shifts,
        )


@dataclass(frozen=True, slots=True)
class Rays:
    """Where pulses start, where they go, and when.

    Attributes:
        directions: unit vectors in the sensor's frame at the time of firing.
        height: of their starts on the sensor's axis above its origin [m].
        column: which firing of the head each one is of.
        times: of the firings, after the moment when the head points forward [s].
    """

    directions: Points
    height: Float64[np.ndarray, " n"]
    column: Int64[np.ndarray, " n"]
    times: Float64[np.ndarray, " columns"]

    @property
    def time(self) -> Float64[np.ndarray, " n"]:
        """When each one is fired [s]."""
        return self.times[self.column]


def fire(beam_model: BeamModel, phase: float = 0.0) -> Rays:
    """List the rays of a full turn, beam after beam, each from head azimuth `phase` [rad] counter-clockwise.

    Points keep the frame of their own time of firing, as in raw sweeps: a ray's direction depends on its azimuth only.
    """
    n_beams, n_azimuths = beam_model.n_beams, beam_model.n_azimuths
    return Rays(
        directions=ray_directions(beam_model, phase),
        height=np.repeat(beam_model.per_beam("beam_heights"), n_azimuths),
        column=np.tile(np.arange(n_azimuths), n_beams),
        times=_firing_time(beam_model, _head_azimuth(beam_model, phase)),
    )


def ray_directions(beam_model: BeamModel, phase: float = 0.0) -> Points:
    """List the unit vectors of a full turn, beam after beam, each from head azimuth `phase` [rad] counter-clockwise."""
    head, offset = _head_azimuth(beam_model, phase), beam_model.per_beam("azimuth_offsets")[:, None]
    elevation = beam_model.elevations[:, None]
    directions = np.empty((beam_model.n_beams, beam_model.n_azimuths, 3))
    # cos(head + offset) and its like by the sum formulas: a cosine a column and a beam, not one a ray.
    across = np.cos(elevation) * np.cos(offset), np.cos(elevation) * np.sin(offset)
    directions[..., 0] = across[0] * np.cos(head) - across[1] * np.sin(head)
    directions[..., 1] = across[0] * np.sin(head) + across[1] * np.cos(head)
    directions[..., 2] = np.sin(elevation)
    return directions.reshape(-1, 3)


def _head_azimuth(beam_model: BeamModel, phase: float) -> Float64[np.ndarray, " columns"]:
    return phase + 2.0 * np.pi * np.arange(beam_model.n_azimuths) / beam_model.n_azimuths


def _firing_time(
    beam_model: BeamModel, head_azimuth: Float64[np.ndarray, " columns"]
) -> Float64[np.ndarray, " columns"]:
    """Tell when the head points where: 0 forward, and a jump of one period at the cut [s]."""
    sense = -1.0 if beam_model.turn == Turn.CLOCKWISE else 1.0
    since_cut = np.mod(sense * (head_azimuth - beam_model.cut_azimuth) / (2.0 * np.pi), 1.0)
    forward = np.mod(-sense * beam_model.cut_azimuth / (2.0 * np.pi), 1.0)
    return beam_model.period * (since_cut - forward)
