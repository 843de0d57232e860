"""Trimming of a lattice by a body of planes, quadrics and free-form surfaces: the boundary of its solid inside the body.

The pipeline has four stages: operands, intersection, classification and rebuilding. Each congruence class of patch and surface is
intersected once. Where an intersection curve passes an edge of the body, its direction tells into which face it continues; so
every piece of a curve, and with it every intersection of a lattice edge, is known to lie on the body's boundary or not. The
pieces inside are chained into trimming loops by their vertices: first on the lattice's patches, then on the body's faces. Points
are matched by distance only where two intersection curves meet. No geometry kernel is involved.

The lattice need not be closed; it must cover the body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, translate_brep
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.loops import LoopError
from tpmscad.errors import InvalidRequest, TrimmingError, UntracedCurve
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.trimming.classify.intersection_curves import classify_intersection_curves
from tpmscad.trimming.classify.lattice_edges import classify_lattice_edges, split_lattice_edges
from tpmscad.trimming.classify.point_membership import points_in_lattice
from tpmscad.trimming.intersect.arrangement import Arrangement, Operands
from tpmscad.trimming.intersect.body_edges import intersect_body_edges
from tpmscad.trimming.intersect.broad_phase import find_candidate_pairs
from tpmscad.trimming.intersect.corner_clearance import find_clear_shift
from tpmscad.trimming.intersect.curve_surface import intersect_lattice_edges
from tpmscad.trimming.intersect.patch_surface import collect_imprints, intersect_patches
from tpmscad.trimming.operands.face_regions import build_face_regions
from tpmscad.trimming.operands.patch_sides import read_patch_sides, read_patches, read_spline_curves
from tpmscad.trimming.operands.trimming_body import prepare_trimming_body
from tpmscad.trimming.rebuild.trimmed_brep import LatticeDomain, TrimmedDomains, rebuild_domains, restrict_domains

DEFAULT_TOL = 1e-7
"""Tolerance in model units; kernels give every edge at least this tolerance, so that a smaller one has no effect there."""

SHIFT_MULTIPLES = (0.0, 1.0, 2.0)
"""Multiples of `SHIFT_STEP_TOLS` by which the lattice is translated, one after the other, until a trim succeeds."""

SHIFT_STEP_TOLS = 10.0
"""Unit of the translations, in tolerances."""

SHIFT_DIRECTION = np.array([0.59, 0.41, 0.70])
"""Direction of the translations: of about unit length, and no direction of symmetry."""


@dataclass(frozen=True, slots=True)
class TrimReport:
    """Statistics of a trim.

    `n_patch_classes`: congruence classes of (patch, surface). `curves`: distinct fitted curves. `max_deviation`: largest
    deviation of an edge, model units.
    `shift` (3,): the lattice's translation, model units (mostly 0), and `reason`: the error that made it necessary.
    """

    n_patch_classes: int
    curves: int
    max_deviation: float
    shift: Array
    reason: str

    @property
    def shifted(self) -> float:
        """Length of the translation."""
        return float(np.linalg.norm(self.shift))

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on the translation of the lattice, if there was one."""
        return (f"the lattice was moved by {self.shifted:.2g}: {self.reason}",) if self.shifted else ()


@dataclass(frozen=True, slots=True, eq=False)
class TrimResult:
    """A closed boundary representation, the statistics of its trim, and what the caller built of it."""

    brep: Brep
    report: TrimReport
    built: Any = None


