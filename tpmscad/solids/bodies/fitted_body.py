"""Bodies that a field bounds: its level set as patches, fitted once, which a lattice is cut by.

A triangle mesh is such a body, by the field of its distance. Its patches are fitted no closer than a
fraction of what that field is off from the triangles, and their distance from the triangles is measured in both directions, on
points of both surfaces. A field of exact planes, spheres and cylinders that the kernel combines becomes a CAD body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, BoxCorners
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.patch_nodes import measure_patch_distances
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.brep.triangles.closed_mesh import SolidMesh, join_meshes
from tpmscad.errors import CrossingSurfaces, InvalidRequest, KernelError, LevelSetError
from tpmscad.fields.analysis.solid_bounds import bound_solid
from tpmscad.fields.data.beam_files import is_beam_path
from tpmscad.fields.data.field_notes import DEFAULT_TOL_SPACINGS, find_least_spacing
from tpmscad.fields.data.triangle_distance import build_triangle_tree, sample_triangles
from tpmscad.fields.data.triangle_mesh import is_mesh_object, is_mesh_path
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.beam_lattices import beams
from tpmscad.fields.kinds.data_domains import settle_data
from tpmscad.fields.kinds.triangle_meshes import MeshField, mesh, resample_mesh
from tpmscad.kernel.body_import.body_brep import FreeFormBody
from tpmscad.kernel.body_import.cad_body import CadBody, read_body
from tpmscad.kernel.build.primitive_solids import PrimitiveRegion
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.measure.shape_report import ShapeReport
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.results.certificate import Check, PatchMeasures
from tpmscad.solids.bodies.kernel_body import MESH_ANGLE, HasKernelSolid
from tpmscad.solids.matter.crossing_fields import CAP, SURFACE, combine_field_solids, contains_in_box
from tpmscad.solids.matter.field_patches import fit_field_patches
from tpmscad.solids.matter.patch_measures import FROM_FIELD, TO_FIELD, measure_field_patches
from tpmscad.solids.volume_samples import sample_box
from tpmscad.stage_timer import StageTimer

BOX_MARGIN_FRACTION = 0.03
"""Fraction of the extent by which the box of a formula reaches beyond the bounds that were found for its solid."""

MESH_TOL_FRACTION = 0.25
"""Of the greatest distance of a mesh's triangles from its field: the least tolerance of the patches. A fit deviates by a
thirtieth of its tolerance in the root mean square: the patches of a scanned animal follow its triangles as well as with a tenth
of this, in a tenth of the time."""

OTHER_SPACINGS = (2**-0.5, 2**0.5)
"""Of the spacing that was chosen for a mesh: others that are tried where its surface, which turns within a sample at concave
edges, is not fitted. Of five spacings from .7 to 1.4 two were fitted for two balls that overlap, of which the mesh is one."""

MEASURED_POINTS = 20_000
"""Points of each surface at which its distance from the other one is measured."""

MESH_DEVIATION_TOLS = 0.1
"""Fineness of the triangles of a body's patches, in tolerances of the fit."""

BODY = "body"
"""Tag of the faces of a body."""


