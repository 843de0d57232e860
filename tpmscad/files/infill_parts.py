"""The parts of a filled body in cells: the whole cell, and what the body leaves of the others, layer by layer.

Parts are made and checked as tasks that an executor runs. Their arguments are small: shapes travel in the kernel's binary
format, and what is made travels in STEP files in a folder that all processes see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.triangles.closed_mesh import SolidMesh, join_meshes
from tpmscad.brep.triangles.filled_mesh import choose_pieces
from tpmscad.errors import EmptyInfill, NotMet
from tpmscad.fields.field import Field, as_field
from tpmscad.files.checked_write import write_checked_solids
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.cell_regions import (
    are_translates,
    clear_diagonals,
    cut_region,
    describe_region,
)
from tpmscad.kernel.export.shape_file import sum_moments
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import shape_from_bytes, shape_to_bytes
from tpmscad.kernel.occt.exploration import faces_of, solids_of, vertices_of
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.kernel.step.joined_files import PartFile, find_part
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.certificate import Certificate
from tpmscad.results.joined_models import join_models
from tpmscad.results.loose_pieces import KEEP
from tpmscad.results.model import Model
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.filled_body import fill_body
from tpmscad.solids.matter.field_matter import build_field_matter
from tpmscad.solids.matter.lattice_block import build_block_over_box
from tpmscad.stage_timer import StageTimer

MESH_DEVIATION_CELLS, MESH_ANGLE = 0.01, 0.35
"""In cells, and radians: fineness of the triangles that tell which cells the body's faces may touch. Cells count as touched if
they are nearer to a triangle than this."""

FLAT_REL = 1e-9
"""Of its height: by how much triangles of a plane face, in which cells end, may lie off its plane."""

CLEAR_CELLS = 1e-4
"""In cells: distance that vertices and ends of the body keep from the sides of cells, where a corner allows it."""


@dataclass(frozen=True, slots=True, eq=False)
class CellLayers:
    """The cells of a body in the lattice's coordinates.

    low, cell (3,): corner of the cell (0, 0, 0), and size. axis: square to the layers. whole (k, 3): positions of whole cells.
    layers: what is left of the body without them, as (first cell of the layer along the axis, original, solids); `original` is
    the number of the layer of which this one is a translate, its own number if there is none.
    """

    low: Array
    cell: Array
    axis: int
    whole: IntArray
    layers: tuple[tuple[int, int, tuple[Any, ...]], ...]

    @property
    def volume(self) -> float:
        """Volume of whole cells and of what is left of the others together."""
        rest = measure_volume([solid for *_, solids in self.layers for solid in solids])
        return len(self.whole) * float(np.prod(self.cell)) + rest


def measure_volume(shapes: Sequence[Any]) -> float:
    """Volume of solids, mm3."""
    return float(sum(face_moments(faces_of(shape))[:, 1].sum() for shape in shapes))


def choose_corner(shapes: Sequence[Any], cell: Array, corners: Array) -> Array:
    """Of possible lower corners of a cell (k, 3), the one whose cells have their sides farthest from vertices and ends of shapes.

    Corners and cells may be given across z only, (k, 2). The first one is taken if it keeps CLEAR_CELLS.
    """
    marks = np.concatenate(
        [np.concatenate([vertices_of(shape), *(c[None] for c in enclosing_box(shape))]) for shape in shapes]
    )
    off = (marks[None, :, : len(cell)] - corners[:, None]) / cell
    clearance = np.abs(off - np.rint(off)).min(axis=(1, 2))
    return np.asarray(corners[0 if clearance[0] >= CLEAR_CELLS else int(np.argmax(clearance))])


def divide_body(shapes: Sequence[Any], low: Array, cell: Array, slab: int) -> CellLayers:
    """The cells of a body of disjoint solids, in layers of `slab` cells along the axis that has the most equal layers."""
    mesh = _mesh_body(shapes, cell)
    choice = choose_pieces(cell, low[None], (low + cell)[None], mesh, margin=2 * MESH_DEVIATION_CELLS)
    inside, size = choice.whole[..., 0], choice.whole.shape
    axis = min((2, 1, 0), key=lambda a: len({layer.tobytes() for layer in np.moveaxis(inside, a, 0)}))
    u, v = (a for a in range(3) if a != axis)
    whole: list[IntArray] = []
    layers: list[tuple[int, int, tuple[Any, ...]]] = []
    known: list[tuple[int, BoolArray, Array]] = []
    for first in range(0, size[axis], slab):
        count = min(slab, size[axis] - first)
        slab_cells: BoolArray = np.moveaxis(inside, axis, 0)[first : first + count]
        mask = clear_diagonals(np.logical_and.reduce(slab_cells))
        at = np.repeat(np.argwhere(mask), count, axis=0)
        positions = np.empty((len(at), 3), np.int64)
        positions[:, [u, v]] = at
        positions[:, axis] = first + np.tile(np.arange(count), int(mask.sum()))
        whole.append(positions + choice.origin)
        corner = low + cell * choice.origin
        corner[axis] += first * cell[axis]
        solids = cut_region(shapes, (u, v, axis), mask, corner, cell, count * float(cell[axis]))
        if not solids:
            continue
        number, description = len(layers), describe_region(solids)
        shift = np.zeros(3)
        for original, of_mask, of_original in known:
            shift[axis] = (first - layers[original][0]) * cell[axis]
            if np.array_equal(mask, of_mask) and are_translates(of_original, description, shift):
                number = original
                break
        else:
            known.append((number, mask, description))
        layers.append((first, number, solids))
    return CellLayers(low, cell, axis, np.concatenate(whole), tuple(layers))


def divide_body_in_columns(shapes: Sequence[Any], corners: Array, rectangle: tuple[float, float]) -> CellLayers:
    """The cells of a body in one layer along z, where a whole cell reaches from the body's least z to its greatest.

    corners (k, 2), rectangle: possible lower corners of a cell, and its size, across z. A cell is whole if it ends in planes.
    """
    mesh = _mesh_body(shapes, np.array(rectangle))
    ends = float(mesh.points[:, 2].min()), float(mesh.points[:, 2].max())
    cell = np.array([*rectangle, ends[1] - ends[0]])
    low = np.append(choose_corner(shapes, cell[:2], corners), ends[0])
    # without the planes in which whole cells end: moved away, with the other triangles that reach into them
    points = mesh.points.copy()
    for end, by in zip(ends, (-cell[2], cell[2]), strict=True):
        points[np.abs(mesh.points[:, 2] - end) <= FLAT_REL * cell[2], 2] += by
    opened = replace(mesh, points=points)
    choice = choose_pieces(cell, low[None], (low + cell)[None], opened, margin=2 * MESH_DEVIATION_CELLS)
    mask = clear_diagonals(choice.whole[:, :, -int(choice.origin[2]), 0])
    at = np.argwhere(mask)
    whole = np.column_stack([at + choice.origin[:2], np.zeros(len(at), np.int64)])
    beyond = low + cell * (*choice.origin[:2], -1)  # no plane of the body is one of the layer that is cut
    solids = cut_region(shapes, (0, 1, 2), mask, beyond, cell, 3 * float(cell[2]))
    return CellLayers(low, cell, 2, whole, ((0, 0, solids),) if solids else ())


def _mesh_body(shapes: Sequence[Any], cell: Array) -> SolidMesh:
    """Triangles of a body, fine enough to tell which cells its faces may touch."""
    deviation = MESH_DEVIATION_CELLS * float(cell.min())
    return join_meshes([mesh for shape in shapes for mesh in mesh_solids(shape, deviation, MESH_ANGLE)])


@dataclass(frozen=True, slots=True, eq=False)
class PartTask:
    """A part to be made: solids as bytes, the lattice or the field that fills them, the box that a lattice has to cover."""

    name: str
    shape: bytes
    filling: LatticeRequest | Field
    tol: float
    box: tuple[Array, Array]
    schema: str
    path: Path


@dataclass(frozen=True, slots=True)
class MadePart:
    """A part in its file, with its certificates, one for each solid that was filled, and its numbers of solids and faces."""

    file: PartFile
    certificates: tuple[Certificate, ...]
    solids: int
    faces: int


def plan_part(
    name: str, solids: Sequence[Any], filling: LatticeRequest | Field, tol: float, schema: str, path: Path
) -> PartTask:
    """The task of filling solids with a lattice, or with a field within a tolerance."""
    shape = make_compound(solids)
    return PartTask(name, shape_to_bytes(shape), filling, tol, enclosing_box(shape), schema, path)


def make_part(task: PartTask) -> MadePart | None:
    """Fill the solids of a task and write them as one checked file; None if no lattice lies in them. NotMet as `infill`."""
    stages, filling = StageTimer(False), task.filling
    block = None
    if isinstance(filling, LatticeRequest):
        block = build_block_over_box(filling, np.eye(3), *task.box, stages)
    models: list[Model] = []
    for number, solid in enumerate(solids_of(shape_from_bytes(task.shape)), 1):
        body = replace(read_body(solid), name=f"{task.name}, solid {number}")
        try:
            matter = block or build_field_matter(as_field(filling), body, task.tol, stages)
            models.append(fill_body(KernelBody(body), matter, None, KEEP, stages, name=task.name))
        except EmptyInfill:
            continue
    if not models:
        return None
    for model in models:
        if not model.certificate.met:
            raise NotMet(
                f"{task.name} misses the request: {'; '.join(model.certificate.shortfalls)}", model.certificate
            )
    return write_models(models, task.path, task.schema, task.name)


def write_models(models: Sequence[Model], path: Path, schema: str, name: str) -> MadePart:
    """Write models as one product of one file."""
    mass = sum_moments(face_moments([face for model in models for face in faces_of(model.built.shape)]))
    named = {f"{name}, solid {number}": model for number, model in enumerate(models, 1)}
    whole = models[0] if len(models) == 1 else join_models(name, named, {}, "the solids of a layer")
    whole.export_step(path, schema=schema)
    certificates = tuple(model.certificate for model in models)
    return MadePart(
        find_part(path, mass),
        certificates,
        sum(model.built.n_solids for model in models),
        sum(certificate.n_faces for certificate in certificates),
    )


def write_shapes(solids: Sequence[Any], path: Path, schema: str, name: str, label: str) -> MadePart:
    """Write kernel solids as one product of one file, all faces with one label."""
    faces = [faces_of(solid) for solid in solids]
    mass = sum_moments(face_moments([face for of in faces for face in of]))
    named = [NamedSolid(name, solid, (label,) * len(of)) for solid, of in zip(solids, faces, strict=True)]
    write_checked_solids(named, path, schema=schema, name=name, volume=mass.volume)
    return MadePart(find_part(path, mass), (), len(solids), sum(map(len, faces)))
