"""Strut lattices of every kind as solids, judged apart.

    python -m benchmarks.struts [--kinds bcc,octet] [--cells 2] [--only box,cylinder,foam,wall] [--nodes sharp,balls]

Every kind, sharp and with balls, of struts of 1 mm in a box of cells of 10 mm and in a cylinder within it; the Voronoi foam of
100 cells; octet fused with the wall of a gyroid. Each row: faces, Betti numbers, b1 = E - V + 1 of the graph, volume, its
difference (with the loose pieces that were left out) from 10^6 random points in standard errors, its relative difference from the
exact volume (an integral over one angle for each end of a strut, see `exact_volume`), whether the STEP file reads back valid, CPU
seconds of making and of writing it, and how many loose pieces were left out.
--files FOLDER keeps the STEP files.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import Voronoi

import tpmscad
from tpmscad import fields
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.solids.matter.strut_boundaries import bound_struts_in_box
from tpmscad.strut_cells import KINDS

CELL, DIAMETER, BALL, SAMPLES = 10.0, 1.0, 0.9, 1_000_000


def exact_volume(field: StrutsField, lo: np.ndarray, hi: np.ndarray, steps: int = 20_000) -> float:
    """The volume of equal struts in a box whose sides their nodes lie in, or keep clear of, by an integral over angles.

    At a node, the cell of a strut along the unit vector d is bounded by cot theta >= h(phi) about it, the greatest of
    e . d_j / (1 - d . d_j) of its neighbours d_j and e . n / (-d . n) of the sides of normal n that it leaves, e(phi) across
    it. With radius r the strut loses r^3 h / 3 of r^2 l / 2 for each radian; where h is below c = sqrt((R / r)^2 - 1), the
    strut begins at c, and the ball of radius R adds R^3 / 3 (cos theta_c - cos theta_h). Without balls R = r, and c = 0.
    """
    r, big = float(field.radii[0, 0]), float(field.balls.max())
    c = np.sqrt(max((big / r) ** 2 - 1, 0.0))
    at: dict[int, list[tuple[int, np.ndarray]]] = {}
    for k, (i, j) in enumerate(field.edges.tolist()):
        d = field.points[j] - field.points[i]
        d = d / np.linalg.norm(d)
        at.setdefault(i, []).append((k, d))
        at.setdefault(j, []).append((k, -d))
    total = 0.0
    phi = (np.arange(steps) + 0.5) * (2 * np.pi / steps)
    sides = np.concatenate([-np.eye(3), np.eye(3)])
    for node, star in at.items():
        point = field.points[node]
        depth = np.concatenate([point - lo, hi - point])
        normals = sides[np.abs(depth) < 1e-9 * float((hi - lo).max())]
        for k, d in star:
            across = np.linalg.svd(d[None])[2][1:]
            e = np.cos(phi)[:, None] * across[0] + np.sin(phi)[:, None] * across[1]
            h = np.full(steps, -np.inf)
            for other, along in star:
                if other != k:
                    h = np.maximum(h, e @ along / (1 - d @ along))
            inside = np.ones(steps, bool)
            for n in normals:
                if abs(d @ n) < 1e-9:
                    inside &= e @ n < 0
                else:
                    h = np.maximum(h, e @ n / (-d @ n))
            length = np.linalg.norm(np.subtract(*field.points[field.edges[k]]))
            cosine = np.where(np.isinf(h), -1.0, h / np.sqrt(1 + np.where(np.isinf(h), 0.0, h) ** 2))
            ball = np.where(h < c, big**3 / 3 * (c / np.sqrt(1 + c * c) - cosine), 0.0)
            each = r**2 * length / 4 - r**3 / 3 * np.maximum(h, c) + ball
            total += float(each[inside].sum()) * (2 * np.pi / steps)
    return total


def report(
    name: str,
    field: fields.Field,
    size: float,
    make: Callable[[], tpmscad.Model],
    *,
    body: fields.Field | None = None,
    folder: Path | None = None,
) -> bool:
    """Make a solid, judge it against random points, print a line, and say whether it is right."""
    begun = time.process_time()
    try:
        model = make()
    except tpmscad.TpmscadError as error:
        print(f"{name:<34} refused: {error}", flush=True)
        return False
    made = time.process_time()
    points = size * np.random.default_rng(3).random((SAMPLES, 3))
    inside = (field(points) < 0) & (True if body is None else body(points) < 0)
    share = inside.mean()
    dropped = model.certificate.dropped
    off = ((model.volume + sum(dropped)) / size**3 - share) / np.sqrt(share * (1 - share) / SAMPLES)
    left_out = f"{len(dropped)} left out " if dropped else ""
    graph, exact = "", ""
    if isinstance(field, StrutsField) and body is None:
        graph = str(len(field.edges) - len(field.points) + 1)
        exact = f"{model.volume / exact_volume(field, np.zeros(3), np.full(3, size)) - 1:.0e}"
    with tempfile.TemporaryDirectory() as temporary:
        path = (folder or Path(temporary)) / f"{name.replace(',', '').replace(' ', '_')}.step"
        begun_writing = time.process_time()
        model.export_step(path)
        writing = time.process_time() - begun_writing
        valid = tpmscad.check_step(path).ok
    right = model.certificate.met and valid and abs(off) < 3
    print(
        f"{name:<34} {'met' if model.certificate.met else 'NOT':>4} {model.certificate.n_faces:6d} "
        f"{model.certificate.betti!s:>12} {graph:>4} {model.volume:9.3f} {off:+5.1f} {exact:>7} "
        f"{'valid' if valid else 'NOT VALID':>9} {made - begun:6.1f} {writing:6.1f}  {left_out}{'' if right else 'WRONG'}",
        flush=True,
    )
    return right


def make_foam(count: int, size: float, shortest: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the Voronoi cells of random points in a box; edges shorter than `shortest` are shrunk to a node.

    The points are mirrored in the sides, so that no edge crosses them.
    """
    seeds = size * np.random.default_rng(seed).random((count, 3))
    for _ in range(4):  # Lloyd's relaxation, by the mean of the corners of each cell
        found = _bounded(seeds, size)
        seeds = np.array([found.vertices[found.regions[r]].mean(axis=0) for r in found.point_region[:count]])
    found = _bounded(seeds, size)
    edges = {
        (min(a, b), max(a, b))
        for (i, j), ridge in zip(found.ridge_points, found.ridge_vertices, strict=True)
        if min(i, j) < count
        for a, b in zip(ridge, [*ridge[1:], ridge[0]], strict=True)
    }
    pairs = np.array(sorted(edges))
    points = np.where(
        abs(found.vertices) < 1e-9, 0.0, np.where(abs(found.vertices - size) < 1e-9, size, found.vertices)
    )
    while True:
        length = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
        at = int(np.argmin(length))
        if length[at] >= shortest:
            return points, pairs
        a, b = pairs[at].tolist()
        on_sides = [((points[k] == 0) | (points[k] == size)) for k in (a, b)]
        kept, gone = (a, b) if on_sides[0].sum() >= on_sides[1].sum() else (b, a)  # nodes in sides stay in them
        pairs = np.where(pairs == gone, kept, pairs)
        pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def _bounded(seeds: np.ndarray, size: float) -> Voronoi:
    """The Voronoi diagram of points and of their images in the sides of a box."""
    images = [seeds]
    for axis in range(3):
        for wall in (0.0, size):
            mirrored = seeds.copy()
            mirrored[:, axis] = 2 * wall - mirrored[:, axis]
            images.append(mirrored)
    return Voronoi(np.concatenate(images))


