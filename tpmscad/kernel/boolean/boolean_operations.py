"""Boolean operations of OCCT on whole solids.

They are general but slow, and OCCT may report success for a wrong result; callers check what they return.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound, to_build123d
from tpmscad.kernel.occt.exploration import solids_of
from tpmscad.kernel.occt.shape_pickling import Dismantled, pack_results, unpack_result


@dataclass(frozen=True, slots=True, eq=False)
class OcctSolids:
    """OCCT solids without a boundary representation, largest first. `shape` is the solid, or a compound of several.

    labels: of the faces of each solid, in the order of `faces_of`; none while a result is being made.
    """

    solids: tuple[Any, ...]
    labels: tuple[tuple[str, ...], ...] = ()

    @property
    def shape(self) -> Any:
        """The solid, or a compound if there are several."""
        return self.solids[0] if len(self.solids) == 1 else make_compound(self.solids)

    @property
    def solid(self) -> Any:
        """The build123d Solid, or a Compound if there are several, with a placement of its own."""
        return to_build123d(self.shape, len(self.solids))

    @property
    def n_solids(self) -> int:
        """Number of solids."""
        return len(self.solids)

    def dismantle(self) -> Dismantled:
        """The solids, and the function that puts them together again."""
        return self.solids, partial(_assemble_kernel_solids, self.labels)

    def __reduce__(self) -> Any:
        return unpack_result, pack_results([self.dismantle()])


def _assemble_kernel_solids(labels: tuple[tuple[str, ...], ...], shapes: Sequence[Any]) -> OcctSolids:
    return OcctSolids(tuple(map(convert.as_solid, shapes)), labels)


@contextmanager
def translate_occt_errors(operation: str, shape: Any, remedy: str = "") -> Iterator[None]:
    """Raise KernelError for any OCCT exception; in Python these have no common base class."""
    try:
        yield
    except Exception as error:
        if not type(error).__module__.startswith("OCP"):
            raise
        raise KernelError(operation, f"{type(error).__name__} {error}{remedy}", shape) from error


def intersect_solids(first: TopoDS_Shape, second: TopoDS_Shape) -> tuple[TopoDS_Solid, ...]:
    """Solids of the intersection, largest first; none if the solids are disjoint. Raises KernelError if OCCT fails."""
    return _run_boolean("intersection of lattice and body", BRepAlgoAPI_Common, first, second)


def subtract_solid(first: TopoDS_Shape, second: TopoDS_Shape) -> tuple[TopoDS_Solid, ...]:
    """Solids of the difference, largest first. Raises KernelError if OCCT fails."""
    return _run_boolean("difference of body and lattice", BRepAlgoAPI_Cut, first, second)


def _run_boolean(
    name: str, kind: Callable[[TopoDS_Shape, TopoDS_Shape], Any], first: TopoDS_Shape, second: TopoDS_Shape
) -> tuple[TopoDS_Solid, ...]:
    """Solids of one Boolean operation, largest first."""
    with translate_occt_errors(name, first):
        operation = kind(first, second)
        if not operation.IsDone() or operation.Shape().IsNull():
            raise KernelError(name, "the kernel's Boolean operation failed", first)
        return sort_by_volume(solids_of(operation.Shape()))


def merge_faces(shape: TopoDS_Shape) -> TopoDS_Shape:
    """The shape with neighbouring faces and edges made one where they lie on the same surface or curve."""
    with translate_occt_errors("merging faces", shape):
        unified = ShapeUpgrade_UnifySameDomain(shape, True, True, False)
        unified.Build()
        return unified.Shape()


def sort_by_volume(solids: Iterable[TopoDS_Solid]) -> tuple[TopoDS_Solid, ...]:
    """The solids, largest first."""
    measured = [(estimate_volume(solid), solid) for solid in solids]
    return tuple(solid for _, solid in sorted(measured, key=lambda pair: -pair[0]))


def estimate_volume(solid: TopoDS_Shape) -> float:
    """Volume of a solid or a closed shell by OCCT's default quadrature, accurate to about four digits; negative if inside out."""
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(solid, properties)
    return float(properties.Mass())


def modified_faces(operation: Any, face: TopoDS_Face) -> list[TopoDS_Face]:
    """Faces of the result that a Boolean operation made from a face of an argument.

    An unchanged face is its own image; a deleted face has none.
    """
    images = list(operation.Modified(face)) or ([] if operation.IsDeleted(face) else [face])
    return [convert.as_face(image) for image in images]
