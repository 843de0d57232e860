"""Wall thickness of lattices between two faces of CAD parts, read from the STEP file alone.

    python -m benchmarks.between_faces [PART ...]

For each part a gyroid wall is made between two of its faces (`maps.between`) and written. From the file's text the Bezier nets of
the faces named 'surface +' and 'surface -' are taken; no code that made them is used. The thickness at a random point of one wall
is its least distance from the whole other wall: Newton steps from the nearest samples on several patches, kept inside each patch.
Where the nearest point lies on the rim, at which the other wall ends, there is no thickness to compare. The seconds of the map
alone are shown beside those of all.

Measured on a shared machine, seconds of CPU, before and after maps took the faces' own splines:

    part     cells        before                                           after
    splines  10 x 5 x 1   refused: 32 spans miss a face by 1.8e-4 mm       map 0.6 s, in all 38 s, met, 3380 faces
    sector   2 x 3 x 1    map 0.3 s                                        map 0.5 s, in all 15 s, met, 444 faces
    lofted   any          map 0.1 s                                        map 0.1 s
    trimmed  any          refused: 32 spans miss a face by 2.4e-5 mm       map within 2.9e-5 mm of the faces
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from pathlib import Path

import build123d as bd
import numpy as np
from scipy.spatial import cKDTree
from scipy.special import comb

import tpmscad
from tpmscad import maps
from tpmscad._typing import Array, IntArray

TOL = 0.02
POINTS = 400
SAMPLES = 11
"""Samples along each side of a patch, for the starts of the Newton steps."""

CANDIDATES = 6
"""Patches on which the nearest point is looked for."""

RIM_DISTANCE = 0.02
"""Least distance of a foot point from the rim, mm."""


def plate() -> tuple[bd.Face, bd.Face]:
    """Two opposite faces of a box."""
    faces = bd.Box(30, 20, 6).faces().sort_by(bd.Axis.Z)
    return faces[0], faces[-1]


def sector() -> tuple[bd.Face, bd.Face]:
    """Coaxial cylinders of a bent bar."""
    bar = bd.revolve(bd.Plane.XZ * bd.Pos(20, 0) * bd.Rectangle(6, 12), axis=bd.Axis.Z, revolution_arc=70)
    inner, outer = bar.faces().filter_by(bd.GeomType.CYLINDER).sort_by(bd.SortBy.AREA)
    return inner, outer


def tube() -> tuple[bd.Face, bd.Face]:
    """The inner and the outer side of a pipe, around which the lattice closes."""
    pipe = bd.Cylinder(12, 20) - bd.Cylinder(8, 20)
    inner, outer = pipe.faces().filter_by(bd.GeomType.CYLINDER).sort_by(bd.SortBy.AREA)
    return inner, outer


def loft() -> tuple[bd.Face, bd.Face]:
    """Base and top of a body that tapers and twists."""
    top = bd.Plane.XY.offset(8) * bd.Rectangle(22, 16, rotation=15)
    faces = bd.loft([bd.Rectangle(30, 20), top]).faces().sort_by(bd.Axis.Z)
    return faces[0], faces[-1]


def sheet(height: float, counts: tuple[int, int], phase: float, wave: float = 1.0) -> bd.Face:
    """A face of 50 x 90 through points of a wavy sheet: cubic, C2 at its inner knots."""
    x, y = (np.linspace(0, length, n) for length, n in zip((50, 90), counts, strict=True))
    return bd.Face.make_surface_from_array_of_points(
        [[bd.Vector(a, b, height + wave * np.sin(a / 15 + phase) * np.cos(b / 17)) for b in y] for a in x]
    )


def splines() -> tuple[bd.Face, bd.Face]:
    """Two interpolated faces with different knots."""
    return sheet(0, (6, 8), 0.0), sheet(10, (5, 7), 0.7)


def lofted() -> tuple[bd.Face, bd.Face]:
    """Two opposite sides of a body that is lofted through four sections."""
    sections = [
        bd.Plane.XY.offset(z) * bd.Pos(dx, 0) * bd.Rectangle(width, 10 + z / 40)
        for z, dx, width in ((0, 0, 40), (30, 1, 44), (60, -1, 38), (90, 1, 42))
    ]
    faces = bd.loft(sections).faces().sort_by(bd.Axis.Y)
    return faces[0], faces[-1]


def trimmed() -> tuple[bd.Face, bd.Face]:
    """Two interpolated faces cut by an oblique block."""
    tool = bd.Pos(25, 45, 5) * bd.Rot(0, 0, 10) * bd.Box(30, 40, 40)
    lower, upper = ((face & tool).faces()[0] for face in splines())
    return lower, upper


PARTS = {
    "plate": (plate, (5, 3, 1), 0.6),
    "sector": (sector, (2, 3, 1), 0.6),
    "tube": (tube, (2, 8, 1), 0.3),
    "loft": (loft, (2, 2, 1), 0.6),
    "splines": (splines, (10, 5, 1), 0.8),
    "lofted": (lofted, (5, 2, 1), 0.8),
    "trimmed": (trimmed, (4, 3, 1), 0.8),
}
"""Faces, cells along the three axes of the domain, and thickness in mm."""


def read_walls(path: Path) -> dict[str, Array]:
    """Control nets (n, p + 1, q + 1, 3) of the Bezier faces of each wall, by its sign."""
    text = re.sub(r"\s*\n\s*", "", path.read_text())
    entities = dict(re.findall(r"#(\d+)\s*=\s*(.*?);(?=#|ENDSEC)", text))
    walls: dict[str, list[Array]] = {"+": [], "-": []}
    for entity in entities.values():
        face = re.match(r"ADVANCED_FACE\('surface ([+-])',\(.*?\),#(\d+)", entity)
        if not face:
            continue
        surface = re.match(r"B_SPLINE_SURFACE_WITH_KNOTS\('',(\d+),(\d+),\(\((.*?)\)\),", entities[face[2]])
        if surface is None:
            raise ValueError(f"the face's surface is {entities[face[2]][:60]}")
        rows = [re.findall(r"#(\d+)", row) for row in surface[3].split("),(")]
        net = np.array([[_read_point(entities[number]) for number in row] for row in rows])
        if net.shape[:2] != (int(surface[1]) + 1, int(surface[2]) + 1):
            raise ValueError("a face has inner knots; only Bezier patches are read here")
        walls[face[1]].append(net)
    return {sign: np.array(nets) for sign, nets in walls.items()}


def _read_point(entity: str) -> list[float]:
    found = re.search(r"\(([-\d.,Ee+]+)\)\)?$", entity)
    if found is None:
        raise ValueError(f"no point: {entity}")
    return [float(x) for x in found[1].split(",")]


def bernstein(degree: int, t: Array, order: int = 0) -> Array:
    """Bernstein polynomials (..., degree + 1) or their derivatives."""
    if order:
        lower = bernstein(degree - 1, t, order - 1)
        zero = np.zeros((*lower.shape[:-1], 1))
        return degree * (np.concatenate([zero, lower], -1) - np.concatenate([lower, zero], -1))
    i = np.arange(degree + 1)
    return comb(degree, i) * t[..., None] ** i * (1 - t[..., None]) ** (degree - i)


def evaluate(nets: Array, u: Array, v: Array, du: int = 0, dv: int = 0) -> Array:
    """Points (n, 3) of a patch each, or derivatives."""
    return np.einsum(
        "pa,pb,pabd->pd", bernstein(nets.shape[1] - 1, u, du), bernstein(nets.shape[2] - 1, v, dv), nets, optimize=True
    )


def find_feet(nets: Array, points: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """The nearest points (n, 3) of a patch each to a point each, from parameters to start at, and their distances."""
    at = np.stack([u, v], 1)
    for _ in range(60):
        r = evaluate(nets, *at.T) - points
        su, sv = evaluate(nets, *at.T, 1, 0), evaluate(nets, *at.T, 0, 1)
        tangents = np.stack([su, sv], 1)
        gradient = np.einsum("nid,nd->ni", tangents, r)
        metric = np.einsum("nid,njd->nij", tangents, tangents)
        suu, suv, svv = (evaluate(nets, *at.T, *order) for order in ((2, 0), (1, 1), (0, 2)))
        bend = np.einsum("nijd,nd->nij", np.stack([np.stack([suu, suv], 1), np.stack([suv, svv], 1)], 1), r)
        convex = np.linalg.eigvalsh(metric + bend)[:, 0] > 1e-3 * np.linalg.eigvalsh(metric)[:, 0]
        hessian = metric + np.where(convex[:, None, None], bend, 0.0)
        held = ((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0))
        diagonal = np.eye(2) * np.abs(hessian).max((1, 2))[:, None, None]
        hessian = np.where(held[:, :, None] | held[:, None, :], diagonal, hessian)
        step = -np.linalg.solve(hessian, np.where(held, 0.0, gradient)[..., None])[..., 0]
        length, before = np.ones(len(at)), (r**2).sum(1)
        for _ in range(25):
            moved = np.clip(at + length[:, None] * step, 0, 1)
            worse = ((evaluate(nets, *moved.T) - points) ** 2).sum(1) > before + 1e-15
            if not worse.any():
                break
            length = np.where(worse, length / 2, length)
        moved = np.where(worse[:, None], at, moved)
        if np.abs(moved - at).max() < 1e-11:
            break
        at = moved
    feet = evaluate(nets, *at.T)
    return feet, np.linalg.norm(feet - points, axis=1)


def find_rim(wall: Array) -> Array:
    """Points (n, 3) of the sides that only one patch of the wall has."""
    t = bernstein(wall.shape[1] - 1, np.linspace(0, 1, 41))
    sides = [np.einsum("ta,pad->ptd", t, side) for side in (wall[:, 0], wall[:, -1], wall[:, :, 0], wall[:, :, -1])]
    every = np.concatenate(sides)
    middle = every[:, 20]
    return every[cKDTree(middle).query(middle, k=2)[0][:, 1] > 1e-4].reshape(-1, 3)


def _choose_starts(near: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """For each point (rows of the nearest samples): its number, patches, and samples in these, a few each."""
    points, patches, samples = [], [], []
    for number, row in enumerate(near):
        patch, first = np.unique(row // SAMPLES**2, return_index=True)
        order = np.argsort(first)[:CANDIDATES]
        points.append(np.full(len(order), number))
        patches.append(patch[order])
        samples.append(row[first[order]] % SAMPLES**2)
    return np.concatenate(points), np.concatenate(patches), np.concatenate(samples)


def measure_thickness(path: Path, seed: int = 0) -> Array:
    """Distances from random points of one wall in a file to the whole other wall, those at the rim left out."""
    walls, rng = read_walls(path), np.random.default_rng(seed)
    other, one = walls["+"], walls["-"]
    grid = np.linspace(0, 1, SAMPLES)
    along = bernstein(other.shape[1] - 1, grid)
    tree = cKDTree(np.einsum("ga,hb,pabd->pghd", along, along, other, optimize=True).reshape(-1, 3))
    points = evaluate(one[rng.integers(0, len(one), POINTS)], *rng.uniform(0, 1, (2, POINTS)))
    number, patch, sample = _choose_starts(tree.query(points, k=400)[1])
    feet, distance = find_feet(other[patch], points[number], grid[sample // SAMPLES], grid[sample % SAMPLES])
    order = np.lexsort((distance, number))
    best = order[np.unique(number[order], return_index=True)[1]]
    rim = find_rim(other)
    inside = cKDTree(rim).query(feet[best])[0] > RIM_DISTANCE if len(rim) else np.ones(len(best), bool)
    return distance[best][inside]


def main() -> None:
    print("part     asked   least    greatest  median   points  met   faces  map s  CPU s")
    for name in sys.argv[1:] or PARTS:
        faces, cells, thickness = PARTS[name]
        begun = time.process_time()
        domain = maps.between(*faces())
        map_seconds = time.process_time() - begun
        model = tpmscad.lattice(
            "gyroid", cell=5, cells=cells, thickness=thickness, tol=TOL, map=domain, boundary="natural"
        )
        seconds = time.process_time() - begun
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "wall.step"
            model.export_step(path)
            found = measure_thickness(path)
        certificate = model.certificate
        print(
            f"{name:8s} {thickness:<6g} {found.min():8.5f} {found.max():8.5f} {np.median(found):9.5f} {len(found):7d}  "
            f"{certificate.met!s:5s} {certificate.n_faces:5d} {map_seconds:6.1f} {seconds:6.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
