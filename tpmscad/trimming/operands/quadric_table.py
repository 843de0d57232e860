"""Signed distance functions of planes, quadrics and free-form surfaces, stored as rows of one table and evaluated in batches.

A surface expressed in the local frame of a patch is a row again. The row is normalised, so that congruent pairs of patch and
surface have equal rows: the point of a cylinder is the point of its axis nearest to the frame's origin, that of a cone is its
apex, and the axis of a cone points to its open end. The axes of cylinders, spheres and tori have a positive leading coordinate.

A free-form surface, and the normals along an edge of any shape, stay as they are: their rows hold a number and a *place*, the
motion from the row's frame to the surface's. The distance is that of the nearest foot, which jumps where two feet are equally
near. Where the foot is *forced* to the border of the surface, the row is a tangent plane and no distance (`foot_points`).

The composition g(S(u, v)) of the distance g from one surface with one patch S is a scalar function on the patch's parameter
domain. For a plane it is a B-spline with the patch's knots; otherwise `ComposedDistance` evaluates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.carriers import Carrier, ConicalSurface, CylindricalSurface, Plane, SphericalSurface, ToroidalSurface
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.errors import TrimmingError
from tpmscad.memory_limit import require_memory
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.edge_normals import EdgeNormals

PLANE, CYLINDER, CONE, SPHERE, TORUS, FREE_FORM, EDGE_NORMALS = range(7)

BYTES_PER_DISTANCE = 32
"""Memory taken at the peak for the distance of a point from a surface, with what is compared with it."""

MIN_DIVISOR_LENGTH = 1e-150
"""Lower bound of lengths used as divisors, in model units: directions are arbitrary but finite on an axis."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedForms:
    """The rows of a table that are free-form: of n rows, the number (n,) in `forms`, -1 for quadrics, and the place (n,)."""

    forms: tuple[FreeFormSurface | EdgeNormals, ...]
    number: IntArray
    place: Motion

    def take(self, rows: IntArray) -> PlacedForms | None:
        """The rows named, None if they are quadrics all of them."""
        number = self.number[rows]
        return PlacedForms(self.forms, number, self.place[rows]) if (number >= 0).any() else None

    def in_frames(self, motion: Motion) -> PlacedForms:
        """Row i expressed in the local frame whose points x lie at motion[i](x)."""
        return PlacedForms(self.forms, self.number, self.place @ motion)

    def jet(self, row: IntArray, points: Array, order: int) -> tuple[list[Array], BoolArray]:
        """The jets of the rows `row` (k,) at points (k, m, 3), and the marks (k, m) of forced feet."""
        k, m = points.shape[:2]
        found = [np.zeros((k, m, *(3,) * i)) for i in range(order + 1)]
        forced = np.zeros((k, m), bool)
        for number in np.unique(self.number[row]).tolist():
            at, form = np.flatnonzero(self.number[row] == number), self.forms[number]
            place = self.place[row[at]]
            local = place[:, None].apply(points[at]).reshape(-1, 3)
            if not np.isfinite(local).all():
                raise TrimmingError("an intersection with a free-form face of the body does not converge")
            if isinstance(form, EdgeNormals):
                jet = form.jet(local, order)
            else:
                feet = form.foot_points(local, max(order, 1))
                jet = [feet.distance, feet.gradient, feet.hessian][: order + 1]
                forced[at] = feet.forced.reshape(len(at), m)
            rotation = place.rotation
            found[0][at] = jet[0].reshape(len(at), m)
            if order:
                found[1][at] = jet[1].reshape(len(at), m, 3) @ rotation
            if order > 1:
                hessian = jet[2].reshape(len(at), m, 3, 3)
                found[2][at] = np.swapaxes(rotation, 1, 2)[:, None] @ hessian @ rotation[:, None]
        return found, forced

    def are_near(self, row: int, points: Array, reach: Array) -> BoolArray:
        """Balls (m,) of radii `reach` about points (m, 3) that meet the box of the surface, or of the edge, of row `row`."""
        form = self.forms[int(self.number[row])]
        low, high = form.box() if isinstance(form, EdgeNormals) else _bound_surface(form)
        local = self.place[row].apply(points)
        gap = np.maximum(np.maximum(low - local, local - high), 0.0)
        return np.asarray(np.einsum("nk,nk->n", gap, gap) <= reach**2)

    def distances(self, row: int, points: Array) -> Array:
        """Signed distances (m,) of points (m, 3) from row `row`: with forced feet, too, those of the feet."""
        form, local = self.forms[int(self.number[row])], self.place[row].apply(points)
        if isinstance(form, EdgeNormals):
            return form.jet(local, 0)[0]
        feet = form.foot_points(local, 1)
        value = feet.distance.copy()
        far = np.flatnonzero(feet.forced)
        apart = np.linalg.norm(local[far] - form(*feet.parameters[far].T), axis=1)
        value[far] = np.copysign(np.maximum(apart, np.abs(value[far])), value[far])
        return value


