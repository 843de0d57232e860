"""Triangles, layers and STEP files beside scripts that people write, at about equal deviation.

    python -m benchmarks.peers [ROW ...]         # names of rows; --list prints them

CPU seconds are those of whole processes, imports included. Sides: `ours`; `script`, scikit-image's marching cubes of a formula on
a grid and trimesh's writer or sections; `expert`, the same formula separably in float32 and a writer of ten lines; `exact`,
booleans of cylinders, whose edges are exact: Manifold's, or the kernel's for STEP files. For layers
`exact` slices Manifold's boolean of the wall's marching cubes and the body, and `expert` makes contours of the formula on a grid
of each layer, without triangles.

Grids have as many lines as the deviation asks for on the smooth parts, from one trial cell; edges between the lattice and a body
are not resolved by them. Deviations are measured on each file by feet of points of its triangles, contours or faces on its own
surfaces: offsets of the nodal surface for ours, level sets for scripts, planes and cylinders. `edge` counts all points, `smooth`
those farther from edges than two grid steps. `count` is that of triangles, points of contours, or faces. `stiffness` has the
greatest relative error of the three constants of a cell instead, beside 48^3 voxels.
"""

from __future__ import annotations

import argparse
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
LEVEL = 0.57
"""Of the nodal gyroid: walls between -LEVEL and LEVEL are about as thick as 0.12 cells."""

TOL_FRACTION = 0.1
"""Tolerance of our patches per deviation of triangles from them, which is rarely reached: the sum is measured like the others."""

PROBED = 4000
"""Triangles, chords or points of faces of a file on which the deviation is measured."""

LAYER_HEIGHT = 0.1

STIFFNESS = np.array([0.100684, 0.047962, 0.029874])
"""C11, C12 and C44 of a gyroid sheet of volume fraction 0.2 and Young's modulus 1, by 2,592 hexahedra of
second order; 768 differ by less than 0.2 %."""


@dataclass(frozen=True)
class Row:
    """A job: the part in a box or cylinder of cells, ours and the scripts' deviation, and what else both need."""

    name: str
    kind: str
    deviation: float
    ours: Callable[[Row, Path], None]
    cell: float = 1.0
    size: tuple[float, float, float] = (1.0, 1.0, 1.0)
    skin: float = 0.0
    sides: tuple[str, ...] = ("ours", "script", "expert")
    suffix: str = ".stl"
    exact: Callable[[Row, Path, int], None] | None = None


def gyroid_lattice(row: Row, tol: float) -> Any:
    import tpmscad

    cells = tuple(round(s / row.cell) for s in row.size)
    return tpmscad.lattice(
        "gyroid",
        cell=row.cell,
        cells=cells,
        thickness=0.12 * row.cell,
        phase=(0, 0, 0),
        reference="nodal",
        tol=tol,
    )


def lattice_export(row: Row, path: Path) -> None:
    gyroid_lattice(row, TOL_FRACTION * row.deviation).export(path, deviation=row.deviation)


def lattice_step(row: Row, path: Path) -> None:
    gyroid_lattice(row, row.deviation).export_step(path)


