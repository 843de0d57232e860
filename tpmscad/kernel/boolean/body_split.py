"""A body split by a lattice, by the kernel: solids that share the faces between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from OCP.BRepAlgoAPI import BRepAlgoAPI_Splitter
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad.errors import KernelError
from tpmscad.kernel.boolean.boolean_operations import sort_by_volume, translate_occt_errors
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.measure.shape_sampling import faces_of
from tpmscad.kernel.occt import convert
from tpmscad.kernel.step.step_reader import solids_of

OPERATION = "body split by the lattice"

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, eq=False)
class SplitSolid:
    """A solid of the split body.

    sides: on which lattice faces it lies, by label and side (+1: where the normal points). areas: on which faces of the body, by
    their numbers in the explorer's order, and how much of each.
    """

    solid: TopoDS_Solid
    sides: frozenset[tuple[str, int]]
    areas: Mapping[int, float]


class ShapeTable(Generic[Value]):
    """Values by shapes, whichever way these are turned."""

    def __init__(self) -> None:
        self._buckets: dict[int, list[tuple[TopoDS_Shape, Value]]] = {}

    def put(self, shape: TopoDS_Shape, value: Value) -> None:
        self._buckets.setdefault(hash(shape), []).append((shape, value))

    def get(self, shape: TopoDS_Shape) -> tuple[TopoDS_Shape, Value] | None:
        return next((entry for entry in self._buckets.get(hash(shape), ()) if entry[0].IsSame(shape)), None)


def split_body(body: TopoDS_Shape, lattice: TopoDS_Shape, labels: Sequence[str]) -> tuple[SplitSolid, ...]:
    """The cells that a lattice's solid splits a body into, largest first; cells that touch share faces, edges and vertices.

    labels: of the lattice's faces, in the explorer's order.
    """
    with translate_occt_errors(OPERATION, body):
        splitter = BRepAlgoAPI_Splitter()
        splitter.SetArguments(convert.shape_list([body]))
        splitter.SetTools(convert.shape_list([lattice]))  # as one: the kernel does not look for crossings within it
        splitter.SetToFillHistory(True)
        splitter.Build()
        if not splitter.IsDone() or splitter.Shape().IsNull():
            raise KernelError(OPERATION, "the kernel's splitter failed", body)
        of_lattice, of_body = ShapeTable[str](), ShapeTable[int]()
        for face, label in zip(faces_of(lattice), labels, strict=True):
            for image in _modified_shapes(splitter, face):
                of_lattice.put(image, label)
        for number, face in enumerate(faces_of(body)):
            for image in _modified_shapes(splitter, face):
                of_body.put(image, number)
        return tuple(
            _describe_solid(solid, of_lattice, of_body) for solid in sort_by_volume(solids_of(splitter.Shape()))
        )


def _modified_shapes(splitter: BRepAlgoAPI_Splitter, face: TopoDS_Face) -> Iterable[TopoDS_Shape]:
    return list(splitter.Modified(face)) or ([] if splitter.IsDeleted(face) else [face])


def _describe_solid(solid: TopoDS_Solid, of_lattice: ShapeTable[str], of_body: ShapeTable[int]) -> SplitSolid:
    sides, on_body = set(), []
    for face in faces_of(solid):
        if (found := of_lattice.get(face)) is not None:
            image, label = found
            sides.add((label, 1 if image.Orientation() != face.Orientation() else -1))
        if (owner := of_body.get(face)) is not None:
            on_body.append((owner[1], face))
    areas: dict[int, float] = {}
    for (number, _), moments in zip(on_body, face_moments([face for _, face in on_body]), strict=True):
        areas[number] = areas.get(number, 0.0) + float(moments[0])
    return SplitSolid(solid, frozenset(sides), areas)
