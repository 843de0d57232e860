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
from functools import cached_property, partial, reduce
from typing import Any, TypeVar

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import (
    Brep,
    join_breps,
    select_spline_faces,
    translate_brep,
)
from tpmscad.brep.carriers import Plane
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.fields.analysis.crease_network import trace_creases
from tpmscad.fields.analysis.exact_leaves import CoreLeaf, NetworkLeaf, QuadricLeaf, StrutLeaf, find_exact
from tpmscad.fields.analysis.outermost_extremes import combine_complements
from tpmscad.fields.analysis.slope_bounds import bound_slope
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.fields.kinds.data_domains import list_bounded
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.body_brep import FreeFormBody, brep_from_shape
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
from tpmscad.kernel.measure.creases import measure_creases
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.face_labels import label_outer_faces
from tpmscad.levelset.crossing_operands import Combination, list_fields, split_crossing_operands, widen_box
from tpmscad.levelset.field_solid import find_sample_spacing
from tpmscad.results.certificate import PatchMeasures
from tpmscad.solids.cut import Finish, MadeSolids, build_valid_solids, try_placements
from tpmscad.solids.matter.core_boundaries import bound_voids
from tpmscad.solids.matter.crossing_measures import (
    compare_creases,
    compare_with_field,
    describe_creases,
    measure_built,
    measure_operands,
)
from tpmscad.solids.matter.field_patches import FieldPatches, fit_field_patches
from tpmscad.solids.matter.patch_measures import (
    move_patch_measures,
)
from tpmscad.solids.matter.reference_distance import DistanceFunction, field_distance
from tpmscad.solids.matter.strut_boundaries import (
    bound_struts,
    bound_struts_in_box,
    divide_struts,
)
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming.network_boolean import (
    NetworkReport,
    NetworkResult,
    Operation,
    combine_networks,
)
from tpmscad.trimming.operands.polyhedra import box

T = TypeVar("T")

CAP, SURFACE = "cap", "surface"
"""Labels of faces in the sides of the box, and of all others."""

ON_SIDE_TOL = 1e-5
"""Model units: distance from a side of the box at which a planar face lies in it, a hundred times the kernel's tolerance."""


Operand = FieldPatches | QuadricLeaf | NetworkLeaf
"""What a leaf of the tree was made into: fitted patches, an exact quadric, or struts or a core, whose boundary is exact."""


ExactOrCut = SolidSet | tuple[Brep, bool]
"""A set while it is combined: exact, of the kernel, or a boundary representation and whether its complement is meant."""


