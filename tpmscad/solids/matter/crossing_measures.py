"""What is measured on the operands of a field whose level sets cross, and on the solid: volume, Betti numbers and creases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tpmscad._typing import Array
from tpmscad.brep.deviation import Deviation, combine_deviations
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import format_point
from tpmscad.fields.analysis import volume_quadrature
from tpmscad.fields.analysis.betti_numbers import Betti, compute_betti_numbers
from tpmscad.fields.analysis.crease_network import CreaseNetwork
from tpmscad.fields.analysis.exact_leaves import StrutLeaf
from tpmscad.fields.analysis.local_leaves import has_slope_bounds
from tpmscad.fields.analysis.local_measures import STANDARD_ERRORS, measure_locally
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.fields.field import Field
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.creases import SolidCreases
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.solid_topology import measure_topology
from tpmscad.results.certificate import PatchMeasures
from tpmscad.solids.matter.field_patches import N_QUADRATURE_LINES, FieldPatches
from tpmscad.solids.matter.patch_measures import FROM_FIELD, TO_FIELD, check_field_tangent_jump, check_volume
from tpmscad.solids.matter.strut_boundaries import divide_struts

CREASE_LENGTH_RTOL = 0.01
"""Relative difference of the solid's creases from the field's in length, above which it is noted: the solid's are off by about
the tolerance over the sine of the wedge. Creases that are missing are seen in their number, too."""


def measure_built(built: BrepSolids | OcctSolids) -> tuple[Betti, float]:
    """Betti numbers and volume of the solids, by their arrays or by the kernel."""
    if isinstance(built, BrepSolids):
        properties = measure_solid(built.brep, built.nesting.moments)
        return properties.betti or (0, 0, 0), properties.volume
    return measure_topology(built.solids).betti, sum(float(solid_moments(solid)[1]) for solid in built.solids)


def measure_operands(field: Field, tol: float, operands: Sequence[object]) -> PatchMeasures:
    """The worst measures of the operands, and the deviation of each; exact ones deviate by nothing, struts by what they say."""
    each = [operand.fitted for operand in operands if isinstance(operand, FieldPatches)]
    struts = [divide_struts(operand.struts, tol) for operand in operands if isinstance(operand, StrutLeaf)]
    thinner = max((found.deviation for found in struts), default=0.0)
    deviation = combine_deviations([Deviation(*4 * (thinner,)), *(f.deviation for f in each)])
    continuity = EdgeContinuity(
        max((f.continuity.gap for f in each), default=0.0),
        max((f.continuity.tangent_jump_deg for f in each), default=0.0),
        max((f.continuity.curvature_jump for f in each), default=0.0),
        0,
    )
    of_struts = [
        f"{found.thinned} ends of struts are thinner by up to {found.deviation:.2g} of their radius, within tol: they touch "
        "others, of another radius or outside their nodes, so that they are not told apart otherwise"
        for found in struts
        if found.thinned
    ]
    notes = dict.fromkeys((*collect_notes(field), *of_struts, *(note for f in each for note in f.notes)))
    return PatchMeasures(
        tol,
        deviation,
        "field",
        continuity,
        figures={TO_FIELD: deviation.to_reference, FROM_FIELD: deviation.from_reference, **_list_deviations(operands)},
        checks=(check_field_tangent_jump(continuity.tangent_jump_deg),),
        notes=tuple(notes),
    )


def _list_deviations(operands: Sequence[object]) -> dict[str, float]:
    """The greatest deviation of each fitted operand, by its place in the tree: of all its patches, of which parts are kept."""
    return {
        f"deviation of operand {number}": operand.fitted.deviation.max
        for number, operand in enumerate(operands, 1)
        if isinstance(operand, FieldPatches)
    }


def compare_with_field(
    measures: PatchMeasures, field: Field, lo: Array, hi: Array, own_betti: Betti, own: float
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


def describe_creases(creases: SolidCreases) -> dict[str, float]:
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
