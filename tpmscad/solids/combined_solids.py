"""The solid of a field whose level sets cross: its operands made one by one, and cut by each other.

Planes, spheres and cylinders are exact; every other operand is fitted and measured by itself (`field_patches`), in a box of its
own around that of the request, so that no two have a side in common. The kernel unites and intersects them. The deviation is
that of the operands' patches, of which the result keeps parts; the volume is checked against the quadrature of the whole field.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, join_breps, select_faces, spline_faces
from tpmscad.brep.deviation import Deviation, combine_deviations
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.fields.analysis import volume_quadrature
from tpmscad.fields.analysis.betti_numbers import Betti, compute_betti_numbers
from tpmscad.fields.analysis.quadric_leaves import find_quadric
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, betti_numbers
from tpmscad.kernel.boolean.solid_trees import (
    SolidSet,
    combine_sets,
    cut_by_box,
    cut_by_solid,
    list_solids,
    make_quadric_set,
)
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.creases import measure_creases
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_sampling import sample_solid
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.face_labels import label_outer_faces
from tpmscad.levelset.crossing_operands import Combination, split_crossing_operands, widen_box
from tpmscad.levelset.field_solid import find_sample_spacing
from tpmscad.results.certificate import Check, PatchMeasures
from tpmscad.solids.boolean_strategies import N_SAMPLE_LINES, POINTS_PER_LINE, estimate_fraction
from tpmscad.solids.field_patches import N_QUADRATURE_LINES, FieldPatches, fit_field_patches
from tpmscad.solids.patch_measures import FIELD_VOLUME_RTOL, FROM_FIELD, TO_FIELD, check_field_tangent_jump
from tpmscad.stage_timer import StageTimer

CAP, SURFACE = "cap", "surface"
"""Labels of faces in the sides of the box, and of all others."""

ON_SIDE_TOL = 1e-5
"""Model units: distance from a side of the box at which a planar face lies in it, a hundred times the kernel's tolerance."""


@dataclass(frozen=True, slots=True, eq=False)
class CombinedSolids:
    """The kernel's solids, largest first, the patches of which they keep parts, and what was measured on both."""

    solids: tuple[Any, ...]
    patches: Brep
    measures: PatchMeasures


def combine_field_solids(
    field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer, body: CadBody | None = None
) -> CombinedSolids:
    """The solid {field < 0} in the box [lo, hi], or in a body that lies in the box.

    LevelSetError if an operand cannot be fitted, KernelError if the kernel cannot combine them.
    """
    with stages("split"):
        tree = split_crossing_operands(field, lo, hi, tol, find_sample_spacing(field, lo, hi))
    fitted: list[FieldPatches] = []
    found = _make_set(tree, lo, hi, tol, stages, fitted, count())
    with stages("combine"):
        solids = list_solids(cut_by_box(found, lo, hi) if body is None else cut_by_solid(found, body.shape))
    if not solids:
        raise InvalidRequest("nothing of the field's solid lies in the domain: check its sign and the domain")
    with stages("check"):
        measures = _measure(field, tol, fitted)
        volume = sum(float(solid_moments(solid)[1]) for solid in solids)
        if body is None:
            measures = _compare_with_field(measures, field, lo, hi, volume, betti_numbers(solids))
        else:
            measures = _compare_with_sample(measures, field, body, volume)
        figures = {**measures.figures, **_describe_creases(solids)}
    return CombinedSolids(solids, _join_patches(fitted), replace(measures, figures=figures))


def _make_set(
    tree: Combination | Field,
    lo: Array,
    hi: Array,
    tol: float,
    stages: StageTimer,
    fitted: list[FieldPatches],
    numbers: Iterator[int],
) -> SolidSet:
    """The solid of a tree, as the kernel has it; what is fitted for it is added to `fitted`."""
    if isinstance(tree, Combination):
        sets = [_make_set(part, lo, hi, tol, stages, fitted, numbers) for part in tree.parts]
        with stages("combine"):
            return combine_sets(tree.sign, sets)
    number = next(numbers)
    if (quadric := find_quadric(tree)) is not None:
        made = make_quadric_set(quadric.kind, quadric.point, quadric.axis, quadric.radius, lo, hi, number)
        return SolidSet(made.shape, quadric.sign < 0)
    found = _fit_operand(tree, lo, hi, tol, stages, number)
    fitted.append(found)
    with stages("build"):
        return SolidSet(build_solids(found.fitted.brep, found.moments).shape)