def list_cases(
    options: argparse.Namespace,
) -> Iterator[tuple[str, fields.Field, float, Callable[[], tpmscad.Model], Any]]:
    """Name, field, size of the box, maker and body of each row."""
    size = CELL * options.cells
    box = ((0.0, 0.0, 0.0), (size,) * 3)
    chosen = options.only.split(",")
    radii = [radius for name, radius in (("sharp", 0.0), ("balls", BALL)) if name in options.nodes.split(",")]
    for place in ("box", "cylinder"):
        for kind in options.kinds.split(",") if place in chosen else ():
            for ball in radii:
                field = fields.strut_lattice(kind, CELL, DIAMETER, options.cells, ball)
                name = f"{kind}{', balls' if ball else ''}"
                if place == "box":
                    yield name, field, size, partial(tpmscad.solidify, field, box, tol=0.01, progress=False), None
                else:
                    body = fields.cylinder((size / 2,) * 3, 0.415 * size, "z", 0.75 * size)
                    make = partial(tpmscad.infill, body, field, tol=0.02, progress=False)
                    yield f"{name}, cylinder", field, size, make, body
    if "foam" in chosen:
        foam = fields.struts(*make_foam(100, 50.0, 2.2), DIAMETER)
        foam_box = ((0.0, 0.0, 0.0), (50.0,) * 3)
        yield "Voronoi foam", foam, 50.0, partial(tpmscad.solidify, foam, foam_box, tol=0.01, progress=False), None
    if "wall" in chosen:
        fused = fields.strut_lattice("octet", CELL, DIAMETER) | fields.sheet(fields.tpms("gyroid", CELL), -0.2, 0.2)
        cell = ((0.0, 0.0, 0.0), (CELL,) * 3)
        yield (
            "octet and gyroid wall",
            fused,
            CELL,
            partial(tpmscad.solidify, fused, cell, tol=0.02, progress=False),
            None,
        )


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--cells", type=int, default=2)
    parser.add_argument("--only", default="box,cylinder,foam,wall")
    parser.add_argument("--nodes", default="sharp,balls")
    parser.add_argument("--files", type=Path)
    options = parser.parse_args(arguments)
    print("faces of one cell, sharp: " + ", ".join(f"{kind} {count_faces(kind)}" for kind in options.kinds.split(",")))
    print(f"{'':34}  met  faces        Betti graph   volume   off   exact      file   make  write")
    rows = [
        report(name, field, size, make, body=body, folder=options.files)
        for name, field, size, make, body in list_cases(options)
    ]
    print(f"{sum(rows)} of {len(rows)} are right")


def count_faces(kind: str) -> int:
    """Faces of one cell."""
    field = fields.strut_lattice(kind, CELL, DIAMETER)
    return len(bound_struts_in_box(field, np.zeros(3), np.full(3, CELL)).faces)


if __name__ == "__main__":
    main()