@dataclass(frozen=True, eq=False)
class FittedBody(HasKernelSolid):
    """The solid of a field in the box [low, high] as patches, with what was measured on them; `cad` is the kernel's solid."""

    field: Field
    low: Array
    high: Array
    built: BrepSolids
    measures: PatchMeasures
    cad: CadBody

    @property
    def notes(self) -> tuple[str, ...]:
        """None of its own: its measures have some."""
        return ()

    @property
    def tol(self) -> float:
        """The tolerance of its patches, model units."""
        return self.measures.tol

    @property
    def face_labels(self) -> dict[int, str]:
        """The tags of its faces by their numbers."""
        brep = self.built.brep
        return {number: brep.tags[number] for number in np.unique(brep.faces.tag).tolist()}

    @property
    def is_open(self) -> list[bool]:
        """Every face carries the skin: (number of tags,)."""
        return [False] * len(self.built.brep.tags)

    def read(self, tol: float | None) -> FreeFormBody:
        """The boundary representation, whatever the tolerance of what it is cut with."""
        return FreeFormBody(self.built.brep, {})

    def sample(self) -> Array:
        """An even sample (n, 3) of points in the body."""
        points = sample_box(*self.cad.box)
        return points[self.contains(points)]

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in the body, by its field and the box that it was fitted in."""
        return contains_in_box(self.field, self.low, self.high, points)

    def mesh(self, deviation: float) -> SolidMesh:
        """Triangles of the patches, up to a distance from them."""
        return join_meshes(mesh_solids(self.built.shape, deviation, MESH_ANGLE))

    def distances(self, points: Array) -> Array:
        """Distances (n,) of points (n, 3) from the patches and caps."""
        brep = self.built.brep
        best = measure_patch_distances(brep, points)
        if CAP in brep.tags and len(
            brep.faces_with_tag(CAP)
        ):  # beyond a cap's rim the level set is nearer than its plane
            best = np.minimum(best, np.minimum(points - self.low, self.high - points).min(axis=1))
        return best

    def count_closed_cavities(self) -> int:
        """Cavities that it has of its own."""
        return self.built.n_cavities

    def join_measures(self, measures: PatchMeasures) -> PatchMeasures:
        """The measures of what is made of the body, and its own: each against its own tolerance."""
        own = self.measures
        figures = {
            "deviation of the lattice from its surface": measures.deviation.max,
            "deviation of the body from its field": own.deviation.to_reference,
            "deviation of the field from the body": own.deviation.from_reference,
        }
        figures |= {name: value for name, value in own.figures.items() if name not in (TO_FIELD, FROM_FIELD)}
        largest = own.deviation if own.deviation.max > measures.deviation.max else measures.deviation
        continuity = replace(
            measures.continuity,
            gap=max(measures.continuity.gap, own.continuity.gap),
            tangent_jump_deg=max(measures.continuity.tangent_jump_deg, own.continuity.tangent_jump_deg),
            curvature_jump=max(measures.continuity.curvature_jump, own.continuity.curvature_jump),
        )
        return replace(
            measures,
            tol=max(measures.tol, own.tol),
            deviation=replace(largest, rms=max(measures.deviation.rms, own.deviation.rms)),
            reference=f"{measures.reference}, and {self.name} as body",
            continuity=continuity,
            figures={**measures.figures, **figures},
            checks=(
                *measures.checks,
                Check("deviation of the lattice", measures.deviation.max, measures.tol),
                *own.checks,
            ),
            notes=(*measures.notes, *own.notes),
        )


def resolve_field(source: Any) -> Field | None:
    """The field of a body that is a field, a mesh, or the path of one; None for CAD bodies and primitive regions."""
    if isinstance(source, Field):
        return None if isinstance(source, PrimitiveRegion) else source
    if is_beam_path(source):
        return beams(source)
    return mesh(source) if is_mesh_path(source) or is_mesh_object(source) else None


def find_field_box(field: Field, box: BoxCorners | None, name: str) -> tuple[Array, Array]:
    """The box in which the solid of a field is fitted: as given, the domain of its data, or found; InvalidRequest without."""
    given = box if box is not None else field.domain
    if given is not None:
        low, high = (np.array(corner, float) for corner in given)
        return low, high
    found = bound_solid(field)
    if found is None:
        raise InvalidRequest(
            f"no bounds of {name} are found, within which all of it is solid: give two corners as `box`, or its "
            "intersection with a box or a ball"
        )
    margin = BOX_MARGIN_FRACTION * float((found[1] - found[0]).max())
    return found[0] - margin, found[1] + margin


def fit_field_body(
    field: Field, box: BoxCorners | None, tol: float, stages: StageTimer, *, is_default: bool
) -> FittedBody | CadBody:
    """The body of a field, as patches within `tol` of its level set, or of a CAD body if all of its faces are exact.

    A mesh is followed no closer than its field follows the triangles, and data, where `tol` `is_default`, not to the last digit.
    """
    name = field.mesh.name if isinstance(field, MeshField) else "the field"
    field, low, high, told = settle_data(field, *find_field_box(field, box, name))
    try:
        body = _fit_body(field, low, high, tol, stages, name, is_default)
    except LevelSetError:
        if not isinstance(field, MeshField) or field.is_spacing_given:
            raise
        body = _fit_resampled(field, box, tol, stages, is_default)
    if not told or not isinstance(body, FittedBody):
        return body
    return replace(body, measures=replace(body.measures, notes=(*body.measures.notes, *told)))


def _fit_resampled(
    field: MeshField, box: BoxCorners | None, tol: float, stages: StageTimer, is_default: bool
) -> FittedBody | CadBody:
    """The body of a mesh at the first other spacing at which it is fitted; the last error if there is none."""

    def fit(factor: float) -> FittedBody | CadBody:
        with stages("read"):
            other = resample_mesh(field, factor)
        low, high = find_field_box(other, box, other.mesh.name)
        return _fit_body(other, low, high, tol, stages, other.mesh.name, is_default)

    *first, last = OTHER_SPACINGS
    for factor in first:
        try:
            return fit(factor)
        except LevelSetError:
            continue
    return fit(last)


def _fit_body(
    field: Field, low: Array, high: Array, tol: float, stages: StageTimer, name: str, is_default: bool
) -> FittedBody | CadBody:
    """The body of a field in a box."""
    spacing = find_least_spacing(field) if is_default else None
    closest = tol if spacing is None else max(tol, DEFAULT_TOL_SPACINGS * spacing)
    if isinstance(field, MeshField):
        closest = max(closest, MESH_TOL_FRACTION * field.max_deviation)
    try:
        if has_meeting_quadrics(field, low, high, closest):
            return _combine(field, low, high, closest, stages, name)
        found = fit_field_patches(field, low, high, closest, stages)
    except CrossingSurfaces:
        return _combine(field, low, high, closest, stages, name)
    except LevelSetError as error:
        if "no surface inside the box" in str(error):
            raise InvalidRequest(
                f"no part of the surface of {name} lies in its box: check the field's sign and `box`"
            ) from error
        remedy = (
            "; a larger `tol`, or another `spacing` of fields.mesh, makes it smoother"
            if isinstance(field, MeshField)
            else ""
        )
        raise LevelSetError(f"the body, {name}: {error}{remedy}") from error
    if not len(found.fitted.brep.faces):
        raise InvalidRequest(f"nothing of {name} is solid in its box: check the field's sign and `box`")
    with stages("build"):
        built = build_solids(_tag_as_body(found.fitted.brep), found.moments)
        if not is_brep_valid(built.brep, built.known_faces):
            raise KernelError("body", f"the kernel's check rejects the patches of {name}")
    return _make_body(field, low, high, name, built, measure_field_patches(found))


def _combine(field: Field, low: Array, high: Array, tol: float, stages: StageTimer, name: str) -> FittedBody | CadBody:
    """The body of a field whose level sets cross."""
    combined, _ = combine_field_solids(field, low, high, tol, stages)
    if not isinstance(combined.built, BrepSolids):
        solids = combined.built.solids
        if len(solids) > 1:
            raise InvalidRequest(f"{name} is {len(solids)} solids: fill one at a time, each with a `box` around it")
        return replace(read_body(solids[0]), name=name)
    return _make_body(field, low, high, name, build_solids(_tag_as_body(combined.built.brep)), combined.measures)


def _tag_as_body(brep: Brep) -> Brep:
    """The boundary representation with the level set tagged as the body's; caps in the sides of the box stay caps."""
    return replace(brep, tags=tuple(BODY if tag == SURFACE else tag for tag in brep.tags))


