"""Parts filled with a lattice beside the kernel's plain boolean of the same lattice and body, in one run.

    python -m benchmarks.infill [--bodies box,cylinder,sphere,bracket,torus] [--surfaces gyroid,diamond,schwarz_p,iwp] [--cells 4]
                                [--plain] [--limit 8] [--lines 160, 0 for none]

Columns: faces of the result; CPU seconds of the trimming, from the whole patches to the solid, with the kernel's check of it and
a sample's; with `--plain` those of BRepAlgoAPI_Common of the block of the same patches with the body and of the kernel's check of
what comes out (the making of the block is not counted), the ratio of both together to the trimming, and of volumes; with
`--limit` the kernel is stopped after so many times the seconds of the trimming, and the ratio says only that it is above; the
volume, and how far it is from a quadrature that knows neither: straight lines through the body, cut at its faces by the kernel's
line intersector, and between these where the distance to the walls, by densely spread nodes of theirs, changes sign; last, CPU
seconds of the whole row.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import time
from collections.abc import Callable
from dataclasses import replace

import build123d as bd
import numpy as np
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
from scipy.spatial import cKDTree

from tpmscad import surfaces
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.requests.lattice_request import LatticeRequest, read_lattice_request
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import intersect
from tpmscad.solids.matter.lattice_block import build_lattice_block
from tpmscad.stage_timer import StageTimer

SIZE = 40.0
WALL = 0.1
"""Thickness over cell."""


ALONG = np.array([0.3713906763541037, 0.5570860145311556, 0.7427813527082074])
ACROSS = np.array(
    [[0.8320502943378437, -0.5547001962252291, 0.0], [-0.4120209620996838, -0.6180314431495257, 0.6695340634119862]]
)
"""The lines' direction, and two across it."""

STEPS = 80
"""Of the quadrature, per cell: along the lines, and between the nodes that tell the distance to the walls."""

AROUND = 40
"""Steps around the body within which walls are looked at: half a cell, farther than any point is from a wall."""


def bracket() -> bd.Solid:
    """An angle bracket, 40 x 30 x 30: a fillet in the corner, rounded ends, two bolt holes and a bearing hole."""
    part = bd.Box(40, 30, 8) + bd.Pos(-16, 0, 11) * bd.Box(8, 30, 30)
    inner = [e for e in part.edges().filter_by(bd.Axis.Y) if (e.center() - bd.Vector(-12, 0, 4)).length < 1e-6]
    part = bd.fillet(inner, 5)
    part = bd.fillet(part.edges().filter_by(bd.Axis.Z).group_by(bd.Axis.X)[-1], 5)
    for y in (8, -8):
        part -= bd.Pos(8, y, 0) * bd.Cylinder(3, 20)
    return (part - bd.Pos(-16, 0, 18) * bd.Rot(0, 90, 0) * bd.Cylinder(4, 20)).solid()


def loft() -> bd.Solid:
    """A free-form body: an ellipse that becomes a rounded rectangle."""
    low = bd.Ellipse(SIZE / 2, SIZE / 3)
    high = bd.Pos(0, 0, SIZE / 2) * bd.RectangleRounded(SIZE / 2, SIZE / 2, SIZE / 8)
    return bd.loft([low.face(), high.face()]).solid()


BODIES: dict[str, Callable[[], bd.Shape]] = {
    "box": lambda: bd.fillet(bd.Box(SIZE, SIZE, SIZE).edges(), SIZE / 8),
    "cylinder": lambda: bd.Cylinder(SIZE / 2, SIZE),
    "sphere": lambda: bd.Sphere(SIZE / 2),
    "bracket": bracket,
    "torus": lambda: bd.Torus(SIZE / 2 - SIZE / 8, SIZE / 8),
    "loft": loft,
}


def wanted(surface: str, cell: float) -> LatticeRequest:
    """A sheet of a tenth of the cell."""
    reference = surfaces.find_surface(surface).references[0]
    request = read_lattice_request(
        surface,
        cell=cell,
        cells=1,
        thickness=WALL * cell,
        offset=None,
        volume_fraction=None,
        kind="sheet",
        side="-",
        reference=reference,
        boundary="box",
        phase=(0.05, 0.1, 0.15),
        tol=None,
    )
    return replace(request, reference=reference)


