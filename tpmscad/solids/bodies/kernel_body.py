"""A body that the kernel holds: a CAD file's or a front end's solid, or a part of one within its skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.triangles.closed_mesh import SolidMesh, join_meshes
from tpmscad.kernel.body_import.body_brep import FreeFormBody
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.hollow_body import count_closed_cavities
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.results.certificate import PatchMeasures
from tpmscad.solids.cut import read_trimming_body
from tpmscad.solids.volume_samples import sample_body

MESH_ANGLE = 0.5
"""Radians: fineness of the triangles of bodies."""


class HasKernelSolid:
    """What a body has from the kernel's solid of it."""

    cad: CadBody

    @property
    def name(self) -> str:
        """The name in messages."""
        return self.cad.name

    @property
    def volume(self) -> float:
        """Volume in model units cubed."""
        return self.cad.volume

    @property
    def envelope(self) -> Envelope:
        """What void counts in."""
        return Envelope(self.name, self.volume, self.cad.shape)


@dataclass(frozen=True, eq=False)
class KernelBody(HasKernelSolid):
    """A valid, closed solid of the kernel, and its faces (TopoDS) that get no skin."""

    cad: CadBody
    open_faces: Sequence[Any] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be told of the file that it came from."""
        return self.cad.notes

    @property
    def tol(self) -> float:
        """By what its edges are off its faces, model units."""
        return self.cad.report.max_tolerance

    @property
    def face_labels(self) -> dict[int, str]:
        """Labels of the faces by the tags of the boundary representation."""
        return dict(enumerate(self.cad.face_labels))

    @property
    def is_open(self) -> list[bool]:
        """Whether each face gets no skin, in the kernel's order, which the tags of the boundary representation number."""
        return [any(face.IsSame(o) for o in self.open_faces) for face in faces_of(self.cad.shape)]

    def read(self, tol: float | None) -> FreeFormBody:
        """The boundary representation, with free-form faces if it has some; NotQuadric if that is impossible.

        tol: the tolerance of what it is cut with, of which its edges may be off its faces by a hundredth.
        """
        return read_trimming_body(self.cad, tol)

    def sample(self) -> Array:
        """An even sample (n, 3) of points in the body."""
        return sample_body(self.cad)

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in the body."""
        return contains_points(self.cad.shape, points)

    def mesh(self, deviation: float) -> SolidMesh:
        """Triangles of its faces, up to a distance from them."""
        return join_meshes(mesh_solids(self.cad.shape, deviation, MESH_ANGLE))

    def distances(self, points: Array) -> Array:
        """Distances (n,) of points (n, 3) from its boundary."""
        return SkinDepth(self.cad.shape, faces_of(self.cad.shape)).distances(points)

    def count_closed_cavities(self) -> int:
        """Cavities that it has of its own and that no open face bounds."""
        return count_closed_cavities(self.cad, self.open_faces)

    def join_measures(self, measures: PatchMeasures) -> PatchMeasures:
        """The measures of what is made of the body: its own faces are exact."""
        return measures
