"""Points, surfaces and curves of a boundary representation as Part 21 entities; equal placed items are written once.

Coordinates are rounded relative to the model's extent (COORDINATE_DIGITS), so that points which agree to round-off become one
CARTESIAN_POINT.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import (
    Carrier,
    Circle,
    ConicalSurface,
    CylindricalSurface,
    EdgeCurve,
    Plane,
    Quadric,
    ToroidalSurface,
)
from tpmscad.kernel.step.part21 import DataSection, format_real, format_reals
from tpmscad.kernel.step.point_text import MAX_DECIMALS, format_points
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment

COORDINATE_DIGITS = 12
"""Digits kept after the leading digit of the largest coordinate: ten thousand times the round-off of float64, so that shared
poles of neighbouring patches become one point, a hundred-thousandth of the kernel's tolerance at a size of a metre."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedGeometry:
    """Distinct placed primitives: primitive (n,) and motion, and the index of the one used by each face or edge."""

    primitive: IntArray
    motion: Motion
    index: IntArray

    @classmethod
    def distinct(cls, primitive: IntArray, motion: Motion) -> PlacedGeometry:
        """The distinct pairs of primitive and motion, numbered in order of appearance."""
        rows = np.column_stack([primitive, motion.rotation.reshape(-1, 9), motion.translation])
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        at, index = _number_by_appearance(first, index)
        return cls(primitive[at], motion[at], index)

    def points(self, local: list[Array]) -> list[Array]:
        """Placed points (n, 3) of each item, given the points of the primitives."""
        placed: list[Array] = [np.zeros((0, 3))] * len(self.primitive)
        for p in np.unique(self.primitive).tolist():
            at = np.flatnonzero(self.primitive == p)
            moved = self.motion[at, None].apply(local[p])
            for i, points in zip(at.tolist(), moved, strict=True):
                placed[i] = points
        return placed


def poles_of(value: Carrier | EdgeCurve) -> Array:
    """Poles of a spline (n, 3); none for surfaces and curves that STEP stores without points, straight segments included."""
    if isinstance(value, BSplineSurface):
        return value.poles.reshape(-1, 3)
    return value.poles if isinstance(value, BSplineCurve) and not is_segment(value) else np.zeros((0, 3))


def write_points(section: DataSection, points: Array) -> IntArray:
    """Write the distinct points and return the entity number of each point."""
    grid, decimals = round_coordinates(points)
    first, index = _unique_rows(grid)
    numbers = section.extend_text(format_points(grid[first], decimals, section.count + 1), len(first))
    return numbers.start + index


def count_decimals(largest: float) -> int:
    """Decimals of the coordinates of a file, by the size of the largest."""
    return min(max(COORDINATE_DIGITS - int(np.floor(np.log10(largest))), 0), MAX_DECIMALS)


def round_coordinates(points: Array) -> tuple[IntArray, int]:
    """The coordinates that a file states: multiples (n, 3) of 10^-decimals, and the decimals."""
    decimals = count_decimals(float(np.abs(points).max(initial=1e-9)))
    return np.rint(points * 10.0**decimals).astype(np.int64), decimals


def _unique_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """First member of each class of equal rows, in order of appearance, and the class of each row."""
    # Sorting one mixed 64-bit key is ten times faster than sorting rows; colliding keys are detected.
    mixed = rows[:, 0] * 0x9E3779B97F4A7C1 + rows[:, 1] * 0x1B873593CC9E2D5 + rows[:, 2] * 0x27D4EB2F165667C5
    _, first, index = np.unique(mixed, return_index=True, return_inverse=True)
    if not np.array_equal(rows[first][index.ravel()], rows):
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return _number_by_appearance(first, index)


def _number_by_appearance(first: IntArray, index: IntArray) -> tuple[IntArray, IntArray]:
    """First members and classes, as `np.unique` gives them, with the classes numbered as they come."""
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[index.ravel()]


def _format_knots(*vectors: Array) -> str:
    """Multiplicities of every vector, then the distinct knots of every vector."""
    found = [np.unique(v, return_counts=True) for v in vectors]
    counts = [f"({','.join(map(str, c.tolist()))})" for _, c in found]
    values = [f"({','.join(format_reals(v.tolist()))})" for v, _ in found]
    return ",".join([*counts, *values])


SMALL_SPEED = 2.0**-4
"""Millimetres per unit of parameter below which the knots of a surface are scaled in the file. OCCT's reader stops its Newton
iteration where |S_u x S_v| < 1e-5 mm2, so that edges on surfaces of .003 mm get pcurves 1 % off their place."""


def find_knots_in_file(surface: BSplineSurface) -> tuple[Array, Array]:
    """Knots of a surface in a file: those of a small one times a power of two, so that speeds in it are about 1 mm per unit.

    Poles and points are the same, and so is every bit of the knots but their exponent.
    """
    scale = find_knot_scale(surface.poles, float(np.ptp(surface.knots_u)), float(np.ptp(surface.knots_v)))
    return surface.knots_u * scale, surface.knots_v * scale


def find_knot_scale(poles: Array, width_u: float, width_v: float) -> float:
    """The power of two for the knots of a spline with poles (k, l, 3) over a domain of these widths.

    It is 1 unless the surface is small. Lengths are those of the net: the ends of one that is closed nearly meet.
    """
    lengths = [np.linalg.norm(np.diff(poles, axis=axis), axis=2).sum(axis=axis).mean() for axis in (0, 1)]
    speed = np.sqrt(lengths[0] * lengths[1] / (width_u * width_v))
    return float(2.0 ** np.round(np.log2(speed))) if 0.0 < speed < SMALL_SPEED else 1.0