@dataclass(frozen=True, eq=False)
class CrossingFields:
    """A field whose level sets cross, its tree, and what its leaves were made into, in the order of `list_fields`.

    What is cut by them lies in the box [lo, hi].
    """

    field: Field
    tree: Combination | Field
    operands: Sequence[Operand]
    lo: Array
    hi: Array
    tol: float

    @property
    def name(self) -> str:
        """The name of what is filled with it."""
        return f"{self.field.structure} infill" if isinstance(self.field, CoreField) else "field infill"

    @property
    def fitted(self) -> list[FieldPatches]:
        """The operands that are not exact."""
        return [each for each in self.operands if isinstance(each, FieldPatches)]

    @cached_property
    def patches(self) -> Brep:
        """The patches of all operands, without the caps of their boxes."""
        return join_breps([select_spline_faces(found.fitted.brep) for found in self.fitted])

    @cached_property
    def closed(self) -> Brep:
        """The solid of the field in the box."""
        return self.combine((box(self.lo, self.hi), False), "intersection", lambda _: None).brep

    @cached_property
    def measures(self) -> PatchMeasures:
        """What was measured on the operands."""
        return measure_operands(self.field, self.tol, self.operands)

    @property
    def distance(self) -> DistanceFunction:
        """Of points from the level set."""
        return field_distance(self.field)

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in the solid of the field."""
        return self.field(points) < 0

    def cut(self, domain: FreeFormBody, operation: Operation, finish: Finish) -> NetworkResult:
        """What a solid in the box and that of the field have in common, or what the field leaves of it."""
        return self.combine((domain.brep, False), operation, finish)

    def combine(self, domain: ExactOrCut, operation: Operation, finish: Finish) -> NetworkResult:
        """The same of a domain that may be exact, at the first placement of the field at which it succeeds.

        InvalidRequest where the kernel has to combine all: planes, spheres and cylinders with an exact domain.
        """
        if isinstance(domain, SolidSet) and all(isinstance(operand, QuadricLeaf) for operand in self.operands):
            raise InvalidRequest("planes, spheres and cylinders alone are combined by the kernel, which is exact")
        return try_placements(partial(self._combine_at, domain, operation, finish), self.tol)

    def _combine_at(self, domain: ExactOrCut, operation: Operation, finish: Finish, shift: Array) -> NetworkResult:
        """What is combined once the field is translated by a vector."""
        moved = replace(self, operands=[_move_operand(each, shift) for each in self.operands]) if shift.any() else self
        complement = _complement if operation == "difference" else None
        found = moved.evaluate(moved.bound_operands(), domain, _combine_mixed, complement)
        assert not isinstance(found, SolidSet)  # as the domain or an operand is not
        report = NetworkReport(0, 0, float(found[0].edges.deviation.max(initial=0.0)), shift, "")
        return NetworkResult(found[0], report, finish(found[0]))

    def intersect_in_kernel(self, shape: Any) -> tuple[Any, ...]:
        """The solids in a shape by the kernel's general fuse."""
        return self.combine_in_kernel(SolidSet(shape))

    def combine_in_kernel(self, domain: SolidSet) -> tuple[Any, ...]:
        """The solids in a domain by the kernel's general fuse, largest first."""
        sets = [
            each if isinstance(each, SolidSet) else SolidSet(build_solids(each[0]).shape, each[1])
            for each in self.bound_operands()
        ]
        return list_solids(self.evaluate(sets, domain, combine_sets).shape)

    def measure(self, solids: BrepSolids | OcctSolids, moved: float) -> PatchMeasures:
        """The measures of the operands, and the creases of what a cut has left."""
        measures, creases = (
            move_patch_measures(self.measures, moved),
            measure_creases(solids if isinstance(solids, BrepSolids) else solids.solids),
        )
        return replace(measures, figures={**measures.figures, **describe_creases(creases)})

    def bound_operands(self) -> list[ExactOrCut]:
        """The boundaries of all operands."""
        return [
            _make_quadric(self, operand, number)
            if isinstance(operand, QuadricLeaf)
            else _bound_operand(operand, self.lo, self.hi, self.tol)
            for number, operand in enumerate(self.operands)
        ]

    def evaluate(
        self,
        sets: Iterable[T],
        domain: T,
        combine: Callable[[int, Sequence[T]], T],
        complement: Callable[[T], T] | None = None,
    ) -> T:
        """What the domain has in common with the tree of the sets, or with its complement if that is how to take it.

        One operation for both if the tree is an intersection.
        """
        left = iter(sets)
        if complement is not None:
            return combine(+1, [domain, complement(_evaluate(self.tree, left, combine))])
        if isinstance(self.tree, Combination) and self.tree.sign > 0:
            return combine(+1, [domain, *(_evaluate(part, left, combine) for part in self.tree.parts)])
        return combine(+1, [domain, _evaluate(self.tree, left, combine)])


def fit_crossing_fields(field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer) -> CrossingFields:
    """The operands of a field whose level sets cross, for the box [lo, hi]; LevelSetError if one cannot be fitted."""
    with stages("split"):
        tree = split_crossing_operands(field, lo, hi, tol, find_sample_spacing(field, lo, hi))
    exact = [find_exact(each) for each in list_fields(tree)]
    struts = [each.struts for each in exact if isinstance(each, StrutLeaf)]
    for each in struts:
        divide_struts(each, tol)
    operands = [
        known or _fit_operand(each, lo, hi, tol, stages, number)
        for number, (each, known) in enumerate(zip(list_fields(tree), exact, strict=True))
    ]
    return CrossingFields(field, tree, operands, lo, hi, tol)


def combine_field_solids(
    field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer
) -> tuple[MadeSolids, Remake]:
    """The solid {field < 0} in the box [lo, hi], and what makes it again and finishes it otherwise.

    LevelSetError if an operand cannot be fitted, KernelError if they cannot be combined.
    """
    matter = fit_crossing_fields(field, lo, hi, tol, stages)
    with stages("combine"):
        alone = matter.operands[0] if not isinstance(matter.tree, Combination) else None
        in_box = isinstance(alone, StrutLeaf) and alone.sign > 0 and not divide_struts(alone.struts, tol).pieces
        outcome = (STRUT_METHODS if in_box else METHODS).run(matter)
    built, moved = outcome.value
    if not built.n_solids:
        raise InvalidRequest("nothing of the field's solid lies in the domain: check its sign and the domain")
    with stages("check"):
        reasons = f": {outcome.reasons}" if outcome.failures else ""
        how = f"surfaces that cross were cut by each other, {outcome.name}{reasons}"
        if moved:
            how = f"{how}; the field was moved by {moved:.2g}"
        measures = move_patch_measures(matter.measures, moved)
        measures = replace(measures, notes=(*measures.notes, how))
        measures = compare_with_field(measures, field, lo, hi, *measure_built(built))
        own = measure_creases(built if isinstance(built, BrepSolids) else built.solids, (lo, hi))
        measures = replace(measures, figures={**measures.figures, **describe_creases(own)})
        # sides of data bound them as those of the box do; to prove their creases took five times as long as the solid
        if matter.fitted and not list_bounded(field):
            measures = compare_creases(measures, own, trace_creases(field, lo, hi))
    patches = built.brep if isinstance(built, BrepSolids) else matter.patches
    made = MadeSolids(
        built,
        patches,
        measures,
        partial(contains_in_box, field, lo, hi),
        label=lambda solids: label_combined_solids(solids, lo, hi),
    )
    return made, partial(_combine_networks_of, matter)


