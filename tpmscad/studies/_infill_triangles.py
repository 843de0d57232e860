"""Triangles of a filled body without its solid: pieces of one cell are repeated, and only what the body cuts is computed."""

from __future__ import annotations

import numpy as np

from tpmscad.api.public_calls import validate_options
from tpmscad.brep.triangles.closed_mesh import SolidMesh, load_manifold
from tpmscad.brep.triangles.filled_mesh import FIRST_OF_BODY
from tpmscad.errors import InvalidRequest
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.requests.named_matter import resolve_named_matter
from tpmscad.requests.study_options import InfillTrianglesOptions
from tpmscad.results.loose_pieces import select_pieces
from tpmscad.results.triangulated_infill import TriangulatedInfill
from tpmscad.solids.tiled_body import TiledBody, read_tiled_body
from tpmscad.stage_timer import StageTimer
from tpmscad.studies.lattice_triangles import triangulate_filling, triangulate_parts

DEFAULT_DEVIATION_CELLS = 0.01
"""In cells: default deviation of the triangles."""


@validate_options(
    InfillTrianglesOptions, 'infill_triangles(body, "gyroid", cell=1, thickness=0.12, deviation=0.01).write("part.stl")'
)
def infill_triangles(options: InfillTrianglesOptions) -> TriangulatedInfill:
    """Triangulate a body filled with a lattice, without making its solid.

    The triangles are closed and follow the exact patches, and the body's faces, within `deviation`. What lies wholly in the body
    is copied, with the local thickness of a graded wall; what the body's boundary may touch is cut by it. 18,000 cells take half
    a minute. A field is triangulated as a whole; its default deviation is `tol`.

    Returns
    -------
    TriangulatedInfill
        Points and triangles with volume, area, centre of mass and pieces; `write` stores them as STL, 3MF or GLB, `render` draws
        them.

    Raises
    ------
    InvalidRequest
        If an argument is not understood, a map or a graded skeletal solid is given, what is kept is a loose piece that would be
        left out, or manifold3d is missing.
    OutOfMemory
        If the triangles would not fit into the memory of the machine.
    KernelError
        If the kernel cannot triangulate the body.

    Examples
    --------
    >>> part = tpmscad.infill_triangles("stem.step", "gyroid", cell=1, thickness=0.12, deviation=0.01)  # doctest: +SKIP
    >>> part.write("stem.stl")  # doctest: +SKIP
    >>> part.render("stem.png", section="y")  # doctest: +SKIP
    """
    load_manifold()
    options, stages = resolve_named_matter(options), StageTimer(options.progress)
    tiled = read_tiled_body(options, "export the solid, infill(...).export(path)", stages, as_triangles=True)
    deviation = options.deviation or _choose_deviation(tiled, options.tol)
    with stages("triangulate"):
        parts = triangulate_parts(tiled, options.skin, deviation)
    with stages("fit"):
        filling = triangulate_filling(tiled, parts, deviation)
        filling.require_memory(deviation)
    with stages("cut"):
        filled = filling.fill(parts)
        filled, notes = _drop_loose_pieces(filled, options.loose, parts.first_kept + FIRST_OF_BODY)
    return TriangulatedInfill(
        tiled.name,
        filled.points @ tiled.turn.T,
        filled.triangles,
        filled.face,
        max(parts.reached, filling.reached),
        filling.whole_cells,
        filling.cut_cells,
        notes,
    )


def _choose_deviation(tiled: TiledBody, tol: float | None) -> float:
    """The default deviation, in cells of a lattice, or the tolerance of a field's patches."""
    if isinstance(tiled.filling, LatticeRequest):
        return DEFAULT_DEVIATION_CELLS * min(tiled.filling.cell)
    assert tol is not None
    return tol


def _drop_loose_pieces(mesh: SolidMesh, loose: str, first_kept: int) -> tuple[SolidMesh, tuple[str, ...]]:
    """A mesh without its loose pieces, and the note on them. Components of negative volume are voids of the others.

    InvalidRequest if one of them has faces of what is kept, which are numbered from `first_kept`.
    """
    component = mesh.component
    volumes = mesh.measure_components(component)
    solid = np.flatnonzero(volumes > 0)
    kept, dropped = select_pieces(volumes[solid].tolist(), loose)
    if not dropped.volumes:
        return mesh, ()
    shown = volumes <= 0
    shown[solid[kept]] = True
    if (mesh.face[~shown[component]] >= first_kept).any():
        raise InvalidRequest(
            f"what is kept lies in loose pieces of {dropped.volumes[0]:.4g} mm3 at most, which are left out: check its place, "
            'or keep loose pieces (loose="keep")'
        )
    return mesh.select(shown[component]), dropped.notes
