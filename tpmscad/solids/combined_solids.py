"""The solid of a field whose level sets cross: its operands made one by one, and cut by each other.

Planes, spheres and cylinders are exact; every other operand is fitted and measured by itself (`field_patches`), in a box of its
own around that of the request, so that no two have a side in common. The kernel combines what is exact, the box or body of the
request included; patches are cut by that and by each other on their own parameters (`trimming.network_boolean`). The deviation
is that of the operands' patches, of which the result keeps parts; the volume is checked against the quadrature of the whole
field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any, TypeVar

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import (
    Brep,
    join_breps,
    select_spline_faces,
)
from tpmscad.brep.carriers import Plane
from tpmscad.brep.deviation import Deviation, combine_deviations
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import InvalidRequest, LevelSetError, format_point
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.fields.analysis import volume_quadrature
from tpmscad.fields.analysis.betti_numbers import Betti, compute_betti_numbers
from tpmscad.fields.analysis.crease_network import CreaseNetwork, trace_creases
from tpmscad.fields.analysis.exact_leaves import QuadricLeaf, StrutLeaf, find_exact
from tpmscad.fields.analysis.local_leaves import has_slope_bounds
from tpmscad.fields.analysis.local_measures import STANDARD_ERRORS, measure_locally
from tpmscad.fields.analysis.outermost_extremes import combine_complements
from tpmscad.fields.analysis.slope_bounds import bound_slope
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.data_domains import list_bounded
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.boolean.solid_trees import (
    SolidSet,
    combine_sets,
    list_solids,
    make_box_set,
    make_quadric_set,
)
from tpmscad.kernel.boolean.sphere_frames import choose_sphere_frame
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.creases import SolidCreases, measure_creases
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.solid_topology import measure_topology
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.face_labels import label_outer_faces
from tpmscad.levelset.crossing_operands import Combination, list_fields, split_crossing_operands, widen_box
from tpmscad.levelset.field_solid import find_sample_spacing
from tpmscad.results.certificate import PatchMeasures
from tpmscad.solids.boolean_strategies import build_valid_solids, compare_with_sample, sample_body
from tpmscad.solids.field_patches import N_QUADRATURE_LINES, FieldPatches, fit_field_patches
from tpmscad.solids.patch_measures import FROM_FIELD, TO_FIELD, check_field_tangent_jump, check_volume
from tpmscad.solids.strut_solids import bound_struts, bound_struts_in_box, require_few_strut_sets, require_struts_apart
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming.network_boolean import Operation, combine_networks

T = TypeVar("T")

CAP, SURFACE = "cap", "surface"
"""Labels of faces in the sides of the box, and of all others."""

ON_SIDE_TOL = 1e-5
"""Model units: distance from a side of the box at which a planar face lies in it, a hundred times the kernel's tolerance."""


CREASE_LENGTH_RTOL = 0.01
"""Relative difference of the solid's creases from the field's in length, above which it is noted: the solid's are off by about
the tolerance over the sine of the wedge. Creases that are missing are seen in their number, too."""


@dataclass(frozen=True, slots=True, eq=False)
class CombinedSolids:
    """The solids, the patches that bound them, or of which they keep parts if the kernel made them, and what was measured."""

    built: BrepSolids | OcctSolids
    patches: Brep
    measures: PatchMeasures


Operand = FieldPatches | QuadricLeaf | StrutLeaf
"""What a leaf of the tree was made into: fitted patches, an exact quadric, or struts, whose boundary is exact."""


ExactOrCut = SolidSet | tuple[Brep, bool]
"""A set while it is combined: exact, of the kernel, or a boundary representation and whether its complement is meant."""