@dataclass(frozen=True, slots=True, eq=False)
class QuadricTable:
    """n implicit surfaces: kind (n,), point and axis (n, 3), parameter_a and parameter_b (n,).

    ========  ==================  ====================  ======================
    kind      point               parameter_a           parameter_b
    ========  ==================  ====================  ======================
    plane     unused              offset: axis . x + a  unused
    cylinder  on the axis         radius                unused
    cone      apex                half opening angle    unused
    sphere    centre              radius                unused
    torus     centre              radius of the circle  radius of the tube
    ========  ==================  ====================  ======================

    The axis of a plane is its normal; the axis of a sphere is zero. Free-form rows have zeros in all these columns and their
    surfaces in `placed`, which is None if there are none.
    """

    kind: IntArray
    point: Array
    axis: Array
    parameter_a: Array
    parameter_b: Array
    placed: PlacedForms | None = None

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def is_plane(self) -> BoolArray:
        """Rows that are planes: (n,)."""
        return self.kind == PLANE

    @property
    def is_free_form(self) -> BoolArray:
        """Rows whose distance is that of a foot point and may jump: (n,)."""
        return self.kind == FREE_FORM

    @property
    def placed_rows(self) -> BoolArray:
        """Rows that `placed` holds, free-form surfaces and normals along edges: (n,)."""
        return self.kind >= FREE_FORM

    @staticmethod
    def concatenate(tables: Sequence[QuadricTable]) -> QuadricTable:
        """The rows of tables, one after the other."""
        joined = QuadricTable(
            np.concatenate([t.kind for t in tables]),
            np.concatenate([t.point for t in tables]),
            np.concatenate([t.axis for t in tables]),
            np.concatenate([t.parameter_a for t in tables]),
            np.concatenate([t.parameter_b for t in tables]),
        )
        if all(t.placed is None for t in tables):
            return joined
        forms: list[FreeFormSurface | EdgeNormals] = []
        numbers, places = [], []
        for t in tables:
            own = t.placed or PlacedForms((), np.full(len(t), -1), Motion.identity(len(t)))
            numbers.append(np.where(own.number >= 0, own.number + len(forms), -1))
            places.append(own.place)
            forms += own.forms
        return replace(joined, placed=PlacedForms(tuple(forms), np.concatenate(numbers), Motion.concatenate(places)))

    def take(self, rows: IntArray) -> QuadricTable:
        """The surfaces of the given rows."""
        return QuadricTable(
            self.kind[rows],
            self.point[rows],
            self.axis[rows],
            self.parameter_a[rows],
            self.parameter_b[rows],
            None if self.placed is None else self.placed.take(rows),
        )

    def row(self, k: int) -> QuadricTable:
        """A table that holds surface k only."""
        return self.take(np.array([k]))

    def in_frames(self, motion: Motion) -> QuadricTable:
        """Row i expressed in the local frame whose points x lie at motion[i](x)."""
        axis = motion.apply_inverse_to_vectors(self.axis)
        point = motion.apply_inverse(self.point)
        is_plane, centred = self.kind == PLANE, (self.kind == SPHERE) | (self.kind == TORUS)
        offset = np.where(
            is_plane, self.parameter_a + np.einsum("ni,ni->n", self.axis, motion.translation), self.parameter_a
        )
        is_cylinder = self.kind == CYLINDER
        point = np.where(is_cylinder[:, None], point - np.einsum("ni,ni->n", point, axis)[:, None] * axis, point)
        point = np.where(is_plane[:, None], 0.0, point)
        flip = (is_cylinder | centred) & (_leading_coordinate(axis) < 0)
        placed = None if self.placed is None else self.placed.in_frames(motion)
        return QuadricTable(self.kind, point, np.where(flip[:, None], -axis, axis), offset, self.parameter_b, placed)

    def leading_coordinate(self) -> Array:
        """The first coordinate of each axis that is not zero to 9 decimals: (n,)."""
        return _leading_coordinate(self.axis)

    def flip_planes(self, sign: IntArray) -> QuadricTable:
        """The surfaces with the orientation of planes reversed where sign is -1."""
        offset = np.where(self.is_plane, self.parameter_a * sign, self.parameter_a)
        return replace(self, axis=self.axis * sign[:, None], parameter_a=offset)

    def congruence_key(self, size: float) -> Array:
        """Rows that are equal for equal surfaces, to 1e-9 in direction and 1e-10 of `size` in position."""
        scaled = np.where(self.is_plane, self.parameter_a / size, self.parameter_a)
        position = np.round(np.column_stack([scaled, self.point / size]), 10)
        columns = [self.kind, np.round(self.axis, 9), position, np.round(self.parameter_b, 10)]
        if self.placed is not None:
            is_form, place = self.placed.number >= 0, self.placed.place
            of_place = np.column_stack(
                [np.round(place.rotation.reshape(-1, 9), 9), np.round(place.translation / size, 10)]
            )
            columns += [self.placed.number, np.where(is_form[:, None], of_place, 0.0)]
        return np.column_stack(columns) + 0.0

    def value(self, points: Array) -> Array:
        """Signed distances (n, m) of points (n, m, 3), row by row."""
        return self.jet(points, 0)[0]

    def distances(self, points: Array, reach: Array | float = np.inf, wanted: BoolArray | None = None) -> Array:
        """Signed distances of points (m, 3) from all surfaces: (m, n).

        Those from free-form rows cost a foot point each. They are infinite for points whose ball of radius `reach`, (m,) or a
        number, misses the box of the surface, and where `wanted` (m, n) is False. The distance from the normals along an edge is
        used next to the edge only, whose box it is then.
        """
        require_memory(
            float(len(points)) * len(self),
            BYTES_PER_DISTANCE,
            f"{len(points)} points and {len(self)} faces",
            "use larger cells",
        )
        result = np.empty((len(points), len(self)))
        radius = np.broadcast_to(np.asarray(reach, float), len(points))
        for k in range(len(self)):
            if self.placed is not None and self.placed.number[k] >= 0:
                near = self.placed.are_near(k, points, radius)
                near &= True if wanted is None else wanted[:, k]
                result[:, k] = np.inf
                result[near, k] = self.placed.distances(k, points[near])
            else:
                result[:, k] = self.row(k).value(points[None])[0]
        return result

    def jet(self, points: Array, order: int) -> list[Array]:
        """Distance (n, m), gradient (n, m, 3) and Hessian (n, m, 3, 3) at points (n, m, 3), up to `order`."""
        return self.marked_jet(points, order)[0]

    def marked_jet(self, points: Array, order: int) -> tuple[list[Array], BoolArray]:
        """The jet, and the marks (n, m) of points whose foot on a free-form surface is forced to its border."""
        n, m = points.shape[:2]
        result = [np.zeros((n, m, *(3,) * k)) for k in range(order + 1)]
        forced = np.zeros((n, m), bool)
        for kind in np.unique(self.kind):
            rows = np.flatnonzero(self.kind == kind)
            everything = len(rows) == n
            if kind >= FREE_FORM:
                assert self.placed is not None
                found, marks = self.placed.jet(rows, points if everything else points[rows], order)
                forced[rows] = marks
                for total, part in zip(result, found, strict=True):
                    total[rows] = part
                continue
            own = self if everything else self.take(rows)
            found = own._jet_of_kind(int(kind), points if everything else points[rows], order)
            for total, part in zip(result, found, strict=True):
                total[rows] = part
        return result, forced

    def _jet_of_kind(self, kind: int, points: Array, order: int) -> list[Array]:
        """`jet` of rows that are all of one kind."""
        axis, a, b = self.axis[:, None], self.parameter_a[:, None], self.parameter_b[:, None]
        if kind == PLANE:
            found = [np.einsum("nmk,nk->nm", points, self.axis) + a]
            if order:
                found.append(np.broadcast_to(axis, points.shape))
            if order > 1:
                found.append(np.zeros((*points.shape, 3)))
            return found
        arm = points - self.point[:, None]
        z = np.einsum("nmk,nk->nm", arm, self.axis)
        across = arm - z[..., None] * axis  # the axis of a sphere is zero: its whole arm is radial
        r = np.maximum(np.sqrt(np.einsum("nmk,nmk->nm", across, across)), MIN_DIVISOR_LENGTH)
        around = None
        if kind in (CYLINDER, SPHERE):
            value, by_r, by_z = r - a, np.ones_like(r), np.zeros_like(r)
        elif kind == CONE:
            value = r * np.cos(a) - z * np.sin(a)
            by_r, by_z = np.broadcast_to(np.cos(a), r.shape), np.broadcast_to(-np.sin(a), r.shape)
        else:
            around = np.maximum(np.hypot(r - a, z), MIN_DIVISOR_LENGTH)
            value, by_r, by_z = around - b, (r - a) / around, z / around
        found = [value]
        if order:
            e = across / r[..., None]
            found.append(by_r[..., None] * e + by_z[..., None] * axis)
        if order > 1:
            base = np.eye(3) - axis[..., :, None] * axis[..., None, :] - e[..., :, None] * e[..., None, :]
            second = (by_r / r)[..., None, None] * base
            if around is not None:
                along = by_z[..., None] * e - by_r[..., None] * axis
                second = second + along[..., :, None] * along[..., None, :] / around[..., None, None]
            found.append(second)
        return found


