"""The signed distance of a closed triangle mesh as a smooth field.

The distance from triangles has a crease at every edge, which no smooth patch can follow. It is sampled on a uniform grid instead,
exactly, and a cubic spline interpolates the samples: facets much smaller than the spacing disappear, and sharp edges are rounded
over about one spacing. Solid is where the mesh winds round a point at least once; the distance is that from the boundary of this
solid (`fields.data.mesh_shells`). The spacing is refined until the samples have the Euler characteristic of the mesh; what the
field is off from the triangles is measured on these, and stated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import MESH, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.triangle_distance import (
    TriangleTree,
    build_triangle_tree,
    grid_winding_numbers,
    sample_triangles,
)
from tpmscad.fields.data.triangle_mesh import TriangleMesh, read_triangle_mesh
from tpmscad.fields.kinds.sampled_data import SampledField, interpolate_samples
from tpmscad.topology.cubical_betti import euler_characteristic

FIRST_SPACINGS = 64
"""Spacings along the longest edge of a mesh that are tried first: an animal of 6000 triangles is then kept within 0.7 % of its
size at the ends of its limbs, and within 0.05 % in the mean."""

REFINEMENT = 2**0.25
"""Factor from one spacing to the next finer one."""

MAX_SEARCHED_SAMPLES = 1_000_000
"""Samples up to which the spacing is refined by itself; each takes about two microseconds."""

MAX_MESH_SAMPLES = 20_000_000
"""Samples of a spacing that is asked for."""

MARGIN_SPACINGS = 3.37
"""Spacings by which the grid reaches beyond the mesh; the odd part keeps grid lines out of its planes."""

SKEW = np.array([0.0137, 0.0071, 0.0])
"""In spacings, by which lines of the grid are moved apart from the mesh's vertices, which like to lie on round numbers."""

