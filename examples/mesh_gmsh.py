"""From a STEP file to a second-order tetrahedral mesh with gmsh: one periodic cell, and an infilled part.

Writes gyroid_cell.msh and infilled_part.msh beside their STEP files and prints what was measured on the meshes. Needs gmsh
(pip install gmsh; on a bare Debian or Ubuntu also apt-get install libglu1-mesa libxcursor1 libxft2 libxinerama1 libgomp1).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import build123d as bd
import gmsh
import numpy as np
from numpy.typing import NDArray

import tpmscad

Array = NDArray[np.float64]

SURFACE_SIZE = 0.83
"""Of the element size wanted, what gmsh is told: it keeps to that on faces and makes elements inside 1.4 times as long."""

ON_PLANE = 1e-5
"""Model units: how exactly gmsh's kernel knows where a face is."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """A mesh as measured: size is the mean edge length of each element, quality gmsh's signed minSICN, which is 1 for a regular
    element, below 0 for one that is turned inside out anywhere; mismatch is how far periodic nodes are from their images."""

    elements: int
    order: int
    size: Array
    quality: Array
    volume: float
    periodic_nodes: int
    mismatch: float

    def __str__(self) -> str:
        low, middle, high = np.percentile(self.size, [5, 50, 95])
        return (
            f"{self.elements} tetrahedra of order {self.order}, volume {self.volume:.7g}\n"
            f"size {self.size.mean():.3g} in the mean, {low:.3g} {middle:.3g} {high:.3g} at 5, 50, 95 %; "
            f"quality {self.quality.min():.3g} at least\n"
            f"{self.periodic_nodes} periodic nodes, {self.mismatch:.1e} off their images at most"
        )


def mesh(step: Path, size: float, *, periodic: bool = False) -> Mesh:
    """Mesh a STEP file into step's name with .msh: tetrahedra of second order with edges of about `size`.

    periodic: opposite sides of the box around the part get the same mesh; ValueError if they have not the same faces.
    """
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.importShapes(str(step))
        gmsh.model.occ.synchronize()
        if periodic:
            for axis in range(3):
                _match(axis)
        for name, value in {
            "Mesh.MeshSizeMax": SURFACE_SIZE * size,
            "Mesh.MeshSizeFromPoints": 0,
            "Mesh.MeshSizeExtendFromBoundary": 0,
            "Mesh.Algorithm3D": 10,  # HXT: its worst element is ten times better than that of the default here
            "Mesh.OptimizeThreshold": 0.5,  # flat elements with four corners on a face would be turned over by its curvature
            "Mesh.ElementOrder": 2,
            # the optimisation of 1 may move one of two periodic nodes; the elastic analogy of 3 can hold the boundary fixed
            "Mesh.HighOrderOptimize": 3 if periodic else 1,
            "Mesh.HighOrderFixBoundaryNodes": int(periodic),
        }.items():
            gmsh.option.setNumber(name, value)
        for dimension, kind in ((3, "solid"), (2, "faces")):  # groups, by which a solver finds material and boundary
            gmsh.model.addPhysicalGroup(dimension, [tag for _, tag in gmsh.model.getEntities(dimension)], name=kind)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(step.with_suffix(".msh")))
        return _measured()
    finally:
        gmsh.finalize()


def _match(axis: int) -> None:
    """Have the planar faces at the box's far side along an axis meshed like those at its near side."""
    at = {tag: np.array(gmsh.model.getValue(0, tag, [])) for _, tag in gmsh.model.getEntities(0)}
    low, high = np.min(list(at.values()), axis=0), np.max(list(at.values()), axis=0)
    shift = np.eye(3)[axis] * (high - low)
    near, far = {}, {}
    for _, face in gmsh.model.getEntities(2):
        if gmsh.model.getType(2, face) != "Plane":
            continue
        corners = [at[tag] for _, tag in gmsh.model.getBoundary([(2, face)], combined=False, recursive=True)]
        centre = np.array(gmsh.model.occ.getCenterOfMass(2, face))
        across = np.array([*corners, centre])[:, axis]
        for side, level in ((near, low[axis]), (far, high[axis])):
            if np.abs(across - level).max() < ON_PLANE:
                side[face] = np.append(centre, gmsh.model.occ.getMass(2, face))
    pairs = [
        (face, other)
        for face, here in near.items()
        for other, there in far.items()
        if np.abs(there - here - np.append(shift, 0.0)).max() < ON_PLANE
    ]
    if not len(pairs) == len(near) == len(far):
        raise ValueError(f"the {len(near)} faces at one side along {'xyz'[axis]} are not the {len(far)} at the other")
    if pairs:
        affine = np.eye(4)
        affine[:3, 3] = shift
        masters, slaves = (list(tags) for tags in zip(*pairs, strict=True))
        gmsh.model.mesh.setPeriodic(2, slaves, masters, affine.ravel().tolist())


