"""Union, intersection and difference of two networks of patches on the patches' parameters, without the kernel's boolean.

    python -m benchmarks.networks [--cases gyroid-spheres,gyroid-rod] [--samples 400000]

Of each operation: CPU seconds of the cut alone and of build and full kernel check, volume and what a sample of points says of
it (with its standard error), faces, arcs, the largest distance of arcs from both their faces by foot points, and validity.
`sum` is what the volumes of union and intersection miss the operands' by, `rest` what difference and intersection miss the
first one's by, both in fractions of the operands' volumes. Compiled loops are warmed up first.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, move_brep
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.network_boolean import KEPT_PARTS, combine_networks

CELL, THICKNESS, TOL = 10.0, 1.0, 0.02
NODAL_MARGIN = 0.1
"""Distance from the wall's surfaces below which the exact surface decides: the nodal one is within 0.0135."""
WIDE = ((-1.0, -1.0, -1.0), (11.0, 11.0, 11.0))
NARROW = ((0.3, 0.4, 0.2), (9.6, 9.7, 9.8))
AXIS = np.array([0.3, 0.5, 0.81]) / np.linalg.norm([0.3, 0.5, 0.81])


@dataclass(frozen=True)
class Operand:
    """A boundary representation and, independently of it, which points (n, 3) are in the solid."""

    brep: Brep
    contains: Callable[[Array], BoolArray]


def in_box(
    field: Callable[[Array], Array], box: tuple[tuple[float, ...], tuple[float, ...]]
) -> Callable[[Array], BoolArray]:
    low, high = np.array(box)
    return lambda p: np.asarray((field(p) < 0) & (p > low).all(axis=1) & (p < high).all(axis=1))


def solidified(field: fields.Field, box: tuple[tuple[float, ...], tuple[float, ...]]) -> Operand:
    return Operand(tpmscad.solidify(field, box, tol=TOL).patches, in_box(field, box))


def turn(degrees: float) -> Motion:
    """A turn about `AXIS` and a small translation."""
    a, (x, y, z) = np.radians(degrees), AXIS
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross
    return Motion(rotation, np.array([0.7, -0.4, 0.3]))


def wall_of_lattice(model: tpmscad.Model) -> Callable[[Array], Array]:
    """A function that is negative where the exact mid surface is nearer than half the thickness."""
    distance = model.distance_to_reference
    assert isinstance(distance, partial)
    request = distance.args[0]
    phase, nodal = np.array(request.phase), NormalDistance(fields.tpms("gyroid", CELL))
    mid_surface = request.source.mid_surface(request.cell, request.cells, phase, None)

    def wall(points: Array) -> Array:
        local = CELL * np.mod(points / CELL - phase, 1.0)
        value = np.abs(nodal(local)) - THICKNESS / 2
        near = np.abs(value) < NODAL_MARGIN
        value[near] = np.abs(mid_surface(local[near])) - THICKNESS / 2
        return np.asarray(value)

    return wall


@lru_cache
def operand(name: str) -> Operand:
    if name == "gyroid":
        model = tpmscad.lattice("gyroid", cell=CELL, thickness=THICKNESS)
        return Operand(model.patches, in_box(wall_of_lattice(model), ((0.0,) * 3, (CELL,) * 3)))
    if name == "turned":
        motion, straight = turn(20.0), operand("gyroid")
        return Operand(move_brep(straight.brep, motion), lambda p: straight.contains(motion.apply_inverse(p)))
    if name == "spheres":
        return solidified(
            fields.smooth_union(fields.sphere((3.1, 4.2, 5.3), 2.7), fields.sphere((6.4, 5.1, 4.6), 2.9), 0.8), WIDE
        )
    if name == "diamond-rod":
        return solidified(fields.rod(fields.tpms("diamond", CELL), -0.5), WIDE)
    if name == "p-rod":
        return solidified(fields.rod(fields.tpms("schwarz_p", CELL), -0.8), WIDE)
    if name == "gyroid-sheet":
        return solidified(fields.sheet(fields.tpms("gyroid", CELL), -0.4, 0.4), NARROW)
    halves = fields.box((-2, -2, -2), (3, 12, 12)), fields.box((7, -2, -2), (12, 12, 12))
    middle = fields.box((3, -2, -2), (7, 12, 12))
    first, second = ("gyroid", "schwarz_p") if name == "blend-gp" else ("diamond", "schwarz_p")
    level = 0.0 if name == "blend-gp" else -0.3
    rods = [fields.rod(fields.tpms(first, CELL), level), fields.rod(fields.tpms(second, CELL), level)]
    blended = tpmscad.blend(rods, list(halves), [middle], resolution=(40, 40, 40))
    return solidified(blended.field, NARROW if name == "blend-gp" else WIDE)


