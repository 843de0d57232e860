"""The image of a lattice's box as a body of revolution: what the box becomes on a cylinder, and on a sphere along its equator.

Nothing is assumed about the map. It turns the box about an axis if translations along one lattice axis become rotations about a
line (found from sample points, by Kabsch). The opposite sides of the box then sweep the profile that the other two axes draw at
the beginning of the lattice. If the sides of the profile are straight or circular, planes, cylinders, cones, spheres and tori
bound the image, and the lattice can be trimmed by them.

A dome has no such axis, but it turns with the lattice about the middle line of its box: there the image of the *cylinder
inscribed in the box* is a body of revolution, and the lattice ends in a round rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.rigid_motion import match_points

REVOLUTION_TOL_FRACTION = 1e-10
"""A map turns the box if the images agree with rotations to this fraction of the box."""

ROUND_OFF = 1e-13
"""Components of the axis below this are zero, so that planes square to it are square to the last digit."""

SAMPLE_POINTS = 40
"""Points of the box that are compared with their rotations."""

SIDE_SAMPLES = 17
"""Points along each side of the profile."""

LEAST_TURNS_FRACTION = 1 / 64
"""Part of the lattice over which the rotation is read off: up to 32 turns have no ambiguity."""


@dataclass(frozen=True, slots=True, eq=False)
class RevolvedBox:
    """A body of revolution about the line through `origin` (3,) along the unit vector `axis` (3,).

    `sides` (4, 3, 3): start, middle and end of the sides of the profile, in order, in one half-plane of the axis; `straight` (4,)
    tells segments from arcs of circles. The body sweeps `angle` (radians, positive) from there; 2 pi exactly if it is closed.
    `lattice_axis` is the axis of the lattice that goes round, None for a cylinder of radius `inscribed` about the middle line
    along z.
    """

    origin: Array
    axis: Array
    sides: Array
    straight: tuple[bool, ...]
    angle: float
    lattice_axis: int | None
    inscribed: float = 0.0

    @property
    def closed(self) -> bool:
        """Whether the body goes all round."""
        return self.angle == 2 * np.pi


def find_revolved_box(map: Map, size: Array) -> RevolvedBox | None:
    """The image of the box from the origin to `size` (3,) as a body of revolution, None if it is none.

    InvalidRequest if the map winds the box round its axis more than once.
    """
    for axis in range(3):
        found = _find_axis(map, size, axis)
        if found is None:
            continue
        origin, direction, angle = found
        if angle > 2 * np.pi * (1 + REVOLUTION_TOL_FRACTION):
            turns = angle / (2 * np.pi)
            raise InvalidRequest(
                f"{map.name} winds the lattice {turns:.9g} times round its axis, so that it overlaps itself: make it at most "
                f"{1 / turns:.9g} times as long along {'xyz'[axis]}, or the map larger"
            )
        full = abs(angle - 2 * np.pi) <= 2 * np.pi * REVOLUTION_TOL_FRACTION
        j, k = ((1, 2), (2, 0), (0, 1))[axis]
        corners = np.zeros((4, 3))
        corners[[1, 2], j], corners[[2, 3], k] = size[j], size[k]
        profile = _read_profile(map, corners, origin, direction, flat=not full)
        if profile is not None:
            return RevolvedBox(origin, direction, *profile, 2 * np.pi if full else angle, axis)
    return None


def find_revolved_cylinder(map: Map, size: Array) -> RevolvedBox | None:
    """The image of the cylinder along z that is inscribed in the box, if it is a body of revolution; else None."""
    radius = float(min(size[:2])) / 2
    unit = np.random.default_rng(0).random((SAMPLE_POINTS, 3))
    middle = np.array([size[0] / 2, size[1] / 2, 0.0])
    points = (unit - [0.5, 0.5, 0.0]) * [2 * radius / np.sqrt(2), 2 * radius / np.sqrt(2), size[2]]
    images = map(middle + points)
    tol = REVOLUTION_TOL_FRACTION * float(np.ptp(images, axis=0).max())
    line = map(middle + np.outer([0.0, 1.0], [0.0, 0.0, size[2]]))
    direction = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    direction[np.abs(direction) < ROUND_OFF] = 0.0
    for angle in (1.0, 2.5):
        turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        moved = map(middle + points @ turn.T)
        expected = line[0] + (images - line[0]) @ Rotation.from_rotvec(angle * direction).as_matrix().T
        if np.abs(moved - expected).max() > tol:
            return None
    corners = middle + np.array([[0, 0, 0], [radius, 0, 0], [radius, 0, size[2]], [0, 0, size[2]]])
    profile = _read_profile(map, corners, line[0], direction, flat=True)
    return None if profile is None else RevolvedBox(line[0], direction, *profile, 2 * np.pi, None, radius)


def _find_axis(map: Map, size: Array, axis: int) -> tuple[Array, Array, float] | None:
    """A point and the direction of the line about which the map turns translations along a lattice axis, and the whole angle."""
    unit = np.random.default_rng(0).random((SAMPLE_POINTS, 3))
    points = unit * size * np.where(np.arange(3) == axis, 0.5, 1.0)
    images = map(points)
    tol = REVOLUTION_TOL_FRACTION * float(np.ptp(images, axis=0).max())
    along = size * np.eye(3)[axis]

    def motion_after(fraction: float) -> tuple[Array, Array, float]:
        moved = map(points + fraction * along)
        motion = match_points(images[None], moved[None])[0]
        return motion.rotation, motion.translation, float(np.abs(motion.apply(images) - moved).max())

    rotation, translation, miss = motion_after(LEAST_TURNS_FRACTION)
    turn = Rotation.from_matrix(rotation).as_rotvec()
    if miss > tol or np.linalg.norm(turn) < REVOLUTION_TOL_FRACTION:
        return None
    # The direction is read off a quarter-turn or so, where it is exact to round-off.
    rate = float(np.linalg.norm(turn)) / LEAST_TURNS_FRACTION
    fraction = min(0.5, 0.5 * np.pi / rate)
    rotation, translation, miss = motion_after(fraction)
    turn = Rotation.from_matrix(rotation).as_rotvec()
    angle = float(np.linalg.norm(turn))
    direction = turn / angle
    origin = np.array(np.linalg.lstsq(np.eye(3) - rotation, translation, rcond=1e-6)[0], float)
    direction[np.abs(direction) < ROUND_OFF] = 0.0
    origin[np.abs(origin) < ROUND_OFF * np.abs(images).max()] = 0.0
    slides = abs(float(translation @ direction)) > tol
    check, shift, far_miss = motion_after(0.5)
    expected = Rotation.from_rotvec(0.5 * angle / fraction * direction).as_matrix()
    differs = (
        float(np.abs(check - expected).max()) > 10 * REVOLUTION_TOL_FRACTION or abs(float(shift @ direction)) > tol
    )
    return None if slides or differs or max(miss, far_miss) > tol else (origin, direction, angle / fraction)


def _read_profile(
    map: Map, corners: Array, origin: Array, direction: Array, *, flat: bool
) -> tuple[Array, tuple[bool, ...]] | None:
    """The sides (4, 3, 3) of the image of a rectangle (corners (4, 3)) in a half-plane of the axis, and which are straight.

    None if a side is neither straight nor circular, or if the image has to be `flat` and is not.
    """
    t = np.linspace(0.0, 1.0, SIDE_SAMPLES)[:, None]
    lines = np.stack([a + t * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    from_axis = map(lines) - origin
    height = from_axis @ direction
    across = from_axis - height[..., None] * direction
    radius = np.linalg.norm(across, axis=-1)
    tol = REVOLUTION_TOL_FRACTION * float(np.abs(from_axis).max())
    outward = across[1, 0] / radius[1, 0]
    if flat and np.abs(across - radius[..., None] * outward).max() > tol:
        return None
    meridian = np.stack([radius, height], axis=-1)
    straight = []
    for side in meridian:
        chord = side[-1] - side[0]
        bulge = (side - side[0]) @ np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        straight.append(bool(np.abs(bulge).max() <= tol))
        if not straight[-1] and not _is_circular(side, tol):
            return None
    points = meridian[:, [0, SIDE_SAMPLES // 2, -1]]
    return origin + points[..., :1] * outward + points[..., 1:] * direction, tuple(straight)


def _is_circular(points: Array, tol: float) -> bool:
    """Whether plane points (n, 2) lie on a circle."""
    rows = np.column_stack([2 * points, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(rows, (points**2).sum(axis=1), rcond=None)[0]
    centre, radius = np.array([x, y]), np.sqrt(rest + x**2 + y**2)
    return bool(np.abs(np.linalg.norm(points - centre, axis=1) - radius).max() <= 10 * tol)