def trim(
    lattice: Brep,
    body: Brep,
    tol: float | None = None,
    inside: Callable[[Array], Array] | None = None,
    *,
    build: Callable[[Brep], Any] | None = None,
    free_form: Mapping[int, FreeFormSurface] | None = None,
    clearance: float = 0.0,
    max_shift: float = 0.0,
) -> TrimResult:
    """The intersection of the lattice's solid and the body, as a closed boundary representation.

    A face that lies on the body has the tag of the body's face.

    Parameters
    ----------
    lattice
        Whole patches with outward senses that cover the body; they may end raggedly outside.
    body
        A closed boundary representation of planes, cylinders, cones, spheres and tori, and of splines whose distances are in
        `free_form`; convex or not.
    tol
        Largest distance between an intersection curve and its surfaces, in model units; `DEFAULT_TOL` by default.
    inside
        inside(points (n, 3)) -> (n,) bool tells solid from void where no edge of the body meets the lattice. By default the
        nearest patch decides.
    build
        Makes `TrimResult.built` of the result. If it raises TrimmingError, since the kernel rejects what it builds, the next
        placement is tried: where a face of the body is tangent to the side of a patch, a curve comes within the kernel's
        tolerance of that side, which the kernel takes for a self-intersecting loop.
    free_form
        The free-form surfaces with distances of the body's spline carriers, by the numbers of these.
    clearance, max_shift
        The lattice is translated by at most `max_shift`, so that no corner of a patch lies nearer to a face of the body than
        `clearance`, both in model units; as far from it as possible if that cannot be had.

    Raises
    ------
    InvalidRequest
        If the lattice does not consist of whole patches, the body is not closed, or tol is not positive.
    TrimmingError
        If the lattice does not cover the body, or an intersection is not resolved at any of the `PLACEMENTS`.
    """
    domain = LatticeDomain(np.arange(len(lattice.faces)), 1)
    build_first = None if build is None else lambda result: build(result.breps[0])
    request = _TrimRequest([domain], inside, build_first)
    operands = prepare_operands(lattice, body, DEFAULT_TOL if tol is None else tol, free_form)
    trimmed, report = _trim_with_placements(operands, request, clearance, max_shift)
    return TrimResult(trimmed.result.breps[0], report, trimmed.built)


def trim_domains(
    lattice: Brep,
    body: Brep,
    domains: Sequence[LatticeDomain],
    *,
    free_form: Mapping[int, FreeFormSurface] | None = None,
    clearance: float = 0.0,
    max_shift: float = 0.0,
) -> tuple[TrimmedDomains, TrimReport]:
    """Several regions that the lattice's faces bound, each intersected with the body; arguments and errors as in `trim`.

    Lattice and body are intersected and classified once; only the rebuilding is repeated for each domain.
    """
    request = _TrimRequest(domains, None, None)
    trimmed, report = _trim_with_placements(
        prepare_operands(lattice, body, DEFAULT_TOL, free_form), request, clearance, max_shift
    )
    return trimmed.result, report