CASES = {
    "gyroid-spheres": ("gyroid", "spheres"),
    "gyroid-rod": ("gyroid", "diamond-rod"),
    "sheet-rod": ("gyroid-sheet", "p-rod"),
    "sheet-diamond": ("gyroid-sheet", "diamond-rod"),
    "rods": ("diamond-rod", "p-rod"),
    "blends": ("blend-gp", "blend-dp"),
    "turned": ("gyroid", "turned"),
}


def volume(brep: Brep) -> float:
    return float(integral_properties.volume(integral_properties.integrate_faces(brep))[0])


def measure_arcs(brep: Brep) -> float:
    """Largest distance of the edges that are no sides of patches, those with a deviation, from their spline carriers."""
    worst, face_of_use = 0.0, brep.face_of_use
    fitted = brep.edges.deviation > 0
    for f in range(len(brep.faces)):
        carrier = brep.carriers[brep.faces.carrier[f]]
        own = [e for e in np.unique(brep.uses.edge[face_of_use == f]).tolist() if fitted[e]]
        if not isinstance(carrier, BSplineSurface) or not own:
            continue
        surface = FreeFormSurface(carrier.moved(brep.faces.motion[f]), continuation=0.05)
        points = []
        for e in own:
            low, high = brep.edges.span[e].tolist()
            local = brep.curves[brep.edges.curve[e]](np.linspace(low, high, 21))
            points.append(brep.edges.motion[e].apply(local))
        worst = max(worst, float(np.abs(surface.distance(np.concatenate(points))).max()))
    return worst


def sample_volumes(first: Operand, second: Operand, count: int) -> tuple[dict[str, float], float]:
    """Volumes of the operations from a sample of points, and the volume of the sampled box."""
    corners = np.concatenate([first.brep.vertices, second.brep.vertices])
    low, high = corners.min(axis=0) - 0.3, corners.max(axis=0) + 0.3
    rng = np.random.default_rng(1)
    inside: dict[str, int] = dict.fromkeys(KEPT_PARTS, 0)
    for _ in range(0, count, 50_000):
        points = rng.uniform(low, high, (50_000, 3))
        a, b = first.contains(points), second.contains(points)
        for operation, kept in (("union", a | b), ("intersection", a & b), ("difference", a & ~b)):
            inside[operation] += int(kept.sum())
    size = float((high - low).prod())
    total = -(-count // 50_000) * 50_000
    return {operation: size * n / total for operation, n in inside.items()}, size / np.sqrt(total)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--samples", type=int, default=400_000)
    options = parser.parse_args(arguments)
    print(
        f"{'case':>15} {'operation':>12} {'cut s':>6} {'check s':>7} {'volume':>11} {'sampled':>9} {'+-':>5} "
        f"{'faces':>5} {'arcs':>5} {'off':>8} {'pieces':>6} valid  told",
        flush=True,
    )
    for name in options.cases.split(","):
        first, second = (operand(own) for own in CASES[name])
        sampled, unit = sample_volumes(first, second, options.samples)
        combine_networks(first.brep, second.brep, "union")  # compiles
        found = {}
        for operation in KEPT_PARTS:
            begun = time.process_time()
            result = combine_networks(first.brep, second.brep, operation)
            cut = time.process_time() - begun
            built = build_solids(result.brep)
            valid = is_valid(built.shape)
            check = time.process_time() - begun - cut
            found[operation] = v = volume(result.brep)
            share = sampled[operation] / (unit * np.sqrt(options.samples))
            print(
                f"{name:>15} {operation:>12} {cut:6.2f} {check:7.2f} {v:11.5f} {sampled[operation]:9.2f} "
                f"{unit * np.sqrt(share * (1 - share)):5.2f} {len(result.brep.faces):5} {result.report.arcs:5} "
                f"{measure_arcs(result.brep):8.1e} {built.n_solids:6} {valid and measure_solid(result.brep).closed!s:>5}  "
                f"{result.report.reason}",
                flush=True,
            )
        one, total = volume(first.brep), volume(first.brep) + volume(second.brep)
        print(
            f"{name:>15} {'sum':>12} {(found['union'] + found['intersection'] - total) / total:.1e}, rest "
            f"{(found['difference'] + found['intersection'] - one) / total:.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
