"""The primitive patches of a lattice: offset surfaces of the exact patch, fitted with as few poles as the tolerance allows.

The fit is the least-squares one among all that join their own copies over the four sides with curvature continuity, corners
where six patches meet included (TPMS2STEP asks parametric C2, eqs 10-13, which no regular patch has at such corners). A surface
at a negative distance is the one at the positive distance turned over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad import surfaces
from tpmscad.patches.deviation import Deviation, deviation, worst
from tpmscad.patches.mirror.pieces import fit_pieces
from tpmscad.patches.sheet import Sheet
from tpmscad.splines import bounds
from tpmscad.splines.adaptive import Fit, Space, adapt
from tpmscad.splines.axis import Axis
from tpmscad.splines.bspline import Surface
from tpmscad.splines.continuity import Conditions, Joint, joint_conditions

VALENCE = 6
"""Patches around every corner of the primitive."""

LADDER = tuple(Space(degree) for degree in range(5, 19))
"""One span of degree 5 to 18. Past 18 float64 no longer holds the joints to 1e-9 of the cell."""

BOUND_GRID = 65
"""Samples along each parameter of the mesh that stands between the surfaces in the a-priori bound."""


@dataclass(frozen=True, slots=True, eq=False)
class SheetFit:
    """The fitted surfaces of a sheet, in cells, with their deviation and rigorous bound in model units."""

    sheet: Sheet
    deviation: Deviation
    bounds: Mapping[str, float]


def fit_sheet(
    name: str, reference: str, layers: tuple[float | None, float | None], cell: float, tol: float
) -> SheetFit:
    """Fit the lower and upper surfaces at their normal distances (model units; None: no surface) to within `tol`.

    Distances of equal size share a primitive. Where no degree of the ladder meets `tol` the best comes back: compare.
    """
    if surfaces.has_mirrors(name):
        lower_at, upper_at = (None if d is None else d / cell for d in layers)
        pieces, measured_pieces = fit_pieces(name, (lower_at, upper_at), tol / cell)
        return SheetFit(pieces, measured_pieces.scaled(cell), {})
    sizes = sorted({abs(d) / cell for d in layers if d is not None})
    fits = [fit_primitive(name, reference, size, tol / cell) for size in sizes]
    # Gap faces and caps join both surfaces, so they take one spline space: the larger of the two.
    degree = max(fit.space.degree for fit in fits)
    primitives = [
        fit.surface if fit.space.degree == degree else fit_degree(name, reference, size, degree)
        for fit, size in zip(fits, sizes, strict=True)
    ]
    lower, upper = (None if d is None else (sizes.index(abs(d) / cell), d < 0) for d in layers)
    measured = [_measure(name, reference, size, primitive) for size, primitive in zip(sizes, primitives, strict=True)]
    each = [_bounds(name, reference, size, p) for size, p in zip(sizes, primitives, strict=True)]
    bound = {label: cell * max(b[label] for b in each) for label in each[0]}
    return SheetFit(Sheet(tuple(primitives), lower, upper), worst(measured).scaled(cell), bound)


@lru_cache(maxsize=64)
def fit_primitive(name: str, reference: str, offset: float, tol: float) -> Fit:
    """The offset patch (in cells) with the fewest poles whose measured two-way deviation is at most `tol` (in cells)."""
    return adapt(
        _grid(name, reference, offset),
        lambda fitted: _measure(name, reference, offset, fitted).max,
        tol,
        conditions=lambda u, v: own_joints(name, u, v),
        ladder=LADDER,
    )


@lru_cache(maxsize=64)
def fit_degree(name: str, reference: str, offset: float, degree: int) -> Surface:
    """The offset patch of one given degree."""
    return adapt(
        _grid(name, reference, offset),
        lambda fitted: 0.0,
        1.0,
        conditions=lambda u, v: own_joints(name, u, v),
        ladder=(Space(degree),),
    ).surface


def own_joints(name: str, axis_u: Axis, axis_v: Axis) -> Conditions:
    """Curvature continuity with the patch's copies over its four sides."""
    motions = surfaces.symmetry(name)
    joints = [Joint(side, motions.edge_rotation[side], motions.edge_translation[side], side) for side in range(4)]
    return joint_conditions(joints, axis_u, axis_v, order=2, valence=VALENCE)


def _grid(name: str, reference: str, offset: float):  # type: ignore[no-untyped-def]  # a closure of the Grid type
    patch = surfaces.patch(name, reference)
    return lambda u, v: patch.jet(u[:, None], v[None, :], offset).position


def _measure(name: str, reference: str, offset: float, fitted: Surface) -> Deviation:
    patch = surfaces.patch(name, reference)
    return deviation(fitted, lambda u, v: patch.jet(u, v, offset).position)


def _bounds(name: str, reference: str, offset: float, fitted: Surface) -> dict[str, float]:
    """TPMS2STEP's two bounds (eqs 3 and 4) in rigorous form, over a mesh of BOUND_GRID^2 points between the surfaces.

    The exact surface's second derivatives are sampled on the mesh's points; the fitted one's are bounded by its control nets.
    """
    patch = surfaces.patch(name, reference)
    t = np.linspace(0.0, 1.0, BOUND_GRID)
    jet = patch.jet(t[:, None], t[None, :], offset)
    uu, uv, vv = (float(np.linalg.norm(d, axis=-1).max()) for d in (jet.duu, jet.duv, jet.dvv))
    own = bounds.second_derivative_bounds(fitted, 2)
    return {
        "Filip's, from the exact surface by a mesh to the fitted one": bounds.fit_bound(
            jet.position, t, t, (uu, uv, vv), fitted
        ),
        "Zheng-Sederberg's, from the mesh to the fitted surface's bilinear facets": float(
            bounds.zheng_sederberg(own[1], t[1], t[1])
        ),
    }