MEASURED_POINTS = 20_000
"""Points on the triangles at which the field's distance is measured, each for an equal part of the area."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshField(SampledField):
    """The interpolated distance of a mesh, with the mesh itself and its distance from the field's level set.

    is_spacing_given: whether the spacing was asked for, so that no other is tried.
    """

    mesh: TriangleMesh = field(kw_only=True)
    is_spacing_given: bool = field(kw_only=True)
    max_deviation: float = field(kw_only=True)
    rms_deviation: float = field(kw_only=True)

    def __repr__(self) -> str:
        return f"MeshField({self.mesh.name}, {len(self.mesh.triangles)} triangles, spacing={self.spacing[0]:.4g})"


@validate_call()
def mesh(
    source: Annotated[
        Any,
        MESH,
        "The path of an ``.stl``, ``.obj``, ``.ply`` or ``.3mf`` file, with the extra ``tpmscad[triangles]``; or an object with "
        "arrays `vertices` (k, 3) and `faces` (m, 3), such as a mesh of trimesh.",
    ],
    *,
    spacing: Annotated[
        float | None,
        POSITIVE,
        "Distance of the samples, model units. Parts thinner than two spacings are lost, and edges are rounded over about one. "
        "By default a sixty-fourth of the longest edge of the mesh's box, or less where the samples would break or close a part.",
    ] = None,
) -> MeshField:
    """Return the signed distance of a closed triangle mesh as a smooth field.

    Returns
    -------
    MeshField
        About the distance from the triangles, model units, negative inside; twice continuously differentiable. Its `domain` is a
        box around the mesh, `max_deviation` and `rms_deviation` are the distances of the triangles from its level set.

    Raises
    ------
    InvalidRequest
        If the file cannot be read, or the mesh is open; the message names the number of open edges and a place. Or if the spacing
        asks for too many samples, or leaves nothing of the mesh.

    Notes
    -----
    Small holes are closed, and triangles that face the wrong way are reversed. Solid is where the mesh winds round a point at
    least once: shells that overlap become one solid, and those that lie within others facing the same way are left out; a shell
    that overlaps itself is refused. `notes` tell what was done.

    Examples
    --------
    >>> import numpy as np
    >>> from types import SimpleNamespace
    >>> from tpmscad import fields
    >>> corners = 5.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    >>> faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    >>> octahedron = fields.mesh(SimpleNamespace(vertices=corners, faces=faces))
    >>> round(float(octahedron((3.0, 3.0, 3.0))), 2)
    2.31
    """
    return interpolate_mesh(read_triangle_mesh(source), spacing)


def interpolate_mesh(found: TriangleMesh, spacing: float | None = None) -> MeshField:
    """The signed distance of a closed mesh as a smooth field, sampled at a spacing, or at one that is chosen."""
    tree = build_triangle_tree(found.vertices, found.triangles)
    size = float(np.ptp(found.vertices, axis=0).max())
    grid, notes = (_Grid(found, tree, spacing), ()) if spacing is not None else _choose_grid(found, tree, size)
    return _interpolate_grid(grid, notes, spacing is not None)


def resample_mesh(source: MeshField, factor: float) -> MeshField:
    """The field of the same mesh at a multiple of its spacing."""
    tree = build_triangle_tree(source.mesh.vertices, source.mesh.triangles)
    note = f"{source.mesh.name}: it was sampled at another spacing, as its surface could not be fitted at {source.spacing[0]:.3g}"
    return _interpolate_grid(_Grid(source.mesh, tree, factor * source.spacing[0]), (note,), False)


def _interpolate_grid(grid: _Grid, notes: tuple[str, ...], is_spacing_given: bool) -> MeshField:
    """The field of a grid; InvalidRequest if it has too many samples, or none within the mesh."""
    found = grid.mesh
    if grid.count > MAX_MESH_SAMPLES:
        least = grid.spacing * (grid.count / MAX_MESH_SAMPLES) ** (1 / 3)
        raise InvalidRequest(
            f"a spacing of {grid.spacing:g} needs {grid.count:.3g} samples of {found.name}, more than {MAX_MESH_SAMPLES:.3g}: "
            f"give at least {least:.3g}"
        )
    if not (grid.values < 0).any():
        raise InvalidRequest(
            f"with a spacing of {grid.spacing:g} no sample lies within {found.name}: give a smaller one"
        )
    spline = interpolate_samples(grid.values, (grid.spacing,) * 3, (grid.x[0], grid.y[0], grid.z[0]))
    distance = _measure_triangles(spline, found)
    largest, rms = float(np.abs(distance).max()), float(np.sqrt(np.mean(distance**2)))
    how = (
        f"{found.name}: the distance of its {len(found.triangles)} triangles was sampled every {grid.spacing:.3g}; they lie up "
        f"to {largest:.2g} from the smooth surface, {rms:.2g} in the root mean square"
    )
    return MeshField(
        spline.coefficients,
        spline.spacing,
        spline.origin,
        notes=(*found.notes, how, *notes),
        mesh=found,
        is_spacing_given=is_spacing_given,
        max_deviation=largest,
        rms_deviation=rms,
    )


@dataclass(frozen=True)
class _Grid:
    """A grid around a mesh, and the signed distances at its points."""

    mesh: TriangleMesh
    tree: TriangleTree
    spacing: float

    @property
    def first(self) -> Array:
        return self.mesh.vertices.min(axis=0) - (MARGIN_SPACINGS + SKEW) * self.spacing

    @property
    def counts(self) -> Array:
        high = self.mesh.vertices.max(axis=0)
        return np.asarray(np.ceil((high - self.first) / self.spacing + MARGIN_SPACINGS) + 1)

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        counts = self.counts.astype(int).tolist()
        x, y, z = (a + self.spacing * np.arange(n) for a, n in zip(self.first.tolist(), counts, strict=True))
        return x, y, z

    @property
    def x(self) -> Array:
        return self.axes[0]

    @property
    def y(self) -> Array:
        return self.axes[1]

    @property
    def z(self) -> Array:
        return self.axes[2]

    @property
    def count(self) -> float:
        return float(self.counts.prod())

    @cached_property
    def winding(self) -> IntArray:
        return grid_winding_numbers(self.mesh.vertices, self.mesh.triangles, *self.axes)

    @cached_property
    def values(self) -> Array:
        points = np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1)
        distance = self.tree.distances(points.reshape(-1, 3)).reshape(points.shape[:3])
        return np.where(self.winding > 0, -distance, distance)


def _choose_grid(mesh: TriangleMesh, tree: TriangleTree, size: float) -> tuple[_Grid, tuple[str, ...]]:
    """The coarsest grid on which the inner points have the Euler characteristic of the mesh, and a note if there is none."""
    first = grid = _Grid(mesh, tree, size / FIRST_SPACINGS)
    wanted = mesh.euler_characteristic / 2  # of the solid, whose boundary has twice as much
    while grid.count <= MAX_SEARCHED_SAMPLES:
        if (
            grid.winding > 1
        ).any():  # triangles cross near the boundary: the characteristic of what they bound is not known
            return grid, ()
        if euler_characteristic(np.where(grid.winding > 0, -1.0, 1.0)) == wanted:
            return grid, ()
        grid = _Grid(mesh, tree, grid.spacing / REFINEMENT)
    note = (
        f"{mesh.name}: at no spacing down to {grid.spacing:.3g} do the samples have the Euler characteristic of the mesh, "
        f"{wanted:g}: parts thinner than two spacings may be missing; `spacing` refines them"
    )
    return first, (note,)


def _measure_triangles(spline: SampledField, mesh: TriangleMesh) -> Array:
    """Distances (n,) of points on the triangles from the level set, to first order, each for an equal part of the area."""
    points, _ = sample_triangles(mesh.corners, MEASURED_POINTS)
    slope = np.linalg.norm(spline.gradient(points), axis=1)
    return spline(points) / np.maximum(slope, 0.5)