def _measured() -> Mesh:
    """Look at the mesh that gmsh holds."""
    numbers, coordinates, _ = gmsh.model.mesh.getNodes()
    row = np.zeros(int(numbers.max()) + 1, np.int64)
    row[numbers.astype(np.int64)] = np.arange(len(numbers))
    points = coordinates.reshape(-1, 3)
    (kind,), (tags,), (nodes,) = gmsh.model.mesh.getElements(3)
    order = int(gmsh.model.mesh.getElementProperties(kind)[2])
    corner = points[row[nodes.astype(np.int64)].reshape(len(tags), -1)[:, :4]]
    i, j = np.triu_indices(4, 1)
    mismatch, matched = 0.0, 0
    for _, face in gmsh.model.getEntities(2):
        master, slaves, masters, affine = gmsh.model.mesh.getPeriodicNodes(2, face, includeHighOrderNodes=True)
        if master != face:
            moved = _moved(points[row[masters.astype(np.int64)]], affine)
            off = np.abs(points[row[slaves.astype(np.int64)]] - moved)
            mismatch, matched = max(mismatch, float(off.max())), matched + len(slaves)
    return Mesh(
        elements=len(tags),
        order=order,
        size=np.linalg.norm(corner[:, i] - corner[:, j], axis=-1).mean(axis=1),
        quality=np.array(gmsh.model.mesh.getElementQualities(tags, "minSICN")),
        volume=_volume(kind),
        periodic_nodes=matched,
        mismatch=mismatch,
    )


def _volume(kind: int) -> float:
    """The volume in the curved elements, by quadrature."""
    where, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss4")
    _, determinants, _ = gmsh.model.mesh.getJacobians(kind, where)
    return float((determinants.reshape(-1, len(weights)) @ weights).sum())


def _moved(points: Array, affine: Any) -> Array:
    matrix = np.reshape(affine, (4, 4))
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def cell() -> Any:
    """One cell of a gyroid sheet: its opposite sides are the same faces."""
    return tpmscad.lattice("gyroid", cell=10, thickness=1.5, tol=0.01)


def part() -> Any:
    """A bushing filled with gyroid under a plate that is fused to it by plain build123d."""
    bushing = bd.Pos(10, 10, 5) * (bd.Cylinder(9, 10) - bd.Cylinder(3, 10))
    filled = tpmscad.infill(bushing, "gyroid", cell=10, thickness=1.5, tol=0.02)
    return filled.solid + bd.Pos(10, 10, 11) * (bd.Cylinder(9, 2) - bd.Cylinder(3, 2))


if __name__ == "__main__":
    for name, made, size, periodic in (("gyroid_cell", cell(), 0.6, True), ("infilled_part", part(), 0.8, False)):
        path = Path(f"{name}.step")
        tpmscad.export_step(made, path)
        print(f"{path.with_suffix('.msh')}, asked for edges of {size}:\n{mesh(path, size, periodic=periodic)}\n")