def contains_in_box(field: Field, lo: Array, hi: Array, points: Array) -> BoolArray:
    """Whether points (n, 3) lie in the solid of a field in the box [lo, hi]."""
    inside = np.asarray(((points > lo) & (points < hi)).all(axis=1))
    inside[inside] = field(points[inside]) < 0
    return inside


Combined = tuple[BrepSolids | OcctSolids, float]
"""Solids in a box, and the length by which the field was moved."""

Remake = Callable[[Finish], Combined]
"""Solids made of what a cut leaves, with the matter moved where that is needed."""


def _close_struts_in_box(matter: CrossingFields) -> Combined:
    """The solids of struts alone in a box, by their nodes; TrimmingError if sides of the box cut them elsewhere."""
    (leaf,) = matter.operands
    assert isinstance(leaf, StrutLeaf)
    return build_valid_solids(bound_struts_in_box(leaf.struts, matter.lo, matter.hi)), 0.0


def _combine_networks_of(matter: CrossingFields, finish: Finish = build_valid_solids) -> Combined:
    """The solids by cuts of patches, planes and quadrics by each other; InvalidRequest if all operands are single quadrics."""
    domain = make_box_set(matter.lo, matter.hi)
    found = matter.combine(domain, "intersection", lambda brep: finish(_tag_sides(brep, matter.lo, matter.hi)))
    return found.built, found.report.shifted


def _combine_in_kernel(matter: CrossingFields) -> Combined:
    """The solids by the kernel's general fuse, without labels."""
    return OcctSolids(matter.combine_in_kernel(make_box_set(matter.lo, matter.hi))), 0.0


def _move_operand(operand: Operand, shift: Array) -> Operand:
    """An operand translated by a vector."""
    if isinstance(operand, QuadricLeaf | NetworkLeaf):
        return operand.move(np.eye(3), -shift, 1.0)
    return replace(operand, fitted=replace(operand.fitted, brep=translate_brep(operand.fitted.brep, shift)))


def _complement(of: ExactOrCut) -> ExactOrCut:
    """The complement of a set."""
    return SolidSet(of.shape, not of.complement) if isinstance(of, SolidSet) else (of[0], not of[1])


def _bound_operand(operand: FieldPatches | NetworkLeaf, lo: Array, hi: Array, tol: float) -> tuple[Brep, bool]:
    """The boundary of an operand's solid in the box [lo, hi], and whether its complement is meant."""
    if isinstance(operand, StrutLeaf):
        return bound_struts(operand.struts, tol), operand.sign < 0
    if isinstance(operand, CoreLeaf):
        return bound_voids(operand.core, lo, hi), operand.sign > 0
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
    brep = brep_from_shape(combined.shape)
    brep = replace(brep, tags=(SURFACE,) * len(brep.tags))
    both = brep, combined.complement
    # the first one is not moved: the domain
    return _combine_breps(sign, [both, *cut] if isinstance(sets[0], SolidSet) else [*cut, both])


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


def _make_quadric(request: CrossingFields, q: QuadricLeaf, number: int) -> SolidSet:
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


METHODS: Fallbacks[[CrossingFields], Combined] = Fallbacks(
    (
        Fallback("on the parameters of their patches", _combine_networks_of, "a second for a thousand patches"),
        Fallback("by the kernel's boolean", _combine_in_kernel, "10 ms for each patch that is cut"),
    ),
    remedy="move or resize one of the fields, or the box, a little, so that no surfaces touch, or change `tol`",
)
"""How the operands are combined."""

STRUT_METHODS: Fallbacks[[CrossingFields], Combined] = Fallbacks(
    (Fallback("node by node", _close_struts_in_box, "a hundredth of a second for each strut"), *METHODS.methods),
    remedy=METHODS.remedy,
)
"""How struts alone are cut by a box."""


def _fit_operand(field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer, number: int) -> FieldPatches:
    """The patches of an operand in a box of its own; beyond that of the request it is extended linearly where it must be."""
    wide = widen_box(lo, hi, number)
    try:
        return fit_field_patches(field, *wide, tol, stages)
    except (LevelSetError, InvalidRequest):  # a blend or sampled data end at the box, perhaps
        return fit_field_patches(extend_level_sets_linearly(field, lo, hi), *wide, tol, stages)


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
