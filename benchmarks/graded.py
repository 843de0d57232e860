"""Graded solids: a wall, a cell size and a volume fraction that change from place to place, with what was measured on each.

python -m benchmarks.graded [wall | sizes | cylinder] ...
python -m benchmarks.graded beside_even [BODY | FILE.step ...]

Fractions are those of the made solid: along x in slices of the box, or in shells about the cylinder's axis, by vertical lines
through triangles of its faces, beside what was asked for (the mean of the fraction field, or of a wall's own field, there).
`beside_even` fills bodies with gyroid walls of .4 to 1.2 mm whose thickness is a formula, an image, a distance from the body's
faces or scattered values, and with an even wall: CPU seconds of infill and STEP file, their ratio to the even wall's, faces a
cell, the certificate's deviation, and the greatest distance of vertices of triangles from the exact offset surface, by feet that
are found here: nearest of dense nodes, then Gauss-Newton steps with differences.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_BezierSurface, GeomAbs_BSplineSurface
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields, surfaces
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.render.tessellation import tessellate

SPACING = 0.1
"""Of the vertical lines, mm."""

FOOT_NODES, FOOT_POINTS, FOOT_STEPS = 17, 3000, 8
"""Nodes along each parameter of a patch, vertices and steps of the feet of `beside_even`."""


def wall() -> None:
    """A gyroid wall from 0.3 to 1.2 mm over four cells; 0.961 is one over the mean of 1 / slope on the mid surface, per mm."""
    phi = fields.tpms("gyroid", period=10.0)
    level = fields.ramp("x", (0, 40), (0.15 * 0.961, 0.6 * 0.961))
    made = row("wall 0.3 to 1.2 mm", fields.sheet(phi, -level, level), ((0, 0, 0), (40, 10, 10)), 0.01)
    x = np.linspace(0, 40, 5)
    # volume = area x thickness, the sheet's area is 3.0919 cells^2 a cell
    wanted = [3.0919 * 100 * np.mean(2 * level(_on_x(a, b)) / 0.961) / 1000 for a, b in zip(x[:-1], x[1:], strict=True)]
    report("slices along x", shares(made, (0, 40), (0, 10), lambda p: p[:, 0], x), wanted)


def sizes() -> None:
    """Gyroid cells from 5 mm to twice that along x."""
    cells = {"x": ((0, 30), (5, 10)), "y": ((0, 1), (5, 5)), "z": ((0, 1), (5, 5))}
    phi = fields.cell_sizes(fields.tpms("gyroid", period=1.0), **cells)
    box, x = ((0, 0, 0), (30, 10, 10)), np.linspace(0, 30, 4)
    fraction = fields.volume_fraction(fields.rod(fields.tpms("gyroid", period=1.0), -0.3))
    for kind, field in (("rod", fields.rod(phi, -0.3)), ("sheet", fields.sheet(phi, -0.3, 0.3))):
        made = row(f"cells of 5 to 10 mm, {kind}", field, box, 0.005)
        if kind == "rod":
            report("slices along x", shares(made, (0, 30), (0, 10), lambda p: p[:, 0], x), [fraction] * 3)


def cylinder() -> None:
    """Rods in a cylinder of 20 x 10 mm, cells of 5 mm; volume fraction 0.2 on the axis, 0.5 on the outside."""
    import build123d as bd

    phi = fields.tpms("gyroid", period=5.0)
    distance = fields.cylinder((0, 0, 0), 1e-9)
    fraction = fields.ramp(distance, (0, 10), (0.2, 0.5))
    field = fields.rod(phi, fields.graded_threshold(phi, fraction, (0.2, 0.5)))
    made = row("cylinder, fraction 0.2 to 0.5", field, bd.Cylinder(10, 10), 0.01)
    radii = np.array([0.0, 4.0, 6.0, 8.0, 10.0])
    found = shares(made, (-10, 10), (-10, 10), lambda p: np.hypot(p[:, 0], p[:, 1]), radii)
    wanted = []
    for low, high in zip(radii[:-1], radii[1:], strict=True):
        r = np.linspace(low, high, 401)
        wanted.append(np.trapezoid(fraction(np.column_stack([r, 0 * r, 0 * r])) * r, r) / np.trapezoid(r, r))
    report("shells about the axis", found, wanted)


def bodies() -> dict[str, Any]:
    """The bodies of `beside_even`, by name."""
    import build123d as bd

    block, bore = bd.Box(30, 24, 8), bd.Cylinder(4, 40)
    loft = bd.loft([bd.Plane.XY * bd.Ellipse(9, 6), bd.Plane.XY.offset(18) * bd.Circle(7)])
    return {
        "box": bd.Box(18, 18, 18),
        "cylinder": bd.Cylinder(8, 16),
        "bored": bd.Cylinder(10, 14) - bore,
        "bracket": bd.fillet((block + bd.Pos(-11, 0, 8) * bd.Box(8, 24, 16)).edges().group_by(bd.Axis.Z)[-1], 1) - bore,
        "loft": loft,
        "sphere": bd.Sphere(10),
    }


def gradings(body: Any, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    """Thicknesses in a box, by name: functions of points (n, 3) from .4 to 1.2 mm."""
    size, rng = high - low, np.random.default_rng(0)
    axes = [np.linspace(a, b, 24) for a, b in zip(low, high, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    image = 0.8 + 0.35 * np.sin(4 * x / size[0]) * np.cos(3 * y / size[1] + 2 * z / size[2])
    places = low + size * rng.random((400, 3))
    stress = 0.5 + 0.6 * ((places - low) / size).prod(axis=1) + 0.05 * rng.random(400)
    slope = 0.7 / size / 3
    return {
        "formula": fields.from_function(lambda p: 0.8 + (p - (low + high) / 2) @ slope),
        "image": fields.sampled(image, tuple(size / 23), origin=tuple(low)),
        "distance": fields.clip(fields.expression("1.1 + 0.12 * d", d=tpmscad.body_field(body)), 0.4, 1.1),
        "scattered": fields.clip(fields.scattered(places, stress), 0.4, 1.2),
    }


def beside_even() -> None:
    """Graded walls beside even ones; names of bodies or paths of CAD files follow on the command line."""
    known = bodies()
    for name in sys.argv[2:] or known:
        body = known[name] if name in known else tpmscad.read_body(name).shape
        low, high = (np.array(corner) for corner in enclosing_box(getattr(body, "wrapped", body)))
        cell = 6.0 if name in known else float((high - low).max()) / 6
        scale, tol = cell / 6, cell / 200
        even, c, _ = min((fill(body, cell, 0.8 * scale, tol) for _ in range(2)), key=lambda run: run[0])
        print(f"{Path(name).stem:20s} even      {even:6.1f} s      {c.n_faces:5d} faces met {c.met}", flush=True)
        for kind, thickness in gradings(body, low, high).items():
            given = thickness if scale == 1 else scale * thickness
            seconds, c, model = fill(body, cell, given, tol)
            cells = c.volume / (3.0919 * 0.8 / 6) / cell**3
            feet = greatest_distance(model, cell, given, low, high)
            print(
                f"{'':20s} {kind:9s} {seconds:6.1f} s {seconds / even:4.2f} {c.n_faces:5d} faces, {c.n_faces / cells:.0f} a cell "
                f"met {c.met} deviation {c.max_deviation / tol:.3f} tol, own feet {feet / tol:.3f} tol",
                flush=True,
            )


def fill(body: Any, cell: float, thickness: Any, tol: float) -> tuple[float, Any, Any]:
    """CPU seconds of infill and file, certificate and model."""
    begun = _seconds()
    model = tpmscad.infill(body, "gyroid", cell=cell, thickness=thickness, tol=tol)
    with TemporaryDirectory() as folder:
        model.export_step(Path(folder) / "solid.step")
    return _seconds() - begun, model.certificate, model


def greatest_distance(model: Any, cell: float, thickness: Any, low: np.ndarray, high: np.ndarray) -> float:
    """Greatest distance of some vertices of triangles of the walls from the exact offset surface."""
    patch, motions = surfaces.primitive_patch("gyroid"), surfaces.patch_symmetry("gyroid").cell_motions
    axes = [np.arange(np.floor(a / cell) - 1, np.ceil(b / cell) + 1) for a, b in zip(low, high, strict=True)]
    origins = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    turn = np.tile(motions.rotation, (len(origins), 1, 1))
    shift = (origins[:, None] + motions.translation).reshape(-1, 3)
    t = np.linspace(0, 1, FOOT_NODES)
    u, v = (np.tile(g.ravel(), len(turn)) for g in np.meshgrid(t, t))
    owner = np.repeat(np.arange(len(turn)), FOOT_NODES**2)

    def surface(i: Any, u: Any, v: Any, side: Any) -> np.ndarray:
        jet = patch.jet(u, v)
        middle = cell * (np.einsum("nij,nj->ni", turn[i], jet.position) + shift[i])
        if side == 0:
            return middle
        return middle + (0.5 * side * thickness(middle))[:, None] * np.einsum("nij,nj->ni", turn[i], jet.normal)

    middles = surface(owner, u, v, 0.0)
    near = ((middles > low - 0.3 * cell) & (middles < high + 0.3 * cell)).all(axis=1)
    owner, u, v = owner[near], u[near], v[near]
    found = tessellate(model.built.shape, 0.02 * cell)
    own = np.array([_is_wall(face) for face in faces_of(model.built.shape)])
    points = found.points[own[found.face]]
    points = points[np.random.default_rng(0).permutation(len(points))[:FOOT_POINTS]]
    least = np.full(len(points), np.inf)
    start = cKDTree(middles[near]).query(points)[1]
    for side in (-1.0, 1.0):
        i, s, t = owner[start], u[start], v[start]
        for _ in range(FOOT_STEPS):
            at, h = surface(i, s, t, side), 1e-5
            rows = [(surface(i, s + h, t, side) - at) / h, (surface(i, s, t + h, side) - at) / h]
            tangents = np.stack(rows, axis=2)
            step = np.linalg.solve(
                np.swapaxes(tangents, 1, 2) @ tangents, np.einsum("nij,ni->nj", tangents, points - at)[..., None]
            )[..., 0]
            s, t = (np.clip(x + np.clip(d, -0.1, 0.1), -0.04, 1.04) for x, d in zip((s, t), step.T, strict=True))
        least = np.minimum(least, np.linalg.norm(points - surface(i, s, t, side), axis=1))
    return float(least.max())


def _is_wall(face: Any) -> bool:
    """Whether a face is a patch of a wall: of one span and degree 9 or more, as no face of these bodies is."""
    surface = BRepAdaptor_Surface(face)
    if surface.GetType() not in (GeomAbs_BSplineSurface, GeomAbs_BezierSurface):
        return False
    return bool(surface.UDegree() >= 9 and surface.NbUPoles() == surface.UDegree() + 1)


def _on_x(low: float, high: float) -> np.ndarray:
    x = np.linspace(low, high, 201)
    return np.column_stack([x, 0 * x, 0 * x])


def row(name: str, field: fields.Field, domain: Any, tol: float) -> tpmscad.Model:
    """Print a line and return the model."""
    begun = _seconds()
    model = tpmscad.solidify(field, domain, tol=tol)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "solid.step"
        model.export_step(path)
        size = path.stat().st_size / 1e6
    c = model.certificate
    volume = c.figures.get("volume of the field")
    off = f"{c.volume / volume - 1:+.1e}" if volume else "-"
    print(
        f"{name:32s} {'met' if c.met else 'NOT met'} valid {c.valid} faces {c.n_faces} deviation {c.max_deviation:.1e} "
        f"jump {c.tangent_jump_deg:.2f} betti {c.betti} volume {c.volume:.2f} off {off} cpu {_seconds() - begun:.1f} s "
        f"STEP {size:.1f} MB {'; '.join(c.shortfalls)}",
        flush=True,
    )
    return model


def shares(model: Any, x: tuple[float, float], y: tuple[float, float], of: Any, bounds: np.ndarray) -> np.ndarray:
    """The solid's volume fraction where `of`, a function of points (n, 2) across z, lies between bounds: (len(bounds) - 1,).

    Lines stand on a grid of SPACING; on each, upper ends of pieces of the solid less lower ends are its length.
    """
    found = tessellate(model.built.shape, 0.02)
    corner = found.points[found.triangles]
    height = float(np.ptp(found.points[:, 2]))
    start = np.array([x[0], y[0]]) + 0.5 * SPACING
    counts = np.rint((np.array([x[1], y[1]]) - np.array([x[0], y[0]])) / SPACING).astype(int)
    first = np.maximum(np.ceil((corner[:, :, :2].min(axis=1) - start) / SPACING), 0).astype(int)
    last = np.minimum(np.floor((corner[:, :, :2].max(axis=1) - start) / SPACING), counts - 1).astype(int)
    size = np.maximum(last - first + 1, 0)
    t = np.repeat(np.arange(len(corner)), size.prod(axis=1))
    within = np.arange(len(t)) - np.repeat(np.cumsum(size.prod(axis=1)) - size.prod(axis=1), size.prod(axis=1))
    node = first[t] + np.column_stack([within // size[t, 1], within % size[t, 1]])
    p = start + SPACING * node
    a, b, c = (corner[t, k] for k in range(3))
    double = _cross(b - a, c - a)
    at = [corner[t, k, :2] - p for k in range(3)]
    weights = np.stack([_cross(at[1], at[2]), _cross(at[2], at[0]), _cross(at[0], at[1])], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights /= double[:, None]
    inside = (weights >= 0).all(axis=1) & (double != 0)
    z = (weights * np.stack([a[:, 2], b[:, 2], c[:, 2]], axis=1)).sum(axis=1)
    length = np.zeros(counts)
    np.add.at(length, tuple(node[inside].T), (np.sign(double) * z)[inside])
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 2)
    group = np.digitize(of(start + SPACING * grid), bounds) - 1
    ok = (group >= 0) & (group < len(bounds) - 1)
    number = len(bounds) - 1
    solid = np.bincount(group[ok], length.ravel()[ok], number)
    return solid / (height * np.bincount(group[ok], minlength=number))


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def report(what: str, found: np.ndarray, wanted: Any) -> None:
    pairs = ", ".join(f"{f:.3f} ({w:.3f})" for f, w in zip(found, wanted, strict=True))
    print(f"    {what}, fraction found (asked for): {pairs}", flush=True)


def _seconds() -> float:
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in used)


if __name__ == "__main__":
    if sys.argv[1:2] == ["beside_even"]:
        beside_even()
        sys.exit()
    for task in sys.argv[1:] or ["wall", "sizes", "cylinder"]:
        {"wall": wall, "sizes": sizes, "cylinder": cylinder}[task]()