@dataclass(frozen=True, slots=True, eq=False)
class _Request:
    """A tree, its operands in the order of `list_fields`, and the box, or the body in it, in which they are combined."""

    tree: Combination | Field
    operands: Sequence[Operand]
    lo: Array
    hi: Array
    domain: SolidSet

    def evaluate(self, sets: Iterable[T], domain: T, combine: Callable[[int, Sequence[T]], T]) -> T:
        """What the tree makes of the sets of its operands within the domain: one operation for both if it is an intersection."""
        left = iter(sets)
        if isinstance(self.tree, Combination) and self.tree.sign > 0:
            return combine(+1, [*(_evaluate(part, left, combine) for part in self.tree.parts), domain])
        return combine(+1, [_evaluate(self.tree, left, combine), domain])


def combine_field_solids(
    field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer, body: CadBody | None = None
) -> CombinedSolids:
    """The solid {field < 0} in the box [lo, hi], or in a body that lies in the box.

    LevelSetError if an operand cannot be fitted, KernelError if they cannot be combined.
    """
    with stages("split"):
        tree = split_crossing_operands(field, lo, hi, tol, find_sample_spacing(field, lo, hi))
    exact = [find_exact(each) for each in list_fields(tree)]
    struts = [each.struts for each in exact if isinstance(each, StrutLeaf)]
    require_few_strut_sets(struts)
    for each in struts:
        require_struts_apart(each)
    operands = [
        known or _fit_operand(each, lo, hi, tol, stages, number)
        for number, (each, known) in enumerate(zip(list_fields(tree), exact, strict=True))
    ]
    fitted = [each for each in operands if isinstance(each, FieldPatches)]
    with stages("combine"):
        domain = make_box_set(lo, hi) if body is None else SolidSet(body.shape)
        alone = operands[0] if body is None and not isinstance(tree, Combination) else None
        in_box = isinstance(alone, StrutLeaf) and alone.sign > 0
        outcome = (STRUT_METHODS if in_box else METHODS).run(_Request(tree, operands, lo, hi, domain))
    built = outcome.value
    if not built.n_solids:
        raise InvalidRequest("nothing of the field's solid lies in the domain: check its sign and the domain")
    with stages("check"):
        reasons = f": {outcome.reasons}" if outcome.failures else ""
        how = f"surfaces that cross were cut by each other, {outcome.name}{reasons}"
        measures = _measure(field, tol, operands, how)
        betti, volume = _measure_built(built)
        if body is None:
            measures = _compare_with_field(measures, field, lo, hi, volume, betti)
        else:
            measures = _compare_with_sample(measures, field, body, volume)
        own = measure_creases(built.solids, None if body is not None else (lo, hi))
        measures = replace(measures, figures={**measures.figures, **_describe_creases(own)})
        # sides of data bound them as those of the box do; to prove their creases took five times as long as the solid
        if body is None and fitted and not list_bounded(field):
            measures = compare_creases(measures, own, trace_creases(field, lo, hi))
    patches = built.brep if isinstance(built, BrepSolids) else _join_patches(fitted)
    return CombinedSolids(built, patches, measures)


def _close_struts_in_box(request: _Request) -> BrepSolids:
    """The solids of struts alone in a box, by their nodes; TrimmingError if sides of the box cut them elsewhere."""
    (leaf,) = request.operands
    assert isinstance(leaf, StrutLeaf)
    return build_valid_solids(bound_struts_in_box(leaf.struts, request.lo, request.hi))


def _combine_networks_of(request: _Request) -> BrepSolids:
    """The solids by cuts of patches, planes and quadrics by each other; InvalidRequest if all operands are single quadrics."""
    if all(isinstance(operand, QuadricLeaf) for operand in request.operands):
        raise InvalidRequest("planes, spheres and cylinders alone are combined by the kernel, which is exact")
    sets: list[ExactOrCut] = []
    for number, operand in enumerate(request.operands):
        if isinstance(operand, QuadricLeaf):
            sets.append(_make_quadric(request, operand, number))
        else:
            sets.append(_bound_operand(operand))
    found = request.evaluate(sets, request.domain, _combine_mixed)
    assert not isinstance(found, SolidSet)
    return build_valid_solids(_tag_sides(found[0], request.lo, request.hi))


