"""The body of a parametric car: cross-sections from tail to nose, and the skin over them."""

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.interpolate import PchipInterpolator

from registration.synthetic.car_shapes import ARCH_GAP, CarShape
from registration.synthetic.meshes import Material, Mesh, loft

SIDE_ROW = 6  # quads of half a section that are the side windows, counted from the middle of the floor

_Stations = Float64[np.ndarray, " k"]  # distances from the tip of the nose [m]


def car_body(shape: CarShape, paint: Material, has_cladding: bool = False) -> Mesh:
    """Loft the body over cross-sections; x forward, around the middle of the car's length.

    Args:
        shape: what the outline is made of.
        paint: material of the body.
        has_cladding: the sills and bumpers are of black plastic.
    """
    u = _stations(shape)
    rings = _sections(shape, u)
    rings[..., 0] = (0.5 * shape.length - u)[:, None]
    material = _material(shape, 0.5 * (u[1:] + u[:-1]), rings.shape[1], paint)
    if has_cladding:
        material[:, [1, 2, -2, -3]] = Material.RUBBER
    return loft(rings, material, int(paint))


def eaves_half_width(shape: CarShape) -> float:
    """Half the width of the roof's flat part, in the middle of the car [m]."""
    rise = shape.height - shape.belt_height
    return 0.86 * (0.93 * 0.5 * shape.width - 0.9 * rise * float(np.tan(np.deg2rad(shape.tumblehome_deg))))


def _stations(shape: CarShape) -> _Stations:
    """Choose where cross-sections are cut, the tail first."""
    ends = np.array([0.0, 0.015, 0.04, 0.08, 0.13, 0.20, 0.30, 0.42])
    reach = shape.wheel_radius + ARCH_GAP
    arch = reach * np.concatenate([np.cos(np.linspace(0.0, np.pi, 13)), [1.004, -1.004]])
    axles = shape.front_overhang + np.array([0.0, shape.wheelbase])
    edges = np.concatenate([window for window, _ in _windows(shape)])
    bed = np.concatenate([[start, end] for start, end in _bed(shape)]) if shape.bed_depth else np.zeros(0)
    u = np.concatenate([
        np.linspace(0.0, shape.length, 48), ends, shape.length - ends, *(axle + arch for axle in axles), edges,
        bed - 0.01, bed + 0.01,
    ])  # fmt: skip
    u = np.unique(np.clip(u, 0.0, shape.length))
    return u[np.concatenate([[True], np.diff(u) > 1e-3])][::-1].copy()


def _bed(shape: CarShape) -> list[tuple[float, float]]:
    """Tell from where to where behind the nose a pick-up's bed reaches [m]."""
    return [(shape.length - shape.deck_length + 0.04, shape.length - 0.09)] if shape.bed_depth else []


def _tops(shape: CarShape, u: _Stations) -> _Stations:
    """Heights of the middle of the car [m]."""
    roof = shape.hood_length + shape.windscreen_run
    tail = shape.length - shape.deck_length
    heights = {
        0.0: shape.nose_share * shape.nose_height,
        0.05: 0.93 * shape.nose_height,
        0.20: shape.nose_height,
        0.6 * shape.hood_length: shape.nose_height + 0.62 * (shape.cowl_height - shape.nose_height),
        shape.hood_length: shape.cowl_height,
        roof - 0.12: shape.cowl_height + 0.86 * (shape.height - shape.cowl_height),
        roof + 0.10: shape.height - 0.025,
        roof + 0.5 * shape.roof_length: shape.height,
        tail - shape.backlight_run: shape.height - shape.roof_drop,
        tail: shape.deck_height,
        shape.length - 0.3 * shape.deck_length: shape.deck_height - 0.02,
        shape.length: shape.tail_share * shape.deck_height,
    }
    return PchipInterpolator(list(heights), list(heights.values()))(u)


def _floors(shape: CarShape, u: _Stations) -> _Stations:
    """Heights of the lower edge of the body: arched over the wheels [m]."""
    reach = shape.wheel_radius + ARCH_GAP
    to_end = np.minimum(u, shape.length - u)
    floor = shape.clearance + 0.14 * np.maximum(0.0, 1.0 - to_end / 0.35) ** 2
    for axle in (shape.front_overhang + shape.wheelbase, shape.front_overhang):
        inside = np.maximum(reach**2 - (u - axle) ** 2, 0.0)
        floor = np.where(np.abs(u - axle) <= reach, shape.wheel_radius + np.sqrt(inside), floor)
    return floor


