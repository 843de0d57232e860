"""The faces of solids as a table, by which a face is found: label, kind of surface, area, and where it lies and faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.TopoDS import TopoDS_Solid

from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.measure.shape_sampling import interior_points
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.face_labels import label_outer_faces, name_body_face


@dataclass(frozen=True, slots=True)
class FaceEntry:
    """One face of a solid.

    Attributes
    ----------
    label : str
        Name of the group that it becomes when the solid is filled: "body 3", with its name in the file if it has one.
    kind : str
        Its surface: "plane", "cylinder" and so on; of a plane along an axis with the side that it faces, "plane X+".
    area : float
        Area, mm2.
    point : tuple of float
        A point inside it, mm.
    """

    label: str
    kind: str
    area: float
    point: tuple[float, float, float]

    def __str__(self) -> str:
        return f"{self.label}: {self.kind}, {self.area:.6g} mm2, about ({', '.join(f'{x:.4g}' for x in self.point)})"


def tabulate_solid_faces(
    solids: Sequence[TopoDS_Solid], names: Sequence[Sequence[str]]
) -> tuple[tuple[FaceEntry, ...], ...]:
    """The faces of each solid in the order of `faces_of`, with the names (empty if none are known) that their file gives them."""
    return tuple(_tabulate(solid, own) for solid, own in zip(solids, names or [()] * len(solids), strict=True))


def _tabulate(solid: TopoDS_Solid, names: Sequence[str]) -> tuple[FaceEntry, ...]:
    faces = faces_of(solid)
    kinds = [BRepAdaptor_Surface(face, False).GetType().name.removeprefix("GeomAbs_").lower() for face in faces]
    labels = map(name_body_face, range(len(faces)), names or [""] * len(faces))
    sides = [label.strip() for label in label_outer_faces(solid, "")]
    areas, points = face_moments(faces)[:, 0].tolist(), interior_points(faces).tolist()
    return tuple(
        FaceEntry(label, f"{kind} {side}".strip(), area, tuple(point))
        for label, kind, side, area, point in zip(labels, kinds, sides, areas, points, strict=True)
    )