def body_and_options(row: Row) -> tuple[Any, dict[str, Any]]:
    """A solid of OCCT is the body: to import build123d for it takes 2 s."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    x, y, z = row.size
    if row.kind == "cylinder":
        body = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(x / 2, y / 2, 0), gp_Dir(0, 0, 1)), x / 2, z).Solid()
    else:
        body = BRepPrimAPI_MakeBox(x, y, z).Solid()
    options = {
        "cell": row.cell,
        "thickness": 0.12 * row.cell,
        "phase": (0, 0, 0),
        "reference": "nodal",
        "tol": TOL_FRACTION * row.deviation,
    }
    return body, options | ({"skin": row.skin, "open_faces": ">Z"} if row.skin else {})


def filled(row: Row, path: Path) -> None:
    import tpmscad

    body, options = body_and_options(row)
    tpmscad.infill_triangles(body, "gyroid", deviation=row.deviation, **options).write(path)


def filled_layers(row: Row, path: Path) -> None:
    import tpmscad

    body, options = body_and_options(row)
    tpmscad.infill_layers(body, "gyroid", height=LAYER_HEIGHT, chord_error=row.deviation, **options).write(path)


def solidified(row: Row, path: Path) -> None:
    import tpmscad
    from tpmscad import fields

    gyroid = fields.tpms("gyroid", period=row.cell)
    if row.kind == "graded":
        level: Any = fields.expression(f"0.15 + 0.45 * z / {row.size[2]}")
        made = fields.sheet(gyroid, -level, level)
    else:
        weight = fields.expression(f"x / {row.size[0]}")
        made = fields.sheet(gyroid + weight * (fields.tpms("diamond", period=row.cell) - gyroid), -0.3, 0.3)
    model = tpmscad.solidify(made, ((0, 0, 0), row.size), tol=TOL_FRACTION * row.deviation)
    model.export(path, deviation=row.deviation)


def ring(row: Row, path: Path) -> None:
    import tpmscad
    from tpmscad import maps

    radius = 12 * row.cell / (2 * np.pi)
    tpmscad.lattice(
        "gyroid",
        cell=row.cell,
        cells=(12, 1, 1),
        thickness=0.12 * row.cell,
        phase=(0, 0, 0),
        reference="nodal",
        map=maps.cylinder(radius),
        tol=TOL_FRACTION * row.deviation,
    ).export(path, deviation=row.deviation)


def homogenized(row: Row, path: Path) -> None:
    import tpmscad

    found = tpmscad.homogenize("gyroid", volume_fraction=0.2, poisson_ratio=0.3)
    np.savetxt(path, found.stiffness)


def voxel_stiffness(row: Row, path: Path) -> None:
    """Stiffness (6, 6) of 48^3 voxels near the gyroid, a fifth of all, by trilinear elements."""
    import pyamg
    from scipy.sparse import csr_matrix
    from skfem import Basis, ElementHex1, ElementVector, MeshHex
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    n = 48
    middles = (np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) / n
    value, up = slope(lambda *at: nodal(row, *at), middles)
    distance = np.abs(value) / np.linalg.norm(up, axis=1)
    mesh = MeshHex.init_tensor(*[np.linspace(0, 1, n + 1)] * 3)
    cells = np.floor(mesh.p[:, mesh.t].mean(axis=1) * n).astype(int)
    solid = (distance < np.quantile(distance, 0.2))[np.ravel_multi_index(tuple(cells), (n, n, n))]
    mesh = mesh.restrict(np.flatnonzero(solid))
    basis = Basis(mesh, ElementVector(ElementHex1()), intorder=2)
    matrix = linear_elasticity(*lame_parameters(1.0, 0.3)).assemble(basis)
    nodes = np.ravel_multi_index(tuple(np.rint(mesh.p * n).astype(int) % n), (n, n, n))
    _, first, master = np.unique(nodes, return_index=True, return_inverse=True)
    dofs = basis.nodal_dofs
    columns = (3 * master + np.arange(3)[:, None]).ravel()
    periodic = csr_matrix((np.ones(dofs.size), (dofs.ravel(), columns)), (len(columns), 3 * len(first)))[:, 3:]  # held
    strains, modes = np.zeros((dofs.size, 6)), np.zeros((len(first), 3, 6))
    for k, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
        strains[dofs[a], k] += 0.5 * mesh.p[b]
        strains[dofs[b], k] += 0.5 * mesh.p[a]
    for a, b in ((0, 1), (1, 2), (2, 0)):
        modes[:, a, a] = 1.0
        modes[:, a, 3 + a], modes[:, b, 3 + a] = -mesh.p[b, first], mesh.p[a, first]
    reduced = (periodic.T @ matrix @ periodic).tobsr((3, 3))
    solver = pyamg.smoothed_aggregation_solver(reduced, B=modes[1:].reshape(-1, 6))
    loads = -(periodic.T @ (matrix @ strains))
    moved = strains + periodic @ np.column_stack([solver.solve(load, tol=1e-6, accel="cg") for load in loads.T])
    np.savetxt(path, moved.T @ (matrix @ moved))


def octet(row: Row, path: Path) -> None:
    import tpmscad

    model = tpmscad.struts("octet", cell=row.cell, cells=round(row.size[0] / row.cell), diameter=1)  # an exact solid
    if row.suffix == ".step":
        model.export_step(path)
    else:
        model.export(path, deviation=row.deviation)


def octet_axes(row: Row) -> Array:
    """Ends (n, 2, 3) of all struts."""
    from tpmscad.strut_cells import make_cell  # without NumPy

    nodes, pairs = make_cell("octet")
    ends = np.array(nodes)[np.array(pairs)]
    shifts = np.stack(np.meshgrid(*[np.arange(row.size[0] / row.cell)] * 3), axis=-1).reshape(-1, 1, 1, 3)
    return np.unique(((ends + shifts) * row.cell).reshape(-1, 6).round(9), axis=0).reshape(-1, 2, 3)


def manifold_octet(row: Row, path: Path, lines: int) -> None:
    """Prisms of as many sides as the deviation asks for, united, and a box."""
    import manifold3d

    radius = 0.5
    sides = int(np.ceil(np.pi / np.arccos(1 - row.deviation / radius)))
    struts = []
    for start, end in octet_axes(row):
        along = end - start
        length = np.linalg.norm(along)
        axis = along / length
        x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        x /= np.linalg.norm(x)
        frame = np.column_stack([x, np.cross(axis, x), axis, start])
        struts.append(manifold3d.Manifold.cylinder(length, radius, radius, sides).transform(frame))
        struts.append(manifold3d.Manifold.sphere(radius, sides).translate(start))
        struts.append(manifold3d.Manifold.sphere(radius, sides).translate(end))
    united = manifold3d.Manifold.batch_boolean(struts, manifold3d.OpType.Add)
    mesh = (united ^ manifold3d.Manifold.cube(row.size)).to_mesh()
    write_stl(path, np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


def kernel_octet(row: Row, path: Path, lines: int) -> None:
    """Cylinders and spheres united by the kernel's general fuse, and a box."""
    import build123d as bd

    axes = octet_axes(row)
    struts = [
        bd.Solid.make_cylinder(0.5, float(np.linalg.norm(b - a)), bd.Plane(tuple(a), z_dir=tuple(b - a)))
        for a, b in axes
    ]
    joints = [
        bd.Pos(*node) * bd.Solid.make_sphere(0.5, angle1=-90, angle2=90)
        for node in np.unique(axes.reshape(-1, 3), axis=0)
    ]
    box = bd.Solid.make_box(*row.size)
    solid = box & struts[0].fuse(*struts[1:], *joints)
    bd.export_step(solid if isinstance(solid, bd.Shape) else bd.Compound(solid), path)


