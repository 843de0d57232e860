"""Pictures of files of triangles, drawn as they are: edges where neighbours bend are sharp, and open meshes show both sides."""

from __future__ import annotations

from pathlib import Path

from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.brep.triangles.smooth_groups import label_smooth_groups
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.beam_files import is_beam_path
from tpmscad.fields.data.mesh_shells import list_open_edges
from tpmscad.fields.data.triangle_mesh import TriangleMesh, read_triangles
from tpmscad.fields.kinds.beam_lattices import beams
from tpmscad.kernel.render.palette import SURFACE_COLOUR, numbered_colour
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.scene import Scene
from tpmscad.requests.study_options import PiecesPictureOptions
from tpmscad.studies.strut_triangles import triangulate_tree

PICTURE_DEVIATION = 0.02
"""In the greatest diameters of beams: of the triangles that are drawn."""

SHARP_DEGREES = 30.0
"""Bend between two triangles from which the side between them is drawn sharp."""


def read_drawn_triangles(path: Path) -> TriangleMesh:
    """The triangles of a file as they are; of one of beams, those of its beams and of the meshes beside them."""
    if not is_beam_path(path):
        return read_triangles(path)
    field = beams(path)
    mesh, _, _ = triangulate_tree(field, PICTURE_DEVIATION * float(field.diameters.max()))
    return TriangleMesh(mesh.points, mesh.triangles, path.name)


def draw_triangles(found: TriangleMesh, options: PiecesPictureOptions) -> bytes:
    """The bytes of the PNG picture of triangles; InvalidRequest for what needs the faces or names of a solid."""
    if options.color_by not in (None, "piece") or options.hide:
        what = "`hide` takes names" if options.hide else f"color_by={options.color_by!r} needs faces"
        raise InvalidRequest(f"{what}, which a file of triangles has not: leave it out, or give color_by='piece'")
    group = label_smooth_groups(found.vertices, found.triangles, SHARP_DEGREES)
    mesh = SolidMesh(found.vertices, found.triangles, group)
    colours = [SURFACE_COLOUR] * (int(group.max()) + 1)
    if options.color_by == "piece":
        for of_group, piece in dict(zip(group.tolist(), mesh.component.tolist(), strict=True)).items():
            colours[of_group] = numbered_colour(piece)
    closed = not len(list_open_edges(found.triangles))
    scene = Scene.of_mesh(mesh, colours, SURFACE_COLOUR, closed=closed)
    axes = options.view != "iso" or options.section is not None
    return draw_scene(scene, view=options.view, section=options.section, size=options.size, axes=axes)