def _fit_operand(field: Field, lo: Array, hi: Array, tol: float, stages: StageTimer, number: int) -> FieldPatches:
    """The patches of an operand in a box of its own; beyond that of the request it is extended linearly where it must be."""
    wide = widen_box(lo, hi, number)
    try:
        return fit_field_patches(field, *wide, tol, stages)
    except (LevelSetError, InvalidRequest):  # a blend or sampled data end at the box, perhaps
        return fit_field_patches(extend_level_sets_linearly(field, lo, hi), *wide, tol, stages)


def _measure(field: Field, tol: float, fitted: list[FieldPatches]) -> PatchMeasures:
    """The worst measures of the operands; exact ones deviate by nothing."""
    each = [found.fitted for found in fitted]
    deviation = combine_deviations([f.deviation for f in each]) if each else Deviation(0.0, 0.0, 0.0, 0.0)
    continuity = EdgeContinuity(
        max((f.continuity.gap for f in each), default=0.0),
        max((f.continuity.tangent_jump_deg for f in each), default=0.0),
        max((f.continuity.curvature_jump for f in each), default=0.0),
        0,
    )
    notes = tuple(dict.fromkeys(note for f in each for note in f.notes))
    return PatchMeasures(
        tol,
        deviation,
        "field",
        continuity,
        figures={TO_FIELD: deviation.to_reference, FROM_FIELD: deviation.from_reference},
        checks=(check_field_tangent_jump(continuity.tangent_jump_deg),),
        notes=(*collect_notes(field), *notes, "surfaces that cross were cut by each other, by the kernel's boolean"),
    )


def _compare_with_field(
    measures: PatchMeasures, field: Field, lo: Array, hi: Array, own: float, own_betti: Betti
) -> PatchMeasures:
    """The measures with the field's volume, and a note if grids count other Betti numbers than the solid's."""
    spacing = float((hi - lo).max()) / N_QUADRATURE_LINES
    volume, error = volume_quadrature.integrate_volume(field, lo, hi, spacing)
    check = Check(
        "volume",
        abs(volume - own),
        FIELD_VOLUME_RTOL * volume + error,
        f"volume {own:.6g} differs from the field's, {volume:.6g} within {error:.2g}",
    )
    counted = compute_betti_numbers(field, lo, hi, confirm=own_betti.__eq__, crossing=True)
    notes = measures.notes
    if counted != own_betti:
        words = (
            "do not settle on grids" if counted is None else f"are {counted} on grids, which acute wedges fall apart on"
        )
        notes = (*notes, f"Betti numbers {own_betti} are counted on the solid; those of the field {words}")
    figures = {**measures.figures, "volume of the field": volume, "uncertainty of that volume": error}
    return replace(measures, checks=(*measures.checks, check), notes=notes, figures=figures)


def _compare_with_sample(measures: PatchMeasures, field: Field, body: CadBody, own: float) -> PatchMeasures:
    """The measures with a check of the volume against an even sample of points in the body."""
    points = sample_solid(body.shape, N_SAMPLE_LINES, POINTS_PER_LINE)
    expected, error = estimate_fraction(field(points) < 0)
    check = Check(
        "volume",
        abs(own / body.volume - expected),
        error,
        f"it fills {own / body.volume:.3g} of {body.name}, but {expected:.3g} +- {error:.2g} of a sample",
    )
    return replace(measures, checks=(*measures.checks, check))


def _describe_creases(solids: tuple[Any, ...]) -> dict[str, float]:
    """Figures of the sharp edges, those at the sides of the domain included."""
    creases = measure_creases(solids)
    if not creases.count:
        return {}
    return {
        "creases": creases.count,
        "length of the creases": creases.length,
        "shortest crease": creases.shortest,
        "least wedge in degrees": creases.sharpest_deg,
    }


def _join_patches(fitted: list[FieldPatches]) -> Brep:
    """The patches of all operands, without the caps of their boxes."""
    parts = []
    for found in fitted:
        brep = found.fitted.brep
        on_splines = np.sort(np.concatenate([own for own, _ in spline_faces(brep)]))
        parts.append(drop_unused_geometry(select_faces(brep, on_splines)))
    return join_breps(parts)


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
