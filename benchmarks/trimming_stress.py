"""Lattices trimmed by random bodies, one line each, and what became of them all.

    python -m benchmarks.trimming_stress [--first 0] [--last 200] [--seed 1] [--round] [--boolean 20] [--void]

Bodies are random in kind, place, size and tilt; a fifth are put through corners, sides and middles of patches, half of these
tangent there. With --round they are what people draw. Body i of a seed is always the same: a line can be run again alone.

*fast*: trimmed on the patches' parameters. *moved*: so, with the lattice moved by a few tolerances. *kernel*: by the kernel's
boolean, because the fast way was not sure. *error*: none of these. *wrong*: a result that is invalid, open, or of another volume
than the second way says: a count of points, told in or out by neither, which is good to `COUNTED`; the kernel for every n-th
body (--boolean n), and where the count is off; with --void lattice and void, trimmed one by one, must add up to the body. The
last figures are the difference to the second way, CPU seconds of trimming and building, and why not fast.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any, NamedTuple

import build123d as bd
import numpy as np
from scipy.stats import qmc

from benchmarks.trimming import covering, turned, volume
from tests.trimming.network_operands import trim
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.patch_nodes import signed_distances_to_nodes
from tpmscad.errors import NothingLeft, TpmscadError, TrimmingError
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean import boolean_operations
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.trimming.operands.polyhedra import box

KINDS = ("box", "cylinder", "sphere", "cone", "torus")
SURFACES = ("gyroid", "diamond", "schwarz_p")
SAME = 1e-6
"""Of the body's volume: how far two ways may be apart."""

POINTS, COUNTED = 8192, 0.02
"""Points in a body's box, and the part of the body's volume by which their count may be off."""


class Outcome(NamedTuple):
    word: str
    note: str
    volume: float
    off: float
    seconds: float


class RandomBody(NamedTuple):
    """A shape; `inside` tells points (n, 3) of its own frame, that of its location, in or out."""

    name: str
    shape: bd.Part
    inside: Callable[[Any], Any]


def solid(kind: str, a: float, b: float, c: float, top: float) -> tuple[bd.Part, Callable[[Any], Any]]:
    """A body about the origin, and what tells points in or out."""
    made: tuple[bd.Part, Callable[[Any], Any]] = {
        "box": lambda: (bd.Box(2 * a, 2 * b, 2 * c), lambda x: (np.abs(x) < [a, b, c]).all(axis=1)),
        "cylinder": lambda: (bd.Cylinder(a, 2 * b), lambda x: (around(x) < a) & (np.abs(x[:, 2]) < b)),
        "sphere": lambda: (bd.Sphere(a), lambda x: np.linalg.norm(x, axis=1) < a),
        "cone": lambda: (
            bd.Cone(a, top, 2 * b),
            lambda x: (np.abs(x[:, 2]) < b) & (around(x) < a + (top - a) * (x[:, 2] + b) / (2 * b)),
        ),
        "torus": lambda: (bd.Torus(a, top), lambda x: np.hypot(around(x) - a, x[:, 2]) < top),
    }[kind]()
    return made


