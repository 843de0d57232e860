"""Partition of a CAD body by a lattice with OCCT: solids that share the faces between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from OCP.BRepAlgoAPI import BRepAlgoAPI_Splitter
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad.errors import KernelError
from tpmscad.kernel.boolean.boolean_operations import modified_faces, sort_by_volume, translate_occt_errors
from tpmscad.kernel.measure.mass_properties import face_areas
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of, solids_of

OPERATION = "body split by the lattice"


@dataclass(frozen=True, slots=True, eq=False)
class SplitSolid:
    """A solid of the partition.

    sides: lattice faces on its boundary, as label and side (+1: the side the normal points to). areas: area of its boundary on
    each face of the body, by the face's index in the explorer's order.
    """

    solid: TopoDS_Solid
    sides: frozenset[tuple[str, int]]
    areas: Mapping[int, float]


def split_body(body: TopoDS_Shape, lattice: TopoDS_Shape, labels: Sequence[str]) -> tuple[SplitSolid, ...]:
    """Solids into which a lattice's solid divides the body, largest first; touching solids share faces, edges and vertices.

    `labels` are those of the lattice's faces in the explorer's order. Raises KernelError if OCCT fails.
    """
    with translate_occt_errors(OPERATION, body):
        splitter = BRepAlgoAPI_Splitter()
        splitter.SetArguments(convert.shape_list([body]))
        splitter.SetTools(
            convert.shape_list([lattice])
        )  # a single tool: OCCT does not intersect its faces with each other
        splitter.SetToFillHistory(True)
        splitter.Build()
        if not splitter.IsDone() or splitter.Shape().IsNull():
            raise KernelError(OPERATION, "the kernel's splitter failed", body)
        lattice_images: dict[ShapeKey, tuple[TopoDS_Face, str]] = {}
        body_images: dict[ShapeKey, int] = {}
        for face, label in zip(faces_of(lattice), labels, strict=True):
            for image in modified_faces(splitter, face):
                lattice_images.setdefault(ShapeKey(image), (image, label))
        for number, face in enumerate(faces_of(body)):
            for image in modified_faces(splitter, face):
                body_images.setdefault(ShapeKey(image), number)
        return tuple(
            _describe_solid(solid, lattice_images, body_images) for solid in sort_by_volume(solids_of(splitter.Shape()))
        )


def _describe_solid(
    solid: TopoDS_Solid, lattice_images: Mapping[ShapeKey, tuple[TopoDS_Face, str]], body_images: Mapping[ShapeKey, int]
) -> SplitSolid:
    """A solid of the partition with the lattice and body faces on its boundary."""
    sides, on_body = set(), []
    for face in faces_of(solid):
        key = ShapeKey(face)
        if key in lattice_images:
            image, label = lattice_images[key]
            sides.add((label, 1 if image.Orientation() != face.Orientation() else -1))
        if key in body_images:
            on_body.append((body_images[key], face))
    areas: dict[int, float] = {}
    for (number, _), area in zip(on_body, face_areas([face for _, face in on_body]), strict=True):
        areas[number] = areas.get(number, 0.0) + float(area)
    return SplitSolid(solid, frozenset(sides), areas)