def wall_nodes(patches: object, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and outward normals of the lattice's walls, densely."""
    faces = patches.faces
    nodes, normals = [], []
    for index in np.unique(faces.carrier):
        carrier = patches.carriers[index]
        n = 1 + int(np.ceil(np.linalg.norm(np.ptp(carrier.poles, axis=(0, 1))) / spacing))
        u, v = (g.ravel() for g in np.meshgrid(*(np.linspace(*d, n) for d in carrier.domain), indexing="ij"))
        own = np.flatnonzero(faces.carrier == index)
        motion = faces.motion[own]
        way = faces.sense[own] * motion.handedness
        nodes.append(motion[:, None].apply(carrier(u, v)).reshape(-1, 3))
        normal = motion[:, None].apply_to_vectors(carrier.normal(u, v)) * way[:, None, None]
        normals.append((normal / np.linalg.norm(normal, axis=-1, keepdims=True)).reshape(-1, 3))
    return np.concatenate(nodes), np.concatenate(normals)


def quadrature(solid: object, volume: float, patches: object, lines: int, step: float) -> float:
    """Volume of lattice and body along lines: the body's part of each exactly, the lattice's by the distance from its walls.
    What the lines find of the body itself, against its `volume`, corrects for their number.

    The lines' grid is a lattice of rank one, askew to everything.
    """
    low, high = enclosing_box(solid)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    nodes, normals = wall_nodes(patches, step)
    beside = ((nodes > low - AROUND * step) & (nodes < high + AROUND * step)).all(axis=1)
    nodes, normals = nodes[beside], normals[beside]
    tree = cKDTree(nodes)
    shooter = IntCurvesFace_ShapeIntersector()
    shooter.Load(solid, 1e-7)
    n = lines * lines
    aside = radius * (2 * np.stack([(np.arange(n) + 0.5) / n, (np.arange(n) * 0.6180339887498949 + 0.37) % 1.0], 1) - 1)
    spans = []
    for start in middle + aside @ ACROSS - radius * ALONG:
        shooter.Perform(gp_Lin(gp_Pnt(*start.tolist()), gp_Dir(*ALONG.tolist())), 0.0, 2 * radius)
        t = np.sort([shooter.WParameter(i) for i in range(1, shooter.NbPnt() + 1)])
        t = t[np.concatenate([[True], np.diff(t) > 1e-7])] if len(t) else t
        if len(t) % 2 == 0:  # a line that grazes an edge says nothing
            spans += [(start, a, b) for a, b in zip(t[::2], t[1::2], strict=True)]
    total = 0.0
    for start in range(0, len(spans), 512):
        points, widths, owner = [], [], []
        for foot, a, b in spans[start : start + 512]:
            k = max(2, int(np.ceil((b - a) / step)))
            t = np.linspace(a, b, k + 1)
            points.append(foot + t[:, None] * ALONG)
            widths.append(np.append(np.diff(t), 0.0))
            owner.append(np.append(np.ones(k), 0.0))
        at, width, inner = np.concatenate(points), np.concatenate(widths), np.concatenate(owner)
        nearest = tree.query(at)[1]
        value = np.einsum("ni,ni->n", at - nodes[nearest], normals[nearest])
        a, b = value[:-1], value[1:]
        share = np.where((a < 0) & (b < 0), 1.0, 0.0)
        cross = (a < 0) != (b < 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            share[cross] = np.where(a < 0, a / (a - b), b / (b - a))[cross]
        total += float((share * width[:-1] * inner[:-1]).sum())
    return total / sum(b - a for _, a, b in spans) * volume


def intersect_by_kernel(block: object, body: object, limit: float) -> tuple[float, float, float] | None:
    """CPU seconds of the kernel's common and of its check, and its volume; None after `limit` CPU seconds, in a process apart."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        used = time.process_time()
        if np.isfinite(limit):
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used + limit), math.ceil(used + limit)))
        common = BRepAlgoAPI_Common(block, body).Shape()
        made = time.process_time()
        BRepCheck_Analyzer(common, True, False).IsValid()  # the kernel's threads do not survive a fork
        checked = time.process_time()
        text = json.dumps([made - used, checked - made, check_shape(common).volume])
        os.write(writing, text.encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return tuple(json.loads(text)) if text else None


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", default="box,cylinder,sphere,bracket,torus")
    parser.add_argument("--surfaces", default="gyroid,diamond,schwarz_p,iwp")
    parser.add_argument("--cells", type=float, default=4.0)
    parser.add_argument("--lines", type=int, default=160)
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--limit", type=float, default=math.inf)
    options = parser.parse_args(arguments)
    print(
        f"{'body':>9} {'surface':>10} {'by':>8} {'faces':>6} {'trim s':>7} {'common s':>8} {'check s':>7} {'ratio':>6} "
        f"{'volume':>12} {'plain - own':>12} {'lines/own - 1':>13} {'row s':>6}"
    )
    for body_name in options.bodies.split(","):
        body = read_body(BODIES[body_name]())
        for surface in options.surfaces.split(","):
            first = time.process_time()
            request = wanted(surface, SIZE / options.cells)
            block = build_lattice_block(request, np.eye(3), body, StageTimer(None))
            begun = time.process_time()
            cut = intersect(KernelBody(body), block, body)
            shape = cut.built.shape  # made when it is asked for
            own = time.process_time() - begun
            report = check_shape(shape)
            assert report.ok, report
            plain, check, apart, ratio = float("nan"), float("nan"), float("nan"), ""
            if options.plain:
                found = intersect_by_kernel(block.built.shape, body.shape, options.limit * own)
                if found is None:
                    ratio = f"> {options.limit:g}"
                else:
                    plain, check, volume = found
                    ratio, apart = f"{(plain + check) / own:.1f}", volume / report.volume - 1
            lines = float("nan")
            if options.lines:
                step = request.cell[0] / STEPS
                counted = quadrature(body.shape, body.volume, block.patches, options.lines, step)
                lines = counted / report.volume - 1
            print(
                f"{body_name:>9} {surface:>10} {cut.trimmed_by:>8} {report.faces:>6} {own:7.2f} {plain:8.2f} {check:7.2f} "
                f"{ratio:>6} {report.volume:12.4f} {apart:12.1e} {lines:13.1e} "
                f"{time.process_time() - first:6.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
