"""Triangles beside scripts that people write: CPU seconds of whole processes, imports included, at about equal deviation.

    python -m benchmarks.peers [ROW ...]         # names of rows; --list prints them

Sides: `ours`; `script`, scikit-image's marching cubes of a formula on a grid and trimesh's writer; `expert`, the same formula
separably in float32 and a writer of ten lines; `exact`, Manifold's booleans of cylinders, whose edges are exact. Grids have as
many lines as the deviation asks for on the smooth parts, from one trial cell; edges between the lattice and a body are not
resolved by them. Deviations are measured on each file by feet of points of its triangles on its own surfaces: offsets of the
nodal surface for ours, level sets for scripts, planes and cylinders. `edge` counts all points, `smooth` those farther from edges
than two grid steps.
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
"""Triangles of a file on which the deviation is measured."""


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


def lattice_export(row: Row, path: Path) -> None:
    import tpmscad

    cells = tuple(round(s / row.cell) for s in row.size)
    model = tpmscad.lattice(
        "gyroid",
        cell=row.cell,
        cells=cells,
        thickness=0.12 * row.cell,
        phase=(0, 0, 0),
        reference="nodal",
        tol=TOL_FRACTION * row.deviation,
    )
    model.export(path, deviation=row.deviation)


def filled(row: Row, path: Path) -> None:
    """A solid of OCCT is the body: to import build123d for it takes 2 s."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    import tpmscad

    x, y, z = row.size
    if row.kind == "cylinder":
        body = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(x / 2, y / 2, 0), gp_Dir(0, 0, 1)), x / 2, z).Solid()
    else:
        body = BRepPrimAPI_MakeBox(x, y, z).Solid()
    asked = {"skin": row.skin, "open_faces": ">Z"} if row.skin else {}
    tpmscad.infill_triangles(
        body,
        "gyroid",
        cell=row.cell,
        thickness=0.12 * row.cell,
        phase=(0, 0, 0),
        reference="nodal",
        tol=TOL_FRACTION * row.deviation,
        deviation=row.deviation,
        **asked,
    ).write(path)


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


def octet(row: Row, path: Path) -> None:
    import tpmscad

    tpmscad.struts("octet", cell=row.cell, cells=5, diameter=1).export(path, deviation=row.deviation)  # an exact solid


def manifold_octet(row: Row, path: Path) -> None:
    """Prisms of as many sides as the deviation asks for, united, and a box."""
    import manifold3d

    from tpmscad.strut_cells import make_cell  # without NumPy

    nodes, pairs = make_cell("octet")
    radius = 0.5
    sides = int(np.ceil(np.pi / np.arccos(1 - row.deviation / radius)))
    ends = np.array(nodes)[np.array(pairs)]
    shifts = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 1, 1, 3)
    every = np.unique(((ends + shifts) * row.cell).reshape(-1, 6).round(9), axis=0).reshape(-1, 2, 3)
    struts = []
    for start, end in every:
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
    box = manifold3d.Manifold.cube([5 * row.cell] * 3)
    mesh = (united ^ box).to_mesh()
    write_stl(path, np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


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
    Row("octet", "octet", 0.02, octet, cell=10.0, size=(50.0, 50.0, 50.0), sides=("ours", "exact")),
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

    axes, step = grid_of(row, lines)
    x, y, z = np.meshgrid(*axes, indexing="ij")
    points, triangles, _, _ = measure.marching_cubes(part(row, x, y, z), 0.0, spacing=(step,) * 3)
    trimesh.Trimesh(points + [a[0] for a in axes], triangles).export(path)


def expert(row: Row, path: Path, lines: int) -> None:
    """Slab by slab of 64 layers at most; terms that are products are evaluated by axis, in float32."""
    from skimage import measure

    axes, step = grid_of(row, lines)
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


def measure_file(row: Row, path: Path, *, offset: bool, step: float) -> tuple[int, float, float]:
    """Triangles, and the greatest distance of points on some of them from the part's faces: of all, and far from edges."""
    data = np.fromfile(path, RECORD, offset=84)
    chosen = np.random.default_rng(7).choice(len(data), min(PROBED, len(data)), replace=False)
    a, b, c = data["corners"][chosen].astype(float).swapaxes(0, 1)
    p = np.concatenate([a, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
    each = [np.abs(outside(row, *p.T))]
    each += [np.abs(outside(row, *p.T, row.skin))] if row.skin else []
    each.append(strut_distance(row, p) if row.kind == "octet" else wall_distance(row, p, offset=offset))
    found = np.sort(np.stack(each), axis=0)
    smooth = found[1] > 2 * step
    return len(data), float(found[0].max()), float(found[0][smooth].max(initial=0.0))


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
    elif side == "exact":
        manifold_octet(row, path)
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
        f"{'row':16s} {'side':7s} {'CPU s':>7s} {'ours/it':>8s} {'GiB':>5s} {'triangles':>10s} {'smooth':>8s} {'edge':>8s}"
    )
    for row in chosen:
        lines = 0 if "exact" in row.sides else choose_lines(row)
        step = row.cell / lines if lines else 0.0
        ours = 0.0
        for side in row.sides:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "part.stl"
                command = [sys.executable, "-m", "benchmarks.peers", row.name, "--run", side, str(path), str(lines)]
                child = subprocess.Popen(command)
                _, status, used = os.wait4(child.pid, 0)
                if status:
                    print(f"{row.name:16s} {side:7s} failed")
                    continue
                seconds = used.ru_utime + used.ru_stime
                ours = seconds if side == "ours" else ours
                memory = int(path.with_suffix(".kB").read_text()) / 2**20
                count, edge, smooth = measure_file(
                    row, path, offset=side == "ours" and row.kind not in ("graded", "blend"), step=step
                )
            print(
                f"{row.name:16s} {side:7s} {seconds:7.2f} {ours / seconds:8.2f} {memory:5.2f} {count:10d} "
                f"{smooth:8.4f} {edge:8.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
