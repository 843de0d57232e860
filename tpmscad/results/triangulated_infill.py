"""The triangles of a filled body that was made without its solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoxCorners, IntArray, triple
from tpmscad.api.public_calls import validate_method_options
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.file_suffixes import TRIANGLE_SUFFIXES, TRIANGLE_WRITERS, load_writer
from tpmscad.kernel.export.mesh_parts import MeshPart
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.scene import Scene
from tpmscad.kernel.step.face_labels import find_label_colour
from tpmscad.requests.study_options import TrianglesFileOptions, TrianglesPictureOptions
from tpmscad.result_display import fit_lines
from tpmscad.results.result_summary import count_pieces, format_size, round_corners

LABELS = ("surface", "body")
"""Names of the groups of triangles: those of face 0, and all others."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TriangulatedInfill:
    """A closed triangle mesh of a filled body.

    Attributes
    ----------
    name : str
        Name of the part, as files store it.
    points : ndarray (n, 3)
        Corners of the triangles, mm.
    triangles : ndarray of int (m, 3)
        Corners of each triangle, counter-clockwise from outside.
    face : ndarray of int (m,)
        0 for triangles of the lattice, 1 and more for those of the body's faces, its skin, and what is kept or cleared.
    deviation : float
        Greatest distance of the triangles from the exact patches and faces, mm, as measured.
    whole_cells, cut_cells : int
        How many cells the pieces make up that lie wholly in the body, copies of those of one cell but for a graded thickness, and
        the pieces that its boundary may touch.
    notes : tuple of str
        What was left out.
    """

    name: str
    points: Array
    triangles: IntArray
    face: IntArray
    deviation: float
    whole_cells: int
    cut_cells: int
    notes: tuple[str, ...] = ()

    @property
    def mesh(self) -> SolidMesh:
        """The triangles as the package's value for closed meshes."""
        return SolidMesh(self.points, self.triangles, self.face)

    @property
    def volume(self) -> float:
        """Volume enclosed, mm3."""
        return self.mesh.volume

    @property
    def area(self) -> float:
        """Area of all triangles, mm2."""
        return self.mesh.area

    @property
    def center_of_mass(self) -> tuple[float, float, float]:
        """Centre of mass of the solid enclosed, mm."""
        return triple(self.mesh.center_of_mass.tolist())

    @property
    def bounding_box(self) -> BoxCorners:
        """Opposite corners of the box around the points, mm."""
        return (tuple(self.points.min(axis=0).tolist()), tuple(self.points.max(axis=0).tolist()))

    @property
    def n_pieces(self) -> int:
        """Number of pieces that do not touch; components of negative volume are voids."""
        mesh = self.mesh
        return int((mesh.measure_components(mesh.component) > 0).sum())

    @validate_method_options(TrianglesFileOptions, 'write("part.stl")')
    def write(self, options: TrianglesFileOptions) -> None:
        """Write the triangles to a file, by its suffix; STL and 3MF are written in pieces.

        Raises
        ------
        InvalidRequest
            If the suffix is another one, or the folder does not exist.
        KernelError
            If the file does not read back closed and with the same volume.

        Examples
        --------
        >>> tpmscad.infill_triangles(body, "gyroid", cell=1, thickness=0.12).write("part.3mf")  # doctest: +SKIP
        """
        target = validate_output_path(options.path, TRIANGLE_SUFFIXES)
        groups = tuple((label, find_label_colour(label)) for label in LABELS)
        group = np.minimum(self.face, 1)
        load_writer(TRIANGLE_WRITERS, target.suffix.lower())(
            [MeshPart(self.name, self.mesh, group, groups)], target, self.name
        )

    @validate_method_options(TrianglesPictureOptions, 'render("part.png", section="z")')
    def render(self, options: TrianglesPictureOptions) -> None:
        """Draw the triangles as a PNG picture, without a display.

        Examples
        --------
        >>> part = tpmscad.infill_triangles(body, "gyroid", cell=1, thickness=0.12, deviation=0.03)  # doctest: +SKIP
        >>> part.render("part.png", section="z")  # doctest: +SKIP
        """
        target = validate_output_path(options.path, (".png",))
        lattice, body = map(find_label_colour, LABELS)
        scene = Scene.of_mesh(self.mesh, [lattice, *[body] * int(self.face.max())], body)
        axes = options.view != "iso" or options.section is not None
        picture = draw_scene(scene, view=options.view, section=options.section, size=options.size, axes=axes)
        with atomic_write(target) as aside:
            aside.write_bytes(picture)

    def __repr__(self) -> str:
        (x0, y0, z0), (x1, y1, z1) = round_corners(self.bounding_box)
        size, pieces = format_size(self.bounding_box), count_pieces(self.n_pieces)
        return fit_lines(
            [
                f"{self.name}: {size} mm, {pieces}, {len(self.triangles)} triangles",
                f"  box     ({x0:.6g}, {y0:.6g}, {z0:.6g}) to ({x1:.6g}, {y1:.6g}, {z1:.6g})",
                f"  volume  {self.volume:.7g}, area {self.area:.7g}, within {self.deviation:g} mm of the exact faces",
                f"  cells   {self.whole_cells} whole, {self.cut_cells} cut by the body",
                *(f"  note    {note}" for note in self.notes),
            ],
            ".notes",
        )
