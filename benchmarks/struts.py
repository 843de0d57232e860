"""Strut lattices of every kind as solids, judged apart.

    python -m benchmarks.struts [--kinds bcc,octet] [--cells 2] [--body] [--foam] [--wall]

Every kind, sharp and with balls, in a box of cells of 10 mm with struts of 1 mm: faces, Betti numbers beside b1 = E - V + 1 of
the graph, volume and its difference from 10^6 random points in standard errors, whether the file reads back valid, CPU seconds.
--body: the same within a cylinder. --foam: the Voronoi foam of 100 cells. --wall: octet fused with the wall of a gyroid.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import Voronoi

import tpmscad
from tpmscad import fields
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.strut_cells import KINDS

CELL, DIAMETER, BALL, SAMPLES = 10.0, 1.0, 0.9, 1_000_000


def report(
    name: str, field: fields.Field, size: float, make: Callable[[], tpmscad.Model], body: fields.Field | None = None
) -> None:
    """Make a solid, judge it against random points, and print a line."""
    begun = time.process_time()
    try:
        model = make()
    except tpmscad.TpmscadError as error:
        print(f"{name:<32} refused: {error}", flush=True)
        return
    seconds = time.process_time() - begun
    points = size * np.random.default_rng(3).random((SAMPLES, 3))
    inside = (field(points) < 0) & (True if body is None else body(points) < 0)
    share = inside.mean()
    off = (model.volume / size**3 - share) / np.sqrt(share * (1 - share) / SAMPLES)
    with tempfile.TemporaryDirectory() as folder:
        model.export_step(Path(folder) / "made.step")
        valid = tpmscad.check_step(Path(folder) / "made.step").ok
    graph = f" (graph {len(field.edges) - len(field.points) + 1})" if isinstance(field, StrutsField) else ""
    print(
        f"{name:<32} {'met' if model.certificate.met else 'NOT met'}, {model.certificate.n_faces} faces, "
        f"Betti {model.certificate.betti}{graph}, volume {model.volume:.6g} ({off:+.1f}), "
        f"{'valid' if valid else 'NOT VALID'}, {seconds:.1f} s",
        flush=True,
    )


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


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--cells", type=int, default=2)
    parser.add_argument("--body", action="store_true")
    parser.add_argument("--foam", action="store_true")
    parser.add_argument("--wall", action="store_true")
    options = parser.parse_args(arguments)
    size = CELL * options.cells
    box = ((0.0, 0.0, 0.0), (size,) * 3)
    if options.foam:
        points, pairs = make_foam(100, 50.0, 2.2)
        foam = fields.struts(points, pairs, DIAMETER)
        foam_box = ((0.0, 0.0, 0.0), (50.0,) * 3)
        report("Voronoi foam", foam, 50.0, lambda: tpmscad.solidify(foam, foam_box, tol=0.01, progress=False))
        return
    if options.wall:
        fused = fields.strut_lattice("octet", CELL, DIAMETER) | fields.sheet(fields.tpms("gyroid", CELL), -0.2, 0.2)
        cell = ((0.0, 0.0, 0.0), (CELL,) * 3)
        report("octet and gyroid wall", fused, CELL, lambda: tpmscad.solidify(fused, cell, tol=0.02, progress=False))
        return
    for kind in options.kinds.split(","):
        for ball in (0.0, BALL):
            field = fields.strut_lattice(kind, CELL, DIAMETER, options.cells, ball)
            name = f"{kind}{f', balls of {ball:g}' if ball else ''}"
            if options.body:
                body = fields.cylinder((size / 2,) * 3, 0.415 * size, "z", 0.75 * size)
                report(name, field, size, lambda f=field, b=body: tpmscad.infill(b, f, tol=0.02, progress=False), body)  # type: ignore[misc]
            else:
                report(name, field, size, lambda f=field: tpmscad.solidify(f, box, tol=0.01, progress=False))  # type: ignore[misc]


if __name__ == "__main__":
    main()