def _bound_surface(form: FreeFormSurface) -> tuple[Array, Array]:
    """Low and high corner of a box that contains a surface and its continuation."""
    poles = form.spline.poles.reshape(-1, 3)
    beyond = 2.0 * form.continuation  # it goes on along both parameters at its corners
    return poles.min(axis=0) - beyond, poles.max(axis=0) + beyond


def _leading_coordinate(axis: Array) -> Array:
    rounded = np.round(axis, 9) + 0.0
    return rounded[np.arange(len(axis)), (rounded != 0).argmax(axis=1)]


def group_rows(key: Array) -> tuple[IntArray, IntArray]:
    """Congruence classes of equal rows of `key` (n, d): the first member of each class (c,), the class of each row (n,)."""
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return first, label.ravel()


def build_implicit_surfaces(carriers: Sequence[Carrier | FreeFormSurface]) -> QuadricTable:
    """The implicit surfaces of carriers, with the sign of the carriers' `distance`; faces on one object are one surface."""
    kind, point, axis, a, b = (np.array(column) for column in zip(*(_read_carrier(c) for c in carriers), strict=True))
    table = QuadricTable(kind, point, axis, a, b)
    if not table.is_free_form.any():
        return table
    forms = list({id(c): c for c in carriers if isinstance(c, FreeFormSurface)}.values())
    index = {id(form): i for i, form in enumerate(forms)}
    number = np.array([index.get(id(c), -1) for c in carriers])
    return replace(table, placed=PlacedForms(tuple(forms), number, Motion.identity(len(carriers))))