def random_body(rng: np.random.Generator, patches: Brep) -> RandomBody:
    """A body somewhere in the middle of the lattice; every fifth on purpose where it is hard."""
    a, b, c = rng.uniform(2.0, 4.5, 3)
    kind = KINDS[rng.integers(5)]
    top = a * rng.uniform(0.0, 0.8) if kind == "cone" else a * rng.uniform(0.3, 0.7) if kind == "torus" else 0.0
    shape, inside = solid(kind, a, b, c, top)
    turn = bd.Rot(*rng.uniform(-180, 180, 3)) if rng.random() < 0.75 else bd.Rot(0, 0, 0)
    if rng.random() >= 0.2:
        return RandomBody(kind, bd.Pos(*rng.uniform(8, 12, 3)) * turn * shape, inside)
    face = shape.faces()[int(rng.integers(len(shape.faces())))]
    on = face.position_at(*rng.uniform(0.2, 0.8, 2))
    normal = face.normal_at(on)
    where = [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5)][rng.integers(3)]
    faces = patches.faces
    places = np.stack([patches.carriers[c](*where) for c in range(int(faces.carrier.max()) + 1)])[faces.carrier]
    places = faces.motion.apply(places)
    f = int(rng.choice(np.argsort(np.abs(places - 10).max(axis=1))[:40]))  # near the middle
    at = places[f]
    if rng.random() < 0.5:  # tangent
        up = faces.motion[f].apply_to_vectors(patches.carriers[faces.carrier[f]].normal(*where))
        source, target = bd.Plane(on, z_dir=normal), bd.Plane(at.tolist(), z_dir=up.tolist())
        return RandomBody(f"{kind}, tangent", target.location * source.location.inverse() * shape, inside)
    place = bd.Pos(*(at - [on.X, on.Y, on.Z]).tolist())
    return RandomBody(f"{kind}, special", place * shape, inside)


def round_body(rng: np.random.Generator) -> RandomBody:
    """What people draw: round numbers, square to the lattice or turned by 45 degrees, centred on its points of symmetry."""
    a, b, c = rng.choice([2.5, 3.0, 4.0, 5.0], 3).tolist()
    kind = KINDS[rng.integers(5)]
    if kind == "torus":
        a, top = max(a, 3.0), rng.choice([1.0, 1.5, 2.0])
    else:
        top = a / 2 if rng.random() < 0.7 else 0.0
    shape, inside = solid(kind, a, b, c, top)
    turn = bd.Rot(*rng.choice([0.0, 0.0, 90.0, 45.0], 3).tolist())
    return RandomBody(f"{kind}, round", bd.Pos(*rng.choice([7.5, 10.0, 11.0, 12.5], 3).tolist()) * turn * shape, inside)


def around(x: Any) -> Any:
    """Distances from the z axis."""
    return np.hypot(x[:, 0], x[:, 1])


def counted(patches: Brep, body: RandomBody) -> float:
    """The volume of lattice and body by a count of points."""
    low, high = enclosing_box(body.shape.wrapped)
    points = low + (high - low) * qmc.Sobol(3, seed=np.random.default_rng(1)).random(POINTS)
    motion = body.shape.location.wrapped.Transformation()
    rows = np.array([[motion.Value(i, j) for j in (1, 2, 3, 4)] for i in (1, 2, 3)])
    within = points[body.inside((points - rows[:, 3]) @ rows[:, :3])]
    return float(np.count_nonzero(signed_distances_to_nodes(patches, within) < 0) / POINTS * np.prod(high - low))


def by_kernel(block: Callable[[], Any], patches: Brep, shape: bd.Part, note: str, begun: float) -> Outcome:
    """What the kernel makes of the whole lattice and the body."""
    body = read_body(shape)
    try:
        cut = (
            boolean_operations.intersect_solids(block(), body.shape),
            boolean_operations.subtract_solid(body.shape, block()),
        )
        reports = [[check_shape(solid) for solid in solids] for solids in cut]
    except TpmscadError as error:
        return Outcome("error", f"{note}; kernel: {error}", np.nan, np.nan, time.process_time() - begun)
    volumes = [sum(r.volume for r in own) for own in reports]
    seconds, off = time.process_time() - begun, sum(volumes) - body.volume
    if not all(r.valid and r.closed for own in reports for r in own):
        note = f"{note}; kernel: invalid"
    elif abs(off) > SAME * body.volume:
        note = f"{note}; kernel: lattice and void do not add up, {volumes[0]:.6f} and {volumes[1]:.6f}"
    else:
        return Outcome("kernel", note, volumes[0], off, seconds)
    return Outcome("error", note, np.nan, np.nan, time.process_time() - begun)