def manifold_layers(row: Row, path: Path, lines: int) -> None:
    """Marching cubes of the wall alone, closed by a border, cut by exact cylinders and sliced."""
    import manifold3d
    from skimage import measure

    axes, step = grid_of(row, lines)
    values = np.pad(wall(row, *np.meshgrid(*axes, indexing="ij")), 1, constant_values=1.0)
    points, triangles, _, _ = measure.marching_cubes(values, 0.0, spacing=(step,) * 3)
    points += [a[0] - step for a in axes]
    mesh = manifold3d.Mesh(points.astype(np.float32), triangles.astype(np.uint32))
    radius, _, height = (s / (2 if i < 2 else 1) for i, s in enumerate(row.size))
    sides = int(np.ceil(np.pi / np.arccos(1 - row.deviation / radius)))
    body, inner = (
        manifold3d.Manifold.cylinder(height - low, r, r, sides).translate((radius, radius, low))
        for low, r in ((0.0, radius), (row.skin, radius - row.skin))
    )
    part = (manifold3d.Manifold(mesh) ^ inner) + (body - inner)
    write_cli(path, [part.slice(z).to_polygons() for z in layer_middles(row)])


ROWS = [
    Row("cell .01", "box", 0.01, lattice_export),
    Row("cell .002", "box", 0.002, lattice_export),
    Row("5^3 export", "box", 0.02, lattice_export, size=(5.0, 5.0, 5.0)),
    Row("5^3 triangles", "box", 0.02, filled, size=(5.0, 5.0, 5.0)),
    Row("10^3 triangles", "box", 0.02, filled, size=(10.0, 10.0, 10.0)),
    Row("cylinder", "cylinder", 0.04, filled, cell=4.0, size=(40.0, 40.0, 40.0), skin=1.0),
    Row("18000 cells", "box", 0.01, filled, size=(30.0, 30.0, 20.0), sides=("ours", "expert")),
    Row("graded", "graded", 0.05, solidified, cell=5.0, size=(5.0, 5.0, 10.0)),
    Row("blend", "blend", 0.05, solidified, cell=5.0, size=(10.0, 5.0, 5.0)),
    Row("ring", "ring", 0.03, ring, cell=4.0, size=(20.0, 20.0, 4.0)),
    Row("octet", "octet", 0.02, octet, 10.0, (50.0, 50.0, 50.0), sides=("ours", "exact"), exact=manifold_octet),
    Row(
        "400 layers",
        "cylinder",
        0.04,
        filled_layers,
        cell=4.0,
        size=(40.0, 40.0, 40.0),
        skin=1.0,
        sides=("ours", "script", "expert", "exact"),
        suffix=".cli",
        exact=manifold_layers,
    ),
    Row("cell step", "box", 0.05, lattice_step, 10.0, (10.0, 10.0, 10.0), sides=("ours",), suffix=".step"),
    Row(
        "octet step",
        "octet",
        0.01,
        octet,
        10.0,
        (20.0, 20.0, 20.0),
        sides=("ours", "exact"),
        suffix=".step",
        exact=kernel_octet,
    ),
    Row("stiffness", "box", 0.05, homogenized, sides=("ours", "script"), suffix=".txt"),
]