def write_surfaces(section: DataSection, brep: Brep, placed: PlacedGeometry, numbers: list[IntArray]) -> IntArray:
    """Write the placed carriers and return their entity numbers; `numbers` are those of their placed poles."""
    forms = [_form_of_surface(carrier) if isinstance(carrier, BSplineSurface) else "" for carrier in brep.carriers]
    bodies = []
    for i, p in enumerate(placed.primitive.tolist()):
        carrier = brep.carriers[p]
        if isinstance(carrier, BSplineSurface):
            bodies.append(forms[p] % tuple(numbers[i].tolist()))
        else:
            bodies.append(_elementary_surface(section, carrier, placed.motion[i]))
    return np.array(section.extend(bodies))


def _form_of_surface(surface: BSplineSurface) -> str:
    """Text of a B-spline surface with a place for the number of each pole."""
    rows, columns, _ = surface.poles.shape
    net = ",".join(["(" + ",".join(["#%d"] * columns) + ")"] * rows)
    return (
        f"B_SPLINE_SURFACE_WITH_KNOTS('',{surface.degree_u},{surface.degree_v},({net}),.UNSPECIFIED.,.F.,.F.,.F.,"
        f"{_format_knots(*find_knots_in_file(surface))},.UNSPECIFIED.)"
    )


def _elementary_surface(section: DataSection, carrier: Plane | Quadric, motion: Motion) -> str:
    """Text of a plane, whose normal is x axis times y axis, or of a quadric.

    Frames in STEP are right-handed, so that S_u x S_v of a quadric points away from its axis, mirrored or not.
    """
    origin, x = motion.apply(carrier.origin), motion.apply_to_vectors(carrier.x_axis)
    if isinstance(carrier, Plane):
        return format_placed(section, "PLANE", origin, np.cross(x, motion.apply_to_vectors(carrier.y_axis)), x)
    axis = motion.apply_to_vectors(carrier.axis)
    if isinstance(carrier, ConicalSurface):  # a STEP cone opens along its axis
        axis = axis if carrier.angle > 0 else -axis
        return format_placed(section, "CONICAL_SURFACE", origin, axis, x, carrier.radius, abs(carrier.angle))
    if isinstance(carrier, ToroidalSurface):
        return format_placed(section, "TOROIDAL_SURFACE", origin, axis, x, carrier.major, carrier.minor)
    keyword = "CYLINDRICAL_SURFACE" if isinstance(carrier, CylindricalSurface) else "SPHERICAL_SURFACE"
    return format_placed(section, keyword, origin, axis, x, carrier.radius)


def write_curves(section: DataSection, brep: Brep, placed: PlacedGeometry, numbers: list[IntArray]) -> IntArray:
    """Write the placed curves and return their entity numbers.

    Straight segments get 0; each edge writes its own line from its vertices.
    """
    forms = [_form_of_curve(curve) if isinstance(curve, BSplineCurve) else "" for curve in brep.curves]
    straight = [is_segment(curve) for curve in brep.curves]
    frames = np.zeros((len(placed.primitive), 3, 3))
    for p in np.unique(placed.primitive).tolist():
        curve = brep.curves[p]
        if not isinstance(curve, BSplineCurve):
            own = np.flatnonzero(placed.primitive == p)
            frames[own] = curve.place_frames(placed.motion[own])
    bent, bodies = [], []
    for i, p in enumerate(placed.primitive.tolist()):
        curve = brep.curves[p]
        if straight[p]:
            continue
        bent.append(i)
        if isinstance(curve, BSplineCurve):
            bodies.append(forms[p] % tuple(numbers[i].tolist()))
        else:
            radii = (curve.radius,) if isinstance(curve, Circle) else (curve.major, curve.minor)
            kind = "CIRCLE" if isinstance(curve, Circle) else "ELLIPSE"
            bodies.append(format_placed(section, kind, *frames[i], *radii))
    result = np.zeros(len(placed.primitive), np.int64)
    result[bent] = section.extend(bodies)
    return result


def _form_of_curve(curve: BSplineCurve) -> str:
    """Text of a B-spline curve with a place for the number of each pole."""
    poles = ",".join(["#%d"] * len(curve.poles))
    knots = _format_knots(curve.knots)
    return f"B_SPLINE_CURVE_WITH_KNOTS('',{curve.degree},({poles}),.UNSPECIFIED.,.F.,.F.,{knots},.UNSPECIFIED.)"


def write_directions(section: DataSection, vectors: Array) -> range:
    """Write the vectors as DIRECTIONs and return their numbers."""
    values = format_reals(vectors.ravel().tolist())
    return section.extend(
        [f"DIRECTION('',({x},{y},{z}))" for x, y, z in zip(values[0::3], values[1::3], values[2::3], strict=True)]
    )


def write_point(section: DataSection, point: Array) -> int:
    """Write a single CARTESIAN_POINT with all its digits and return its number."""
    x, y, z = format_reals(point.tolist())
    return section.add(f"CARTESIAN_POINT('',({x},{y},{z}))")


def write_placement(section: DataSection, origin: Array, axis: Array, reference: Array) -> int:
    """Write an AXIS2_PLACEMENT_3D with z along `axis` and x along `reference`, and return its number."""
    at = write_point(section, origin)
    normal, along = write_directions(section, np.stack([axis, reference]))
    return section.add(f"AXIS2_PLACEMENT_3D('',#{at},#{normal},#{along})")


def format_placed(
    section: DataSection, keyword: str, origin: Array, axis: Array, reference: Array, *sizes: float
) -> str:
    """Text of a plane, quadric or conic with its sizes; its placement, as for `write_placement`, is written first."""
    at = write_placement(section, origin, axis, reference)
    return f"{keyword}('',{','.join([f'#{at}', *map(format_real, sizes)])})"