def outcome(patches: Brep, block: Callable[[], Any], body: RandomBody, by_boolean: bool, by_void: bool) -> Outcome:
    """What comes of one body."""
    begun, shape = time.process_time(), body.shape
    try:
        tool = brep_from_shape(shape)
        cut = trim(patches, tool)
        if len(cut.brep.faces):
            made = build_solids(cut.brep).shape
            seconds = time.process_time() - begun
            report = check_shape(made)
            if not (report.valid and report.closed):
                raise TrimmingError("the kernel's check rejects the trimmed lattice")
        else:
            seconds = time.process_time() - begun
    except NothingLeft:
        left = counted(patches, body)
        word = "fast" if abs(left) < COUNTED * volume(tool) else "wrong"
        return Outcome(word, "", 0.0, left, time.process_time() - begun)
    except TpmscadError as error:
        return by_kernel(block, patches, shape, str(error), begun)
    found = volume(cut.brep)
    if len(cut.brep.faces) and abs(report.volume - found) > SAME * volume(tool):
        return Outcome("wrong", "volume by the kernel", found, report.volume - found, seconds)
    limit, notes, good = SAME * volume(tool), [cut.report.reason] if cut.report.shifted else [], True
    off = counted(patches, body) - found
    sure = abs(off) < COUNTED * volume(tool)
    if by_void:
        try:
            off = found + volume(trim(turned(patches), tool).brep) - volume(tool)
            good = abs(off) < limit
        except TrimmingError as error:
            notes.append(f"void: {error}")
    if by_boolean or not sure:
        other = by_kernel(block, patches, shape, "", begun)
        spent = f"in {other.seconds - seconds:.1f} s"
        if other.word != "error":
            off, good = other.volume - found, abs(other.volume - found) < limit
            notes.append(f"the kernel: {other.volume:.6f} {spent}")
        else:
            good = sure
            notes.append(f"no second way: {other.note} {other.volume:.6f} {spent}")
    word = ("moved" if cut.report.shifted else "fast") if good else "wrong"
    return Outcome(word, "; ".join(notes), found, off, seconds)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--boolean", type=int, default=20)
    parser.add_argument("--round", action="store_true")
    parser.add_argument("--void", action="store_true")
    parser.add_argument("--kinds", default=",".join(KINDS))
    options = parser.parse_args(arguments)
    lattices = {s: covering(s, np.full(3, -1.0), np.full(3, 21.0)) for s in SURFACES}
    solids: dict[str, Any] = {}
    table: dict[str, Counter[str]] = defaultdict(Counter)
    spent: dict[str, float] = defaultdict(float)
    for i in range(options.first, options.last):
        surface = SURFACES[i % 3]
        patches = lattices[surface].patches
        rng = np.random.default_rng([options.seed, i])
        body = round_body(rng) if options.round else random_body(rng, patches)
        name = body.name
        if name.split(",")[0] not in options.kinds.split(","):
            continue

        def block(surface: str = surface) -> Any:
            if surface not in solids:
                own = lattices[surface]
                solids[surface] = build_solids(trim(own.patches, box(own.low, own.high)).brep).shape
            return solids[surface]

        found = outcome(patches, block, body, i % options.boolean == 0, options.void)
        for key in (name.split(",")[0], *name.split(", ")[1:], "all"):
            table[key][found.word] += 1
        spent[found.word] += found.seconds
        print(
            f"{options.seed}:{i:<4} {surface:>9} {name:>18} {found.word:>6} {found.volume:12.6f} {found.off:9.1e} "
            f"{found.seconds:6.2f} {found.note}",
            flush=True,
        )
    for key, words in table.items():
        print(f"{key:>10}: {words.total():4}, " + ", ".join(f"{n} {word}" for word, n in sorted(words.items())))
    print(", ".join(f"{word} {s / table['all'][word]:.2f} s" for word, s in spent.items()), "each")


if __name__ == "__main__":
    main()
