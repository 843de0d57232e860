"""A counter-flow heat exchanger with manifolds: a gyroid core in a closed skin, with headers at its ends and sides.

The skin closes both channels of the core. Round holes through it, each in the middle of an opening of one channel, lead to the
headers: those at the ends to channel +, those at the sides to channel -. Fluid + flows up, fluid - flows down, and the wall keeps
them apart. Wall and fluids are a solid each, in STEP files of their own, as conjugate heat transfer needs them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from scipy.spatial import KDTree

import tpmscad
from tpmscad import fields

CELL, THICKNESS, SKIN = 8.0, 0.8, 1.2
PHASE = (0.25, 0.0, 0.0)
"""Each channel is then one piece within the skin: nothing is cut off in a corner."""

HOLE, RIM_VALUE = 1.0, 0.5
"""Radius of the holes in the skin, and least nodal value on their rims: the wall ends where it is 0.4."""

SHELL, HEIGHT, TAPER = 1.2, 5.0, 30.0
"""Of a header: wall, height, and inclination of its sides in degrees."""

BORE, PIPE = 1.6, 5.0
"""Of the pipe on a header: inner radius, and length beyond the header."""

OVERLAP = 0.3
"""How far a hole reaches into what it connects, so that no faces of the two coincide."""

SAMPLE_SPACING = 0.15

Port = tuple[bd.Plane, float, float]
"""A rectangle on the skin, which a header covers: its plane, from a corner outwards, its width and height."""


def hole_places(port: Port, sign: int) -> list[bd.Location]:
    """Places on a port under which the channel of that sign is widest, at least half a cell apart."""
    plane, width, height = port
    phi = fields.translate(fields.tpms("gyroid", period=CELL), CELL * np.array(PHASE))
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    rim = HOLE * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    margin = max(SKIN, SHELL) + HOLE + 0.2
    u, v = (np.arange(margin, size - margin, 0.1) for size in (width, height))
    centre = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    inside = np.array([*plane.origin]) - SKIN * np.array([*plane.z_dir])
    value = (sign * phi(inside + (centre + rim) @ np.array([[*plane.x_dir], [*plane.y_dir]]))).min(axis=1)
    found: list[bd.Location] = []
    while value.max() > RIM_VALUE:
        place = centre[np.argmax(value), 0]
        found.append(plane.location * bd.Pos(*place, 0))
        value[np.linalg.norm(centre[:, 0] - place, axis=1) < CELL / 2] = -np.inf
    return found


def make_header(port: Port) -> tuple[bd.Solid, bd.Solid]:
    """The outside of a header with its pipe, and the room for the fluid inside."""
    plane, width, height = port
    middle, length = plane.location * bd.Pos(width / 2, height / 2, 0), HEIGHT + PIPE
    frusta = [
        bd.extrude(bd.Rectangle(width - 2 * inset, height - 2 * inset), HEIGHT - inset, taper=TAPER)
        for inset in (0.0, SHELL)
    ]
    pipes = [bd.Pos(0, 0, length / 2) * bd.Cylinder(BORE + wall, length) for wall in (SHELL, 0.0)]
    outside, room = (middle * (frustum + pipe) for frustum, pipe in zip(frusta, pipes, strict=True))
    return outside.solid(), room.solid()


def make_exchanger(cells: tuple[int, int, int], tol: float) -> tuple[tpmscad.Model, bd.Solid, dict[str, bd.Solid]]:
    """The core in its skin; the wall of the whole; its hull, fluid + and fluid -, by name."""
    x, y, z = (CELL * n for n in cells)
    box = bd.Box(x, y, z, align=bd.Align.MIN)
    core = tpmscad.infill(box, "gyroid", cell=CELL, thickness=THICKNESS, skin=SKIN, phase=PHASE, tol=tol)
    closed = [bd.Solid(shell) for shell in core.solid.shells()]
    hull, *channels = sorted(closed, key=lambda solid: -solid.volume)  # the box, and the two voids in it
    ports: dict[int, list[Port]] = {
        1: [(bd.Plane((0, y, 0), (1, 0, 0), (0, 0, -1)), x, y), (bd.Plane((0, 0, z)), x, y)],
        -1: [
            (bd.Plane((x, 0, z - CELL), (0, 1, 0), (1, 0, 0)), y, CELL),
            (bd.Plane((0, y, 0), (0, -1, 0), (-1, 0, 0)), y, CELL),
        ],
    }
    wall, fluids = core.solid, {}
    for sign, name in ((1, "fluid +"), (-1, "fluid -")):
        places = [place for port in ports[sign] for place in hole_places(port, sign)]
        holes = [place * bd.Pos(0, 0, -SKIN / 2) * bd.Cylinder(HOLE, SKIN + 2 * OVERLAP) for place in places]
        headers = [make_header(port) for port in ports[sign]]
        within = bd.Vector(*(places[0] * bd.Pos(0, 0, -SKIN - OVERLAP)).position)
        (channel,) = (solid for solid in channels if solid.is_inside(within))
        fluids[name] = channel.fuse(*holes, *(room for _, room in headers))
        wall = wall.cut(*holes).fuse(*((outside - room).solid() for outside, room in headers))
        hull = hull.fuse(*(outside for outside, _ in headers))
    return core, wall, {"hull": hull, **fluids}


def estimate_gap(first: bd.Solid, second: bd.Solid) -> float:
    """The least distance of two solids, from random points on meshes of their surfaces."""
    clouds = []
    for solid in (first, second):
        vertices, triangles = solid.tessellate(0.02, 0.2)
        a, b, c = (np.array([[*v] for v in vertices])[np.array(triangles)[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        random = np.random.default_rng(1)
        n = random.choice(len(area), round(area.sum() / SAMPLE_SPACING**2), p=area / area.sum())
        s, t = np.sqrt(random.random((len(n), 1))), random.random((len(n), 1))
        clouds.append((1 - s) * a[n] + s * (1 - t) * b[n] + s * t * c[n])
    return float(KDTree(clouds[0]).query(clouds[1])[0].min())


def main(folder: str | Path = ".", cells: tuple[int, int, int] = (2, 2, 2), tol: float = 0.1) -> dict[str, Any]:
    """Make, write and draw an exchanger of so many cells; return what was measured on it, in mm."""
    core, wall, parts = make_exchanger(cells, tol)
    hull, plus, minus = parts.values()
    solids = {"wall": wall, "fluid_plus": plus, "fluid_minus": minus}
    for name, solid in solids.items():
        solid.label = name.replace("_", " ")
        tpmscad.export_step(solid, Path(folder) / f"counter_flow_exchanger_{name}.step")
    picture = Path(folder) / "counter_flow_exchanger.png"
    tpmscad.render(
        bd.Compound(children=[*solids.values()]), picture, section=f"y={CELL * cells[1] / 2 + 1}", color_by="piece"
    )
    certificate = core.certificate
    return {
        "met": certificate.met,
        "faces": len(wall.faces()),
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,  # of the core in its skin, whose two cavities are the channels
        "valid": all(solid.is_valid for solid in solids.values()),
        "pieces": {name: len(solid.solids()) for name, solid in solids.items()},
        "shells": {name: len(solid.shells()) for name, solid in solids.items()},
        "volumes": {name: solid.volume for name, solid in solids.items()},
        "hull": hull.volume,
        "gap between the fluids": estimate_gap(plus, minus),
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
