"""Creases that hide between samples: small balls and struts that pierce a surface, found by the tracer in random trees.

    python -m benchmarks.hidden_creases [--seed 1] [--count 200] [--only 7]

In a box of 10 mm, trees of one to three leaves (half-spaces, balls, struts, sheets, formulas) get a ball of 1e-3 to 1e-2 of the
box at a random place of their surface, united or taken away. Its loop is measured by the tracer and compared with the circle in
the tangent plane there. Columns: the tree; outcome; arcs, loops and corners; the length of the hidden loop and of the circle;
cells tested, cells unresolved, CPU seconds. MISSED is a hidden loop that was not found.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from benchmarks.crossing_fields import draw_leaf
from tpmscad import fields
from tpmscad._typing import Array, BoolArray
from tpmscad.fields.analysis.crease_network import CreaseNetwork, trace_creases
from tpmscad.fields.analysis.outermost_extremes import combine_solids, expose_extremes, list_leaves
from tpmscad.levelset.boundary_level_sets import sample_level_set

SIZE = 10.0
LENGTH_RTOL = 0.1
"""Relative difference of a hidden loop from the circle in the tangent plane: the surface bends within a hundredth of the box."""


@dataclass(frozen=True, slots=True)
class HiddenBall:
    """A tree with a ball that pierces its surface, and the length of the circle in which it cuts the tangent plane there."""

    name: str
    field: fields.Field
    center: Array
    radius: float
    circle: float


def draw_hidden_ball(rng: np.random.Generator, leaves: int) -> HiddenBall | None:
    """A random tree with a ball on its surface; None if the tree has no surface in the box away from its creases."""
    names: list[str] = []
    field: fields.Field | None = None
    for _ in range(leaves):
        name, leaf = draw_leaf(rng, quadrics=False)
        sign = str(rng.choice(["|", "&", "-"]))
        field = leaf if field is None else {"|": field | leaf, "&": field & leaf, "-": field & ~leaf}[sign]
        names += [sign, name] if names else [name]
    assert field is not None
    place = _choose_place(rng, field)
    if place is None:
        return None
    point, normal = place
    radius = float(SIZE * 10 ** rng.uniform(-3, -2)) / 2
    height = radius * float(rng.uniform(-0.7, 0.7))
    center = point + height * normal
    ball = fields.sphere(tuple(center.tolist()), radius)
    field = field | ball if rng.random() < 0.5 else field & ~ball
    return HiddenBall(" ".join(names), field, center, radius, 2 * np.pi * float(np.sqrt(radius**2 - height**2)))


def _choose_place(rng: np.random.Generator, field: fields.Field) -> tuple[Array, Array] | None:
    """A point of a tree's surface that is ten balls away from its other surfaces and from the box, and its normal."""
    tree = expose_extremes(field)
    leaves = list_leaves(tree)
    margin = 0.1 * SIZE / 2
    places = []
    for k, leaf in enumerate(leaves):
        points = sample_level_set(leaf, np.zeros(3), np.full(3, SIZE), SIZE / 12)
        if not len(points):
            continue
        values, slopes = zip(*(other.value_and_gradient(points) for other in leaves), strict=True)
        distance = np.abs(values) / np.maximum(np.linalg.norm(slopes, axis=-1), 1e-9)
        distance[k] = np.inf
        good = find_active(tree, np.array(values), k) & (distance > margin).all(axis=0)
        good &= ((points > margin) & (points < SIZE - margin)).all(axis=1)
        places += [(p, g / np.linalg.norm(g)) for p, g in zip(points[good], slopes[k][good], strict=True)]
    return places[int(rng.integers(len(places)))] if places else None


def find_active(field: fields.Field, values: Array, leaf: int) -> BoolArray:
    """Where the level set of a leaf bounds the solid of the tree, from the values (leaves, n) of all leaves there: (n,).

    The leaf decides: with it solid the tree is solid, with it void it is void. No tolerance takes part.
    """
    is_solid = list(values < 0)
    count = len(values[0])
    is_solid[leaf] = np.ones(count, bool)
    with_leaf = combine_solids(field, is_solid)
    is_solid[leaf] = np.zeros(count, bool)
    return np.asarray(with_leaf & ~combine_solids(field, is_solid))


def measure_hidden(case: HiddenBall, network: CreaseNetwork) -> tuple[int, float]:
    """Number and length of the loops on the hidden ball."""
    own = [
        arc
        for arc in network.arcs
        if arc.is_closed and (np.abs(np.linalg.norm(arc.points - case.center, axis=1) / case.radius - 1) < 1e-6).all()
    ]
    return len(own), sum(arc.length for arc in own)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--only", type=int)
    options = parser.parse_args(arguments)
    counts: dict[str, int] = {}
    total = 0.0
    for case in range(options.count) if options.only is None else [options.only]:
        rng = np.random.default_rng([options.seed, case])
        hidden = None
        while hidden is None:
            hidden = draw_hidden_ball(rng, int(rng.integers(1, 4)))
        begun = time.process_time()
        network = trace_creases(hidden.field, np.zeros(3), np.full(3, SIZE))
        seconds = time.process_time() - begun
        total += seconds
        loops, length = measure_hidden(hidden, network)
        found = loops == 1 and abs(length / hidden.circle - 1) < LENGTH_RTOL
        outcome = ("found" if network.is_proved else "found, not all proved") if found else "MISSED"
        counts[outcome] = counts.get(outcome, 0) + 1
        print(
            f"{case:>3} {outcome:>8}  {hidden.name}, ball {hidden.radius / SIZE:.1e}: {len(network.arcs)} arcs, "
            f"{sum(arc.is_closed for arc in network.arcs)} loops, {len(network.corners)} corners, hidden {loops} of length "
            f"{length:.4g} for {hidden.circle:.4g}, {network.cells_tested} cells, {len(network.unresolved.lo)} unresolved, "
            f"{seconds:.1f} s",
            flush=True,
        )
    print(counts, f"{total:.0f} s")


if __name__ == "__main__":
    main()