@dataclass(frozen=True, slots=True, eq=False)
class _TrimRequest:
    """The regions to rebuild, what tells points in or out, and what builds the trimmed regions."""

    domains: Sequence[LatticeDomain]
    inside: Callable[[Array], Array] | None
    build: Callable[[TrimmedDomains], Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class _Trim:
    """An arrangement, the regions rebuilt from it, what was built of them, and the translation of the lattice (3,)."""

    arrangement: Arrangement
    result: TrimmedDomains
    built: Any
    shift: Array


def _trim_translated(multiple: float, operands: Operands, request: _TrimRequest) -> _Trim:
    """The trim with the lattice translated by a multiple of `SHIFT_STEP_TOLS`; TrimmingError if it is not resolved."""
    shift = multiple * SHIFT_STEP_TOLS * operands.tol * SHIFT_DIRECTION
    shifted = translate_lattice(operands, shift) if multiple else operands
    classify = _points_in_domain if request.inside is None else partial(_points_inside, request.inside)
    arrangement = compute_arrangement(shifted)
    try:
        result = rebuild_domains(arrangement, request.domains, [partial(classify, shifted, d) for d in request.domains])
        result = restrict_domains(result)
    except LoopError as error:
        raise TrimmingError(str(error)) from error
    return _Trim(arrangement, result, request.build(result) if request.build else None, shift)


PLACEMENTS: Fallbacks[[Operands, _TrimRequest], _Trim] = Fallbacks(
    tuple(
        Fallback(f"the lattice moved by {multiple * SHIFT_STEP_TOLS:g} tolerances", partial(_trim_translated, multiple))
        for multiple in SHIFT_MULTIPLES
    ),
    retry_on=(TrimmingError,),
    final=(UntracedCurve,),
)
"""Placements of the lattice that are tried while intersections are not resolved, or the kernel rejects what is built."""

FREE_FORM_PLACEMENTS = replace(PLACEMENTS, methods=PLACEMENTS.methods[:2])
"""Those for bodies with free-form faces, where each takes several times as long."""


def _trim_with_placements(
    operands: Operands, request: _TrimRequest, clearance: float, max_shift: float
) -> tuple[_Trim, TrimReport]:
    """The trim at the first of the `PLACEMENTS` that succeeds, and its statistics."""
    free_form = operands.body.surfaces.is_free_form[: operands.body.n_surfaces]
    shift, reasons = np.zeros(3), []
    if clearance > 0:
        shift, before, after = find_clear_shift(operands, clearance, max_shift)
        if shift.any():
            operands = translate_lattice(operands, shift)
            reasons.append(
                f"a corner of a patch lay {before:.2g} from a face of the body, where {after:.2g} is the nearest now"
            )
    outcome = (FREE_FORM_PLACEMENTS if free_form.any() else PLACEMENTS).run(operands, request)
    trimmed = outcome.value
    reason = "; ".join([*reasons, *(str(failure) for failure in outcome.failures[:1])])
    return trimmed, _report(trimmed.arrangement, trimmed.result, shift + trimmed.shift, reason)


def compute_arrangement(operands: Operands) -> Arrangement:
    """The classified arrangement of lattice and body; TrimmingError if an intersection is not resolved."""
    a = Arrangement.of_lattice(operands)
    a = intersect_lattice_edges(a)
    a = intersect_patches(a)
    a = collect_imprints(a)
    a = intersect_body_edges(a)
    a = classify_intersection_curves(a)
    a = split_lattice_edges(a)
    return classify_lattice_edges(a)


def prepare_operands(
    lattice: Brep, body: Brep, tol: float, free_form: Mapping[int, FreeFormSurface] | None = None
) -> Operands:
    """The operands of a trim, with the candidate pairs of the broad phase."""
    if not (np.isfinite(tol) and tol > 0):
        raise InvalidRequest(f"tol must be positive and finite, not {tol}")
    sides, prepared = read_patch_sides(lattice), prepare_trimming_body(body, free_form)
    regions, patches = tuple(build_face_regions(prepared)), read_patches(lattice)
    candidates = find_candidate_pairs(lattice, patches, prepared, regions)
    return Operands(lattice, sides, patches, read_spline_curves(lattice), prepared, regions, candidates, tol)


def translate_lattice(operands: Operands, vector: Array) -> Operands:
    """The operands with the lattice translated."""
    lattice = translate_brep(operands.lattice, vector)
    candidates = find_candidate_pairs(lattice, operands.patches, operands.body, operands.regions)
    return replace(operands, lattice=lattice, candidates=candidates)


def _points_in_domain(operands: Operands, domain: LatticeDomain, points: Array) -> BoolArray:
    """Points (n, 3) that lie in a domain of the lattice, by its nearest patch."""
    part = domain.select(operands.lattice)
    whole = len(domain.faces) == len(operands.lattice.faces)
    return points_in_lattice(part, operands.sides if whole else read_patch_sides(part), points)


def _points_inside(
    inside: Callable[[Array], Array], operands: Operands, domain: LatticeDomain, points: Array
) -> BoolArray:
    """Points (n, 3) that the caller's function says are in the solid."""
    return np.asarray(inside(points), bool)


def _report(a: Arrangement, result: TrimmedDomains, shift: Array, reason: str) -> TrimReport:
    return TrimReport(
        n_patch_classes=a.arcs.n_classes,
        curves=len(a.arcs.fitted_arcs),
        max_deviation=max(float(brep.edges.deviation.max(initial=0.0)) for brep in result.breps),
        shift=shift,
        reason=reason,
    )
