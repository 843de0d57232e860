"""Exchangers whose channels open at some faces only, in several bodies: whether they are made, and their figures judged apart.

    python -m benchmarks.exchanger_bodies [--surface gyroid] [--case cylinder] [--transition 10] [--file PART + - CELL WALL]

CPU seconds, whether the certificate is met, by how much the volumes miss the body's, the part of the body that is wall, the
pieces of wall and channels, the least distance of the channels, and the area of each opening, with its difference from a
quadrature of its own. What is refused with a proposal is made as proposed. --file takes a CAD file instead, the plane faces at
which the channels + and - open, cell and wall.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import build123d as bd
import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields, surfaces
from tpmscad._typing import Array
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.kernel.body_import.cad_body import read_bodies
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt.exploration import faces_of


def _make_cylinder(radius: float = 15, height: float = 30) -> bd.Part:
    """A cylinder with a port of diameter 10 on each of four sides."""
    ports = [bd.Rot(0, 0, 90 * k) * bd.Pos(radius - 1, 0, 0) * bd.Rot(0, 90, 0) * bd.Cylinder(5, 8) for k in range(4)]
    return bd.Cylinder(radius, height) + ports


def _make_shell() -> bd.Part:
    """A half ring of 12 x 14 between radii of 18 and 30."""
    ring = bd.Pos(24, 0, 0) * bd.Rectangle(12, 14)
    return bd.revolve(bd.Rot(90, 0, 0) * ring, bd.Axis.Z, 180)


def _make_manifold() -> bd.Part:
    """A core of 36 x 30 x 20 with a round nozzle of diameter 12 on each of four sides."""
    nozzles = [
        bd.Rot(0, 0, 90 * k) * bd.Pos(reach, 0, 0) * bd.Rot(0, 90, 0) * bd.Cylinder(6, 12)
        for k, reach in enumerate((20, 17, 20, 17))
    ]
    return bd.Box(36, 30, 20) + nozzles


def _make_housing() -> bd.Part:
    """A housing that swells from an ellipse to a rounded oblong and back, with two round ports at its sides."""
    outlines = [
        bd.Plane.XY.offset(z) * bd.Ellipse(rx, ry)
        for z, rx, ry in ((-22, 10, 9), (-8, 14, 11), (8, 15, 10), (22, 9, 9))
    ]
    ports = [bd.Pos(side * 13, 0, 0) * bd.Rot(0, 90, 0) * bd.Cylinder(5, 10) for side in (-1, 1)]
    return bd.loft(outlines) + ports


CROSS, COUNTER = {"+": "<X,>X", "-": "<Y,>Y"}, {"+": "<Z,>Z", "-": "<X,>X"}

CASES: dict[str, tuple[Callable[[], bd.Part], dict[str, Any]]] = {
    "box 40x20x20": (lambda: bd.Box(40, 20, 20), {"openings": CROSS, "cell": (10, 8, 10, 12)}),
    "flat box 60x40x12": (lambda: bd.Box(60, 40, 12), {"openings": CROSS, "cell": (8, 8, 8, 10), "thickness": 0.8}),
    "cylinder with four ports": (_make_cylinder, {"openings": CROSS, "cell": (10, 8, 8, 8)}),
    "half ring": (_make_shell, {"openings": {"+": "<Y", "-": "<Z,>Z"}, "cell": (10, 10, 8, 8), "thickness": 0.9}),
    "manifold with nozzles": (_make_manifold, {"openings": CROSS, "cell": (8, 8, 8, 10), "thickness": 0.7}),
    "free-form housing": (_make_housing, {"openings": COUNTER, "cell": (8, 8, 8, 10), "thickness": 0.6}),
    "small box 20x10x10": (lambda: bd.Box(20, 10, 10), {"openings": CROSS, "cell": (10,) * 4, "tol": 0.2}),
    "cylinder of the tutorial": (
        partial(_make_cylinder, 13, 20),
        {"openings": CROSS, "cell": (9,) * 4, "thickness": 0.9},
    ),
    "counter flow 20x20x40": (
        lambda: bd.Box(20, 20, 40),
        {"openings": {"+": "<Z,>Z", "-": "<Z,>Z"}, "cell": (10,) * 4},
    ),
}
"""Bodies, and what is asked of their exchangers: the cell for each of `SURFACES`, and a wall of 1 unless another is named."""

SURFACES = ("gyroid", "diamond", "primitive", "iwp")
MATRIX = 6
"""The first bodies, each with all surfaces, are the table of 24."""

PROPOSAL = re.compile(r"closed: (?:use )?a (skin|cell) of ([0-9.]+)")
"""What a refusal proposes."""

OPENING_STEP, CLOSED_STEP, WALL_STEP = 0.06, 0.1, 0.2
"""Spacing of points in openings, mm, of those on closed faces, in skins, and of those on a channel's faces, mm."""