def _bound_operand(operand: FieldPatches | StrutLeaf) -> tuple[Brep, bool]:
    """The boundary of an operand's solid, and whether its complement is meant."""
    if isinstance(operand, StrutLeaf):
        return bound_struts(operand.struts), operand.sign < 0
    return operand.fitted.brep, False


def _combine_mixed(sign: int, sets: Sequence[ExactOrCut]) -> ExactOrCut:
    """The intersection (sign +1) or union (-1): first of the exact sets by the kernel, then of that and patches by cuts."""
    exact = [each for each in sets if isinstance(each, SolidSet)]
    cut = [each for each in sets if not isinstance(each, SolidSet)]
    if not exact:
        return _combine_breps(sign, cut)
    combined = combine_sets(sign, exact)
    if not cut:
        return combined
    return _combine_breps(sign, [(brep_from_shape(combined.shape), combined.complement), *cut])


def _combine_breps(sign: int, sets: Sequence[tuple[Brep, bool]]) -> tuple[Brep, bool]:
    """The intersection (sign +1) or union (-1) of solids and complements, as a solid or the complement of one."""

    def cut_all(operation: Operation, first: Brep, others: Sequence[Brep]) -> Brep:
        return reduce(lambda one, other: combine_networks(one, other, operation).brep, others, first)

    return combine_complements(
        sign,
        sets,
        unite=lambda breps: cut_all("union", breps[0], breps[1:]),
        intersect=lambda breps: cut_all("intersection", breps[0], breps[1:]),
        subtract=partial(cut_all, "difference"),
    )


def _evaluate(tree: Combination | Field, sets: Iterator[T], combine: Callable[[int, Sequence[T]], T]) -> T:
    """What the tree combines the sets of its operands to, given in the order of `list_fields`."""
    if isinstance(tree, Combination):
        return combine(tree.sign, [_evaluate(part, sets, combine) for part in tree.parts])
    return next(sets)


def _tag_sides(brep: Brep, lo: Array, hi: Array) -> Brep:
    """The boundary representation with the tag CAP on planes in the sides of the box, and SURFACE on all other faces."""
    faces, is_cap = brep.faces, np.zeros(len(brep.faces), bool)
    corners = np.stack([lo, hi])
    points = brep.vertices[brep.edges.start[brep.uses.edge]]
    face_of_use = brep.face_of_use
    for f in range(len(faces)):
        if isinstance(brep.carriers[faces.carrier[f]], Plane):
            own = points[face_of_use == f]
            is_cap[f] = (np.abs(own[:, None] - corners) < ON_SIDE_TOL).all(axis=0).any()
    return replace(brep, faces=replace(faces, tag=is_cap.astype(np.int64)), tags=(SURFACE, CAP))


def _combine_in_kernel(request: _Request) -> OcctSolids:
    """The solids by the kernel's general fuse, without labels."""
    sets = []
    for number, operand in enumerate(request.operands):
        if isinstance(operand, QuadricLeaf):
            sets.append(_make_quadric(request, operand, number))
        else:
            brep, complement = _bound_operand(operand)
            sets.append(SolidSet(build_solids(brep).shape, complement))
    return OcctSolids(list_solids(request.evaluate(sets, request.domain, combine_sets).shape))


def _make_quadric(request: _Request, q: QuadricLeaf, number: int) -> SolidSet:
    """An exact operand, as far as it reaches in the box; the seam of a sphere where few others cross it."""
    frame = {}
    if q.kind == "sphere":
        others = [
            field
            for k, field in enumerate(list_fields(request.tree))
            if k != number and abs(float(field(q.point))) <= bound_slope(field, request.lo, request.hi) * q.radius
        ]

        def measure_distances(points: Array) -> Array:
            sides = np.concatenate([points - request.lo, request.hi - points], axis=1).T
            return np.concatenate([sides, *(field(points)[None] for field in others)])

        frame = {"frame": choose_sphere_frame(q.point, q.radius, measure_distances)}
    made = make_quadric_set(q.kind, q.point, q.axis, q.radius, request.lo, request.hi, number, **frame)
    return SolidSet(made.shape, q.sign < 0)