def _make_body(field: Field, lo: Array, hi: Array, name: str, built: BrepSolids, measures: PatchMeasures) -> FittedBody:
    """The body of patches, with the distances from the triangles of a mesh."""
    brep, properties = built.brep, measure_solid(built.brep, built.nesting.moments)
    low, high = true_bounds(brep)
    report = ShapeReport(
        solids=built.n_solids,
        shells=len(built.nesting.volume),
        faces=len(brep.faces),
        edges=len(brep.edges),
        valid=True,
        closed=properties.closed,
        outward=True,
        volume=properties.volume,
        area=properties.area,
        centroid=properties.centroid,
        bounds=(tuple(low.tolist()), tuple(high.tolist())),
        volumes=tuple(piece.volume for piece in properties.pieces),
        max_tolerance=float(brep.edges.deviation.max(initial=0.0)),
    )
    body = FittedBody(field, lo, hi, built, measures, CadBody(built.shape, report, name))
    return replace(body, measures=_measure_distances(body)) if isinstance(field, MeshField) else body


def _measure_distances(body: FittedBody) -> PatchMeasures:
    """The measures with the distances between the patches and the triangles of the mesh, both ways."""
    assert isinstance(body.field, MeshField)
    source, made = body.field.mesh, body.mesh(MESH_DEVIATION_TOLS * body.measures.tol)
    pairs = (
        (made.points[made.triangles], source.vertices, source.triangles),
        (source.corners, made.points, made.triangles),
    )
    there, back = (
        build_triangle_tree(vertices, triangles).distances(sample_triangles(corners, MEASURED_POINTS)[0])
        for corners, vertices, triangles in pairs
    )
    figures = {
        "distance of the body from the triangles": float(there.max()),
        "distance of the triangles from the body": float(back.max()),
        "root mean square of both": float(np.sqrt(np.mean(np.concatenate([there, back]) ** 2))),
    }
    note = (
        f"{body.name}: the body lies within {there.max():.3g} of the triangles and these within {back.max():.3g} of it, "
        f"{figures['root mean square of both']:.2g} in the root mean square, measured at {MEASURED_POINTS} points of each"
    )
    return replace(body.measures, figures={**body.measures.figures, **figures}, notes=(*body.measures.notes, note))