def build_edge_normal_row(form: EdgeNormals) -> QuadricTable:
    """A table of one row, the normals along an edge."""
    zero = np.zeros((1, 3))
    placed = PlacedForms((form,), np.zeros(1, np.int64), Motion.identity(1))
    return QuadricTable(np.array([EDGE_NORMALS]), zero, zero, np.zeros(1), np.zeros(1), placed)


def _read_carrier(carrier: Carrier | FreeFormSurface) -> tuple[int, Array, Array, float, float]:
    zero = np.zeros(3)
    if isinstance(carrier, FreeFormSurface):
        return FREE_FORM, zero, zero, 0.0, 0.0
    if isinstance(carrier, Plane):
        return PLANE, zero, carrier.normal, -float(carrier.normal @ carrier.origin), 0.0
    if isinstance(carrier, CylindricalSurface):
        return CYLINDER, carrier.origin, carrier.axis, carrier.radius, 0.0
    if isinstance(carrier, ConicalSurface):
        up = 1.0 if carrier.angle > 0 else -1.0
        apex = carrier.origin - carrier.radius / np.tan(carrier.angle) * carrier.axis
        return CONE, apex, up * carrier.axis, abs(carrier.angle), 0.0
    if isinstance(carrier, SphericalSurface):
        return SPHERE, carrier.origin, zero, carrier.radius, 0.0
    if isinstance(carrier, ToroidalSurface):
        return TORUS, carrier.origin, carrier.axis, carrier.major, carrier.minor
    raise TrimmingError(f"a face of the body lies on a {type(carrier).__name__}, not on a plane or a quadric")