METHODS: Fallbacks[[_Request], BrepSolids | OcctSolids] = Fallbacks(
    (
        Fallback("on the parameters of their patches", _combine_networks_of, "a second for a thousand patches"),
        Fallback("by the kernel's boolean", _combine_in_kernel, "10 ms for each patch that is cut"),
    ),
    remedy="move or resize one of the fields, or the box, a little, so that no surfaces touch, or change `tol`",
)
"""How the operands are combined."""

STRUT_METHODS: Fallbacks[[_Request], BrepSolids | OcctSolids] = Fallbacks(
    (Fallback("node by node", _close_struts_in_box, "a hundredth of a second for each strut"), *METHODS.methods),
    remedy=METHODS.remedy,
)
"""How struts alone are cut by a box."""


def _measure_built(built: BrepSolids | OcctSolids) -> tuple[Betti, float]:
    """Betti numbers and volume of the solids, by their arrays or by the kernel."""
    if isinstance(built, BrepSolids):
        properties = measure_solid(built.brep, built.nesting.moments)
        return properties.betti or (0, 0, 0), properties.volume
    return measure_topology(built.solids).betti, sum(float(solid_moments(solid)[1]) for solid in built.solids)


def _fit_operand(field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer, number: int) -> FieldPatches:
    """The patches of an operand in a box of its own; beyond that of the request it is extended linearly where it must be."""
    wide = widen_box(lo, hi, number)
    try:
        return fit_field_patches(field, *wide, tol, stages)
    except (LevelSetError, InvalidRequest):  # a blend or sampled data end at the box, perhaps
        return fit_field_patches(extend_level_sets_linearly(field, lo, hi), *wide, tol, stages)


def _measure(field: Field, tol: float, operands: Sequence[Operand], how: str) -> PatchMeasures:
    """The worst measures of the operands, and the deviation of each; exact ones deviate by nothing."""
    each = [operand.fitted for operand in operands if isinstance(operand, FieldPatches)]
    deviation = combine_deviations([f.deviation for f in each]) if each else Deviation(0.0, 0.0, 0.0, 0.0)
    continuity = EdgeContinuity(
        max((f.continuity.gap for f in each), default=0.0),
        max((f.continuity.tangent_jump_deg for f in each), default=0.0),
        max((f.continuity.curvature_jump for f in each), default=0.0),
        0,
    )
    notes = dict.fromkeys((*collect_notes(field), *(note for f in each for note in f.notes)))
    return PatchMeasures(
        tol,
        deviation,
        "field",
        continuity,
        figures={TO_FIELD: deviation.to_reference, FROM_FIELD: deviation.from_reference, **_list_deviations(operands)},
        checks=(check_field_tangent_jump(continuity.tangent_jump_deg),),
        notes=(*notes, how),
    )


def _list_deviations(operands: Sequence[Operand]) -> dict[str, float]:
    """The greatest deviation of each fitted operand, by its place in the tree: of all its patches, of which parts are kept."""
    return {
        f"deviation of operand {number}": operand.fitted.deviation.max
        for number, operand in enumerate(operands, 1)
        if isinstance(operand, FieldPatches)
    }