def integrate_openings(
    made: tpmscad.FluidDomains, trees: dict[str, cKDTree], body: bd.Part, surface: str, asked: dict[str, Any]
) -> float:
    """Greatest relative difference of an opening's area from a sum over triangles in it.

    A triangle counts where the surface's normal distance is beyond the wall, and closed faces are farther than the skin. Islands
    that do not belong to the channel, dead ends that became wall, do not count. `trees` are of points on the channels.
    """
    own = faces_of(body.wrapped)
    wall = asked["thickness"]
    info = surfaces.find_surface(surface)
    distance = NormalDistance(fields.tpms(surface, asked["cell"], reference=info.references[0]))
    shift = asked["cell"] * np.array(info.one_piece.sheet)
    opened = {
        name: {contact.face for contact in made.touches if contact.areas.get(name, 0.0) > 0}
        for name in ("channel +", "channel -")
    }
    worst = 0.0
    for name, sign in (("channel +", 1.0), ("channel -", -1.0)):
        closed = [face for number, face in enumerate(own) if number not in opened[name]]
        skin = asked.get("skin", wall)
        tree = cKDTree(sample_faces(closed, CLOSED_STEP * skin).points)
        for contact in made.touches:
            if contact.face not in opened[name]:
                continue
            centres, areas = _divide_face(own[contact.face])
            free = sign * distance(centres - shift) > 0.5 * wall
            free[free] = tree.query(centres[free], distance_upper_bound=skin)[0] >= skin
            centres, areas = centres[free], areas[free]
            island = connected_components(
                cKDTree(centres).sparse_distance_matrix(cKDTree(centres), 2.5 * OPENING_STEP, output_type="coo_matrix")
            )[1]
            is_channel = trees[name].query(centres, distance_upper_bound=0.4 * wall)[0] < np.inf
            kept = np.bincount(island, is_channel) > 0.5 * np.bincount(island)
            worst = max(worst, abs(areas[kept[island]].sum() / contact.areas[name] - 1.0))
    return worst


def _divide_face(face: Any) -> tuple[Array, Array]:
    """Centres (n, 3) and areas (n,) of small triangles of a plane face."""
    vertices, triangles = bd.Face(face).tessellate(0.002, 0.05)
    corners = np.array([tuple(v) for v in vertices])[np.array(triangles)]
    while True:
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        long = edge.max(axis=1) > 2 * OPENING_STEP
        if not long.any():
            break
        halved = corners[long]
        k = np.argmax(edge[long], axis=1)
        rows = np.arange(len(halved))
        a, b, c = (halved[rows, (k + i) % 3] for i in (0, 2, 1))  # a b is the longest
        middle = 0.5 * (a + b)
        corners = np.concatenate([corners[~long], np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), 0.5 * np.linalg.norm(normal, axis=1)


def run_openings(names: Sequence[str], case: str, transition: float | None, file: Sequence[str] | None) -> None:
    """Print what is made of each body, or why it is not, and then what is made as the refusal proposes."""
    cases = {name: made for name, made in CASES.items() if case in name}
    if file:
        path, plus, minus, cell, wall = file
        size = {"cell": (float(cell),) * len(SURFACES), "thickness": float(wall)}
        cases = {path: (lambda: bd.Part(read_bodies(path)[0].shape), {"openings": {"+": plus, "-": minus}} | size)}
    found: list[tuple[str, float]] = []
    for number, (name, (make, given)) in enumerate(cases.items()):
        for surface in names:
            asked = {"thickness": 1.0, "tol": 0.1} | given
            asked["cell"] = asked["cell"][SURFACES.index(surface) if surface in SURFACES else 0]
            body = make()
            outcome, seconds, error = _make_exchanger(body, surface, transition, asked)
            label = f"{name}, {surface} {asked['cell']:g}/{asked['thickness']:g}"
            if error and (proposal := PROPOSAL.search(error)):
                print(f"{label}: refused in {seconds:.1f} CPU s, {error}", flush=True)
                asked |= {proposal[1]: float(proposal[2])}
                outcome, seconds, error = _make_exchanger(body, surface, transition, asked)
                label = f"{label} with a {proposal[1]} of {proposal[2]}"
            print(f"{label}: {seconds:.1f} CPU s, {error or outcome}", flush=True)
            if number < MATRIX:
                found.append(("not made" if error else outcome.split(",")[0], seconds))
    if len(found) > 1:
        met = sum(state == "met" for state, _ in found)
        print(f"{met} of {len(found)} met, median {np.median([seconds for _, seconds in found]):.1f} CPU s")


def _make_exchanger(
    body: bd.Part, surface: str, transition: float | None, asked: dict[str, Any]
) -> tuple[str, float, str]:
    """What was made, in figures, or the error; and the CPU seconds that it took."""
    begun = time.process_time()
    try:
        made = tpmscad.fluid_domains(body, surface, transition=transition, progress=False, **asked)
    except tpmscad.TpmscadError as error:
        return "", time.process_time() - begun, f"{type(error).__name__}: {error}"
    seconds, certificate = time.process_time() - begun, made.certificate
    (read,) = read_bodies(body)
    pieces = [len(model.certificate.pieces) for model in made.domains.values()]
    areas = [
        f"{domain} {area:.5g} on {contact.label}"
        for contact in made.touches
        for domain, area in contact.areas.items()
        if domain != "wall"
    ]
    trees = {
        name: cKDTree(sample_faces(faces_of(made.domains[name].wrapped), WALL_STEP, exact=True).points)
        for name in ("channel +", "channel -")
    }
    off = integrate_openings(made, trees, body, surface, asked) if not transition else float("nan")
    apart = trees["channel +"].query(trees["channel -"].data)[0].min()  # parallel faces 1 apart: at most 0.01 more
    return (
        f"{'met' if certificate.met else certificate.shortfalls}, volumes {made.volume / read.volume - 1:+.1e} off, "
        f"{made.wall.volume / made.volume:.0%} wall, pieces {pieces}, channels {apart:.4f} apart, "
        f"openings {off:.1e} off: {'; '.join(areas)}",
        seconds,
        "",
    )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surface", nargs="+", default=SURFACES)
    parser.add_argument("--case", default="", help="a part of the name of those that are made")
    parser.add_argument("--transition", type=float, help="length over which channels close, mm")
    parser.add_argument("--file", nargs=5, metavar=("PART", "PLUS", "MINUS", "CELL", "WALL"), help="a CAD file")
    given = parser.parse_args()
    run_openings(given.surface, given.case, given.transition, given.file)


if __name__ == "__main__":
    main()