@dataclass(frozen=True, slots=True, eq=False)
class ComposedDistance:
    """The scalar function g(S(u, v)) of a patch S and the distance g from one implicit surface (a table of one row)."""

    surface: BSplineSurface
    implicit: QuadricTable

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The parameter domain of the patch."""
        return self.surface.domain

    def patch_grid(self, u: Array, v: Array, du: int = 0, dv: int = 0) -> Array:
        """Points of the patch or their derivatives on the grid of all u with all v: (len(u), len(v), 3)."""
        return _evaluate_cached_grid(self.surface, u.tobytes(), v.tobytes(), du, dv)

    def grid(self, u: Array, v: Array, du: int = 0, dv: int = 0) -> Array:
        """Values or first derivatives on the grid of all u with all v: (len(u), len(v), 1)."""
        points = self.patch_grid(u, v)
        found = self.implicit.jet(points.reshape(1, -1, 3), du + dv)
        if du + dv == 0:
            return found[0].reshape((*points.shape[:-1], 1))
        along = self.patch_grid(u, v, du, dv)
        return np.einsum("nk,nk->n", found[1][0], along.reshape(-1, 3)).reshape((*points.shape[:-1], 1))


@lru_cache(maxsize=64)
def _evaluate_cached_grid(surface: BSplineSurface, u: bytes, v: bytes, du: int, dv: int) -> Array:
    """A patch's points or derivatives on a grid, cached: most surfaces that meet the patch need the same grid."""
    return surface.grid(np.frombuffer(u), np.frombuffer(v), du, dv)


def compose_with_patch(surface: BSplineSurface, implicit: QuadricTable) -> BSplineSurface | ComposedDistance:
    """The distance from one implicit surface (a table of one row) as a scalar function on the patch."""
    if not implicit.is_plane[0]:
        return ComposedDistance(surface, implicit)
    poles = surface.poles @ implicit.axis[0] + implicit.parameter_a[0]
    return BSplineSurface(poles[..., None], surface.knots_u, surface.knots_v, surface.degree_u, surface.degree_v)


def evaluate_second_jet(distance: BSplineSurface | ComposedDistance, at: Array) -> tuple[float, Array, Array]:
    """Value, gradient (2,) and Hessian (2, 2) of a scalar function on a patch at one point (u, v)."""
    surface = distance if isinstance(distance, BSplineSurface) else distance.surface
    bu = [b[0] for b in design_matrices(surface.knots_u, surface.degree_u, at[:1], (0, 1, 2))]
    bv = [b[0] for b in design_matrices(surface.knots_v, surface.degree_v, at[1:], (0, 1, 2))]
    half = np.tensordot(np.stack(bu), surface.poles, 1)  # (3, V, D)
    s = np.einsum("kv,ivd->ikd", np.stack(bv), half)  # derivative (i, k)
    if isinstance(distance, BSplineSurface):
        s = s[..., 0]
        return float(s[0, 0]), np.array([s[1, 0], s[0, 1]]), np.array([[s[2, 0], s[1, 1]], [s[1, 1], s[0, 2]]])
    value, gradient, hessian = (j[0, 0] for j in distance.implicit.jet(s[0, 0][None, None], 2))
    first = np.stack([s[1, 0], s[0, 1]])
    second = np.array([[s[2, 0], s[1, 1]], [s[1, 1], s[0, 2]]]) @ gradient + first @ hessian @ first.T
    return float(value), first @ gradient, second