def _compare_with_field(
    measures: PatchMeasures, field: Field, lo: Array, hi: Array, own: float, own_betti: Betti
) -> PatchMeasures:
    """The measures with the field's volume, and a note if grids count other Betti numbers than the solid's."""
    notes = measures.notes
    if has_slope_bounds(field, lo, hi):
        volume, error, counted = measure_locally(field, lo, hi, own_betti.__eq__)
        notes = (
            *notes,
            f"the volume of the field is that of a stratified sample, within {STANDARD_ERRORS:g} standard errors",
        )
    else:
        spacing = float((hi - lo).max()) / N_QUADRATURE_LINES
        volume, error = volume_quadrature.integrate_volume(field, lo, hi, spacing)
        counted = compute_betti_numbers(field, lo, hi, confirm=own_betti.__eq__, crossing=True)
    check = check_volume(own, volume, error)
    if counted != own_betti:
        words = (
            "do not settle on grids" if counted is None else f"are {counted} on grids, which acute wedges fall apart on"
        )
        notes = (*notes, f"Betti numbers {own_betti} are counted on the solid; those of the field {words}")
    figures = {**measures.figures, "volume of the field": volume, "uncertainty of that volume": error}
    return replace(measures, checks=(*measures.checks, check), notes=notes, figures=figures)


def _compare_with_sample(measures: PatchMeasures, field: Field, body: CadBody, own: float) -> PatchMeasures:
    """The measures with a check of the volume against an even sample of points in the body."""
    check = compare_with_sample(own / body.volume, field(sample_body(body)) < 0, body.name)
    return replace(measures, checks=(*measures.checks, check))


def _describe_creases(creases: SolidCreases) -> dict[str, float]:
    """Figures of the sharp edges, those at the sides of the domain included."""
    if not creases.count:
        return {}
    return {
        "creases": creases.count,
        "length of the creases": creases.length,
        "shortest crease": creases.shortest,
        "least wedge in degrees": creases.sharpest_deg,
    }


def compare_creases(measures: PatchMeasures, own: SolidCreases, expected: CreaseNetwork) -> PatchMeasures:
    """The measures with the creases that the field has by itself, and notes where the solid's differ or they are not resolved."""
    if not expected.is_enclosed:
        return measures
    notes = measures.notes
    figures = {
        **measures.figures,
        "creases of the field": expected.n_curves,
        "length of the field's creases": expected.length,
        "creases within the box": own.inner_curves,
        "length of the creases within the box": own.inner_length,
    }
    differs = abs(own.inner_length - expected.length) > CREASE_LENGTH_RTOL * expected.length
    if own.inner_curves != expected.n_curves or differs:
        notes = (
            *notes,
            f"the solid has {own.inner_curves} creases of length {own.inner_length:.5g} within the box, the field "
            f"{expected.n_curves} of {expected.length:.5g}{'' if expected.is_proved else ', not proved to be all'}",
        )
    if len(expected.unresolved.lo):
        at = format_point(0.5 * (expected.unresolved.lo[0] + expected.unresolved.hi[0]), 5)
        notes = (
            *notes,
            f"surfaces touch or coincide near {at}, or are rough: the creases of the field are not resolved there",
        )
    return replace(measures, notes=notes, figures=figures)


def _join_patches(fitted: list[FieldPatches]) -> Brep:
    """The patches of all operands, without the caps of their boxes."""
    return join_breps([select_spline_faces(found.fitted.brep) for found in fitted])


def label_combined_solids(solids: tuple[Any, ...], lo: Array, hi: Array) -> OcctSolids:
    """The solids with the labels of their faces: caps in the sides of the box [lo, hi], surfaces elsewhere."""
    labels = []
    for solid in solids:
        caps, sides = label_outer_faces(solid, CAP), np.stack([lo, hi])
        boxes = [np.stack(enclosing_box(face)) for face in faces_of(solid)]
        in_side = [(np.abs(box[:, None] - sides) < ON_SIDE_TOL).all(axis=0).any() for box in boxes]
        labels.append(
            tuple(cap if cap != CAP and inside else SURFACE for cap, inside in zip(caps, in_side, strict=True))
        )
    return OcctSolids(solids, tuple(labels))