# What scripts evaluate, in NumPy alone: negative in the solid.


def to_lattice(row: Row, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Coordinates before the map of the ring."""
    if row.kind != "ring":
        return x, y, z
    radius = 12 * row.cell / (2 * np.pi)
    return np.arctan2(x, y) * radius, np.hypot(x, y) - radius, z


def wall(row: Row, x: Any, y: Any, z: Any) -> Any:
    """The level set function of the wall alone, in lattice coordinates."""
    a, b, c = (2 * np.pi / row.cell * each for each in (x, y, z))
    value = np.sin(a) * np.cos(b) + np.sin(b) * np.cos(c) + np.sin(c) * np.cos(a)
    if row.kind == "blend":
        weight = np.clip(x / row.size[0], 0, 1)
        diamond = np.sin(a) * np.cos(b - c) + np.cos(a) * np.sin(b + c)
        return np.abs((1 - weight) * value + weight * diamond) - 0.3
    return np.abs(value) - (0.15 + 0.45 * z / row.size[2] if row.kind == "graded" else LEVEL)


def outside(row: Row, x: Any, y: Any, z: Any, skin: float = 0.0) -> Any:
    """Signed distance from the body, or from what is deeper than a skin below all its faces but the top."""
    if row.kind == "cylinder":
        half = row.size[0] / 2
        return np.maximum(np.hypot(x - half, y - half) - (half - skin), np.maximum(skin - z, z - row.size[2]))
    if row.kind == "ring":
        radius = 12 * row.cell / (2 * np.pi)
        across = np.hypot(x, y) - radius
        return np.maximum(np.maximum(-across, across - row.cell), np.maximum(-z, z - row.cell))
    x, y, z = (np.maximum(-each, each - most) for each, most in zip((x, y, z), row.size, strict=True))
    return np.maximum(np.maximum(x, y), z)


def part(row: Row, x: Any, y: Any, z: Any) -> Any:
    inner = wall(row, *to_lattice(row, x, y, z)) * (row.cell / 10)  # about a distance
    if row.skin:
        inner = np.minimum(inner, -outside(row, x, y, z, row.skin))
    return np.maximum(inner, outside(row, x, y, z))


def grid_of(row: Row, lines: int) -> tuple[list[Array], float]:
    """The axes of a grid one step beyond the part, and its step."""
    step = row.cell / lines
    if row.kind == "ring":
        reach = 12 * row.cell / (2 * np.pi) + row.cell
        low, high = np.array([-reach, -reach, 0]), np.array([reach, reach, row.cell])
    else:
        low, high = np.zeros(3), np.array(row.size)
    return [np.arange(a - step, b + 1.5 * step, step) for a, b in zip(low, high, strict=True)], step


def script(row: Row, path: Path, lines: int) -> None:
    import trimesh
    from skimage import measure

    if row.suffix == ".txt":
        voxel_stiffness(row, path)
        return
    axes, step = grid_of(row, lines)
    x, y, z = np.meshgrid(*axes, indexing="ij")
    points, triangles, _, _ = measure.marching_cubes(part(row, x, y, z), 0.0, spacing=(step,) * 3)
    mesh = trimesh.Trimesh(points + [a[0] for a in axes], triangles)
    if row.suffix == ".cli":
        sections = mesh.section_multiplane((0, 0, 0), (0, 0, 1), layer_middles(row))
        write_cli(path, [each.discrete for each in sections])
    else:
        mesh.export(path)


def expert(row: Row, path: Path, lines: int) -> None:
    """Slab by slab of 64 layers at most; terms that are products are evaluated by axis, in float32."""
    from skimage import measure

    axes, step = grid_of(row, lines)
    if row.suffix == ".cli":  # without triangles
        x, y = np.ix_(*(a.astype(np.float32) for a in axes[:2]))
        layers = [part(row, x, y, np.float32(z)) for z in layer_middles(row)]
        write_cli(path, [[axes[0][0] + step * each for each in measure.find_contours(v, 0.0)] for v in layers])
        return
    x, y, z = np.ix_(*(a.astype(np.float32) for a in axes))
    records = []
    for start in range(0, len(axes[0]) - 1, 63):
        values = np.asarray(part(row, x[start : start + 64], y, z), np.float32)
        if values.min() < 0 < values.max():
            points, triangles, _, _ = measure.marching_cubes(values, 0.0, spacing=(step,) * 3)
            origin = np.array([axes[0][start], axes[1][0], axes[2][0]], np.float32)
            records.append((points + origin)[triangles])
    corners = np.concatenate(records)
    write_stl(path, corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])


def write_stl(path: Path, points: Array, triangles: Array) -> None:
    rows = np.zeros(len(triangles), RECORD)
    rows["corners"] = points[triangles]
    a, b, c = rows["corners"].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    rows["normal"] = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", len(rows)))
        rows.tofile(file)


def layer_middles(row: Row) -> Array:
    return (np.arange(round(row.size[2] / LAYER_HEIGHT)) + 0.5) * LAYER_HEIGHT


def write_cli(path: Path, layers: list[Any]) -> None:
    """Closed contours (n, 2) of each layer, in the ASCII form of the Common Layer Interface."""
    with path.open("w") as file:
        file.write("$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$HEADEREND\n$$GEOMETRYSTART\n$$LAYER/0\n")
        for number, contours in enumerate(layers, 1):
            file.write(f"$$LAYER/{number * LAYER_HEIGHT:.6g}\n")
            for contour in contours:
                closed = np.concatenate([contour, contour[:1]])
                text = ",".join(["%.6g"] * closed.size) % tuple(closed.ravel().tolist())
                file.write(f"$$POLYLINE/1,1,{len(closed)},{text}\n")
        file.write("$$GEOMETRYEND\n")


# What is measured on a file.


def slope(function: Callable[..., Array], p: Array, step: float = 1e-5) -> tuple[Array, Array]:
    """Values (n,) and gradients (n, 3) by central differences."""
    moves = step * np.eye(3)
    sides = [(function(*(p + m).T) - function(*(p - m).T)) / (2 * step) for m in moves]
    return function(*p.T), np.stack(sides, axis=1)


def nodal(row: Row, x: Any, y: Any, z: Any) -> Any:
    a, b, c = (2 * np.pi / row.cell * each for each in to_lattice(row, x, y, z))
    return np.sin(a) * np.cos(b) + np.sin(b) * np.cos(c) + np.sin(c) * np.cos(a)


def wall_distance(row: Row, p: Array, *, offset: bool) -> Array:
    """Distances (n,) of points from the wall's faces: offsets of the nodal surface, or level sets."""
    foot = p.copy()
    if offset:
        for _ in range(40):  # along the surface towards the point, and back onto it
            value, up = slope(lambda *at: nodal(row, *at), foot)
            unit = up / np.linalg.norm(up, axis=1, keepdims=True)
            arm = p - foot
            along = arm - (arm * unit).sum(axis=1, keepdims=True) * unit
            foot += 0.7 * along - value[:, None] * up / (up**2).sum(axis=1, keepdims=True)
        return np.abs(np.linalg.norm(p - foot, axis=1) - 0.06 * row.cell)
    for _ in range(8):
        value, up = slope(lambda *at: wall(row, *to_lattice(row, *at)), foot)
        foot -= value[:, None] * up / np.maximum((up**2).sum(axis=1, keepdims=True), 1e-12)
    return np.linalg.norm(p - foot, axis=1)


def strut_distance(row: Row, p: Array) -> Array:
    """Distances from the surface of the struts about their axes, by all struts of the cells around."""
    from tpmscad.strut_cells import make_cell

    nodes, pairs = make_cell("octet")
    ends = (np.array(nodes)[np.array(pairs)] * row.cell).reshape(-1, 2, 3)
    q = np.mod(p, row.cell)
    best = np.full(len(p), np.inf)
    for shift in np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3), axis=-1).reshape(-1, 3):
        for start, end in ends + shift * row.cell:
            t = np.clip((q - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            best = np.minimum(best, np.linalg.norm(q - start - t[:, None] * (end - start), axis=1))
    return np.abs(best - 0.5)


def read_stl_points(path: Path) -> tuple[int, Array]:
    data = np.fromfile(path, RECORD, offset=84)
    chosen = np.random.default_rng(7).choice(len(data), min(PROBED, len(data)), replace=False)
    a, b, c = data["corners"][chosen].astype(float).swapaxes(0, 1)
    return len(data), np.concatenate([a, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])


def read_cli_points(path: Path) -> tuple[int, Array]:
    """Points of contours and middles of chords, at the middles of layers."""
    heights, chords = [0.0, 0.0], []
    for line in path.read_text().splitlines():
        keyword, _, text = line.partition("/")
        if keyword == "$$LAYER":
            heights.append(float(text))
        elif keyword == "$$POLYLINE":
            contour = np.array(text.split(",")[3:], float).reshape(-1, 2)
            z = np.full((len(contour) - 1, 1), sum(heights[-2:]) / 2)
            chords.append(np.stack([np.hstack([contour[:-1], z]), np.hstack([contour[1:], z])], axis=1))
    every = np.concatenate(chords)
    chosen = np.random.default_rng(7).choice(len(every), min(PROBED, len(every)), replace=False)
    a, b = every[chosen].swapaxes(0, 1)
    return len(every), np.concatenate([a, (a + b) / 2])


def read_step_points(path: Path) -> tuple[int, Array]:
    from benchmarks.comparison import surface_points

    faces, _, points = surface_points(path)
    return faces, np.random.default_rng(7).permutation(points)[:PROBED]


READERS = {".stl": read_stl_points, ".cli": read_cli_points, ".step": read_step_points}


def measure_file(row: Row, path: Path, *, offset: bool, step: float) -> tuple[int, float, float]:
    """Their count, and the greatest distance of some points of a file from the part's faces: of all, and far from edges."""
    if row.suffix == ".txt":
        found = np.loadtxt(path)[[0, 0, 3], [0, 1, 3]]
        off = float(np.abs(found / STIFFNESS - 1.0).max())
        return 0, off, off
    count, p = READERS[row.suffix](path)
    each = [np.abs(outside(row, *p.T))]
    each += [np.abs(outside(row, *p.T, row.skin))] if row.skin else []
    each.append(strut_distance(row, p) if row.kind == "octet" else wall_distance(row, p, offset=offset))
    found = np.sort(np.stack(each), axis=0)
    smooth = found[1] > 2 * step
    return count, float(found[0].max()), float(found[0][smooth].max(initial=0.0))


def choose_lines(row: Row) -> int:
    """Grid lines a cell at which marching cubes keep the deviation on smooth faces: the error is of second order."""
    from skimage import measure

    lines = 24
    axes, step = grid_of(row, lines)
    axes = [a[: 2 * lines] for a in axes] if row.kind == "box" else axes
    values = wall(row, *to_lattice(row, *np.meshgrid(*axes, indexing="ij")))
    points, triangles, _, _ = measure.marching_cubes(values, 0.0, spacing=(step,) * 3)
    chosen = np.random.default_rng(7).choice(len(triangles), min(PROBED, len(triangles)), replace=False)
    corners = (points + [a[0] for a in axes])[triangles[chosen]]
    p = np.concatenate([corners.mean(axis=1), *((corners + np.roll(corners, 1, axis=1)) / 2).swapaxes(0, 1)])
    reached = wall_distance(row, p, offset=False).max()
    return max(6, int(np.ceil(lines * np.sqrt(reached / row.deviation))))


def run(row: Row, side: str, path: Path, lines: int) -> None:
    if side == "ours":
        row.ours(row, path)
    elif side == "exact" and row.exact:
        row.exact(row, path, lines)
    else:
        (script if side == "script" else expert)(row, path, lines)
    status = Path("/proc/self/status").read_text()  # wait4 counts the memory of the process before it was replaced
    path.with_suffix(".kB").write_text(status.split("VmHWM:")[1].split()[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--run", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        side, path, lines = given.run
        run(next(row for row in ROWS if row.name == given.rows[0]), side, Path(path), int(lines))
        return
    chosen = [row for row in ROWS if not given.rows or row.name in given.rows]
    if given.list:
        print("\n".join(row.name for row in chosen))
        return
    print(
        f"{'row':16s} {'side':7s} {'CPU s':>7s} {'ours/it':>8s} {'GiB':>5s} {'MB':>7s} {'count':>10s} {'smooth':>8s} {'edge':>8s}"
    )
    for row in chosen:
        lines = 0 if row.kind == "octet" else choose_lines(row)
        step = row.cell / lines if lines else 0.0
        ours = 0.0
        for side in row.sides:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"part{row.suffix}"
                command = [sys.executable, "-m", "benchmarks.peers", row.name, "--run", side, str(path), str(lines)]
                child = subprocess.Popen(command)
                _, status, used = os.wait4(child.pid, 0)
                if status:
                    print(f"{row.name:16s} {side:7s} failed")
                    continue
                seconds = used.ru_utime + used.ru_stime
                ours = seconds if side == "ours" else ours
                size = path.stat().st_size / 1e6
                memory = int(path.with_suffix(".kB").read_text()) / 2**20
                count, edge, smooth = measure_file(
                    row, path, offset=side == "ours" and row.kind not in ("graded", "blend"), step=step
                )
            print(
                f"{row.name:16s} {side:7s} {seconds:7.2f} {ours / seconds:8.2f} {memory:5.2f} {size:7.2f} {count:10d} "
                f"{smooth:8.4f} {edge:8.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