def _half_widths(shape: CarShape, u: _Stations) -> _Stations:
    """Half the width of the body: rounded corners, and a slight barrel [m]."""
    power, tip = 2.8, shape.tip_share
    to_end = np.minimum(u, shape.length - u)
    rounding = (1.0 - np.maximum(0.0, 1.0 - to_end / shape.corner_length) ** power) ** (1.0 / power)
    barrel = 1.0 - 0.04 * (2.0 * u / shape.length - 1.0) ** 2
    return 0.5 * shape.width * barrel * (tip + (1.0 - tip) * rounding)


def _sections(shape: CarShape, u: _Stations) -> Float64[np.ndarray, "k n 3"]:
    """Cut the body: closed rings, counter-clockwise seen from the front; x is left at 0."""
    width, floor, top = _half_widths(shape, u), _floors(shape, u), _tops(shape, u)
    shoulder = np.minimum(shape.belt_height, top - 0.05)
    rise = top - shoulder
    eaves = 0.93 * width - 0.9 * rise * np.tan(np.deg2rad(shape.tumblehome_deg))
    zero = np.zeros_like(u)
    half = [
        (zero, floor), (0.86 * width, floor), (0.96 * width, floor + 0.08 * (shoulder - floor)),
        (width, floor + 0.45 * (shoulder - floor)), (0.99 * width, floor + 0.75 * (shoulder - floor)),
        (0.955 * width, shoulder), (0.93 * width, shoulder + 0.02 * rise), (eaves, shoulder + 0.86 * rise),
        (0.86 * eaves, shoulder + 0.96 * rise), (zero, top),
    ]  # fmt: skip
    if shape.window_top < 1.0:
        (y_low, z_low), (y_high, z_high) = half[SIDE_ROW : SIDE_ROW + 2]
        share = shape.window_top
        half.insert(SIDE_ROW + 1, (y_low + share * (y_high - y_low), z_low + share * (z_high - z_low)))
    for start, end in _bed(shape):
        inside = (start <= u) & (u <= end)
        bed = top - shape.bed_depth
        for row, (y, z) in enumerate([(0.93, top), (0.87, top), (0.86, bed), (0.0, bed)], start=len(half) - 4):
            half[row] = (np.where(inside, y * width, half[row][0]), np.where(inside, z, half[row][1]))
    outline = np.stack([np.stack(point, axis=-1) for point in half], axis=1)
    ring = np.concatenate([outline, outline[:, -2:0:-1] * [-1.0, 1.0]], axis=1)
    return np.concatenate([np.zeros((*ring.shape[:2], 1)), ring], axis=-1)


def _windows(shape: CarShape) -> list[tuple[Float64[np.ndarray, "2"], bool]]:
    """List the windows: from where to where behind the nose [m], and whether each is one of the sides'."""
    cowl, roof = shape.hood_length, shape.hood_length + shape.windscreen_run
    tail = shape.length - shape.deck_length
    roof_end = tail - shape.backlight_run
    pillar = roof + shape.pillar_share * shape.roof_length if shape.has_rear_windows else roof + 0.75
    windows = [
        (np.array([cowl + 0.04, roof - 0.05]), False),
        (np.array([cowl + 0.40 * shape.windscreen_run, pillar - 0.05]), True),
    ]
    if shape.has_back_window:
        edges = np.array([roof_end + 0.06 * shape.backlight_run, tail - 0.10 * shape.backlight_run])
        windows.append((edges, False))
    if shape.has_rear_windows:
        end = roof_end + 0.20 * shape.backlight_run
        posts = [pillar + 0.62 * (end - pillar)] if shape.has_third_window else []
        starts, ends = [pillar, *posts], [*(post - 0.05 for post in posts), end]
        windows += [(np.array([a + 0.05, b]), True) for a, b in zip(starts, ends, strict=True)]
    return windows


def _material(shape: CarShape, u_middle: _Stations, n_ring: int, paint: Material) -> Int64[np.ndarray, "k n"]:
    """Paint the body's quads, and glaze those that are windows; one row a band between two sections."""
    material = np.full((len(u_middle), n_ring), int(paint))
    for (start, end), is_side in _windows(shape):
        row = SIDE_ROW if is_side else n_ring // 2 - 1
        glazed: Bool[np.ndarray, " k"] = (start < u_middle) & (u_middle < end)
        # The ring runs up one side and down the other: quad j of the left is n_ring - 1 - j of the right.
        material[glazed, row] = Material.GLASS
        material[glazed, n_ring - 1 - row] = Material.GLASS
    return material
