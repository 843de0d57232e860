"""Ranges in which lattices are one piece in all of space: levels of every surface of the catalogue, diameters of struts.

    python -m benchmarks.one_piece_ranges levels [--surfaces gyroid,octo]    # figures of tpmscad/fields/kinds/one_piece_ranges.py
    python -m benchmarks.one_piece_ranges offsets [--surfaces gyroid,octo]    # normal offsets, against their limits
    python -m benchmarks.one_piece_ranges struts [--kinds bcc,octet]          # the figures of tpmscad/strut_cells.py

Pieces are counted by `topology.periodic_pieces` on grids of two resolutions, with both connectivities, which bracket a level at
which their number changes. Such a level of a nodal function is a critical value: it is found by Newton's method from every point
of a grid, and named if it lies in both brackets. `levels` prints what is stored, with the volume fraction of each level.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from tpmscad import fields, surfaces, topology
from tpmscad._typing import Array
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.strut_graphs import make_strut_graph
from tpmscad.lattices.strut_contacts import find_contact
from tpmscad.strut_cells import KINDS, LARGEST_DIAMETERS

GRIDS = (64, 96)
"""Samples along a cell."""

NEWTON_GRID, NEWTON_STEPS, LONGEST_STEP, DIFFERENCE = 20, 40, 0.02, 1e-5
"""Starts along a cell, steps, and in cells the longest of these and that of differences of gradients."""

PROBE = 0.4
"""Diameter of struts, in cells, from which the largest follows."""

CLOUD = 90
"""Points along a cell that are projected on a surface, whose distance is the normal distance."""


def find_critical_values(field: Field) -> Array:
    """The values of a field of period 1 at its critical points, ascending."""
    axis = (np.arange(NEWTON_GRID) + 0.29) / NEWTON_GRID
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    corners = np.array(list(itertools.product((0, 0.25, 0.5, 0.75), repeat=3)))  # degenerate ones are found by no step
    for _ in range(NEWTON_STEPS):
        gradient = field.gradient(points)
        ahead = [field.gradient(points + DIFFERENCE * e) - field.gradient(points - DIFFERENCE * e) for e in np.eye(3)]
        hessian = np.stack(ahead, axis=-1) / (2 * DIFFERENCE)
        step = -np.einsum("nij,nj->ni", np.linalg.pinv(hessian, rcond=1e-6), gradient)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        points = points + step * np.minimum(1.0, LONGEST_STEP / np.maximum(length, 1e-300))
    points = np.concatenate([points, corners])
    slope = np.linalg.norm(field.gradient(points), axis=1)
    values = np.sort(field(points[slope < 1e-7]))
    return values[np.append(True, np.diff(values) > 1e-6)]


def sample_period(field: Field, n: int) -> Array:
    """Samples (n, n, n) of one period of edge 1."""
    axis = np.arange(n) / n
    return np.asarray(field.value_and_gradient_on_grid(axis, axis, axis)[0])


def bracket_ranges(samples: Sequence[Array]) -> list[list[Array]]:
    """One-piece ranges of levels by grid, and by connectivity: early, then late."""
    return [
        [topology.periodic_pieces(each, convention).one_piece_levels for convention in ("top_cells", "strict")]
        for each in samples
    ]


def find_ranges(field: Field, sign: int) -> list[tuple[float, float]]:
    """Ranges of levels in which {sign * f <= level} is one piece; ends are critical values.

    An end of the finer grid is taken to be the critical value in its bracket that is nearest to the early end. Ranges of one
    connectivity alone are those of samples.
    """
    grids = bracket_ranges([sign * sample_period(field, n) for n in GRIDS])
    critical = np.append(np.sort(sign * find_critical_values(field)), np.inf)

    def snap(early: float, late: float, slack: float) -> float:
        if not np.isfinite(early):
            return np.inf
        inside = critical[(critical >= early - slack) & (critical <= late + slack)]
        if not len(inside):
            raise SystemExit(f"no critical value between {early} and {late} of {critical}")
        return float(inside[np.argmin(np.abs(inside - early))])

    coarse, fine = grids
    slack = 0.002 * float(np.ptp(critical[:-1]))
    found: list[tuple[float, float]] = []
    for low, high in fine[0]:
        # of late connections only: the first range that begins here, and the last that ends here
        begins = [start for start, end in fine[1] if start >= low - 1e-9 and start <= high]
        if not begins:
            continue
        first = snap(low, begins[0], slack)
        ends = [end for start, end in fine[1] if start <= high]
        last = snap(min(high, ends[-1]), max(high, ends[-1]), slack) if np.isfinite(high) else np.inf
        if last > first:
            found.append((first, last))
    agree = [len(each) for each in coarse]
    print(
        f"#   coarse: {[each.round(3).tolist() for each in coarse]} {agree}; fine: {[e.round(4).tolist() for e in fine]}"
    )
    return found


def print_levels(name: str) -> None:
    """The lines of one surface as they are stored."""
    for reference in surfaces.CATALOGUE[name].references:
        field = fields.tpms(name, 1.0, reference=reference)
        for side, sign in (("-", 1), ("+", -1)):
            rows = []
            for first, last in find_ranges(field, sign):
                begin = fields.volume_fraction(sign * field - first)
                end = fields.volume_fraction(sign * field - last) if np.isfinite(last) else 1.0
                level = sign * last if np.isfinite(last) else sign * np.inf
                rows.append((round(sign * first, 6), round(level, 6), round(begin, 4), round(end, 4)))
            print(f'    ("{name}", "{reference}", "{side}"): {tuple(rows)},', flush=True)


def print_offsets(name: str) -> None:
    """Normal offsets from which on each side is one piece, and the offset limits."""
    for reference in surfaces.CATALOGUE[name].references:
        field = fields.tpms(name, 1.0, reference=reference)
        measures = surfaces.cell_measures(name, reference)
        tree = _project_cloud(field)
        for side, sign in (("-", 1), ("+", -1)):
            brackets = []
            for n in GRIDS:
                axis = np.arange(n) / n
                points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
                distance = (np.sign(field(points)) * tree.query(points)[0]).reshape(n, n, n)
                brackets += [levels[0, 0] for levels in bracket_ranges([sign * distance])[0]]
            limit = measures.min_offset if side == "-" else measures.max_offset
            listed = " ".join(f"{sign * each:8.4f}" for each in brackets)
            print(f"{name:15} {reference:8} {side}  {listed}   limit {limit:8.4f}", flush=True)


def _project_cloud(field: Field) -> cKDTree:
    """Points of the zero set in one period."""
    axis = (np.arange(CLOUD) + 0.37) / CLOUD
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    value, gradient = field.value_and_gradient(points)
    points = points[np.abs(value) < 1.2 * np.linalg.norm(gradient, axis=1) / CLOUD]
    for _ in range(6):
        value, gradient = field.value_and_gradient(points)
        points = points - (value / np.maximum((gradient**2).sum(axis=1), 1e-12))[:, None] * gradient
    points = points[np.abs(field(points)) < 1e-9] % 1.0
    return cKDTree(np.where(points >= 1.0, 0.0, points), boxsize=1.0)


def find_largest_diameter(kind: str) -> float:
    """The diameter, in cells, at which struts begin to touch beside their nodes, in a block of cells and in its sides."""
    points, edges = make_strut_graph(kind, 1.0, 2)
    contact = find_contact(points, edges, np.full(len(points), PROBE / 2), np.zeros(len(points)))  # all in proportion
    assert contact is not None
    return PROBE * contact.ratio


def print_struts(kind: str) -> None:
    """The greatest diameter, its volume fraction, and the diameters up to which struts and their void are one piece."""
    largest = find_largest_diameter(kind)
    field = fields.strut_lattice(kind, 1.0, 1e-6, 3)
    line = []
    for n in GRIDS:
        axis = 1 + np.arange(n) / n
        distance = field(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)).reshape(
            n, n, n
        )
        for sign in (1, -1):
            early, late = (
                topology.periodic_pieces(sign * distance, convention).one_piece_levels
                for convention in ("top_cells", "strict")
            )
            line.append("/".join(f"{2 * sign * each[0, 0]:.3f}" for each in (early, late)))
    thick = fields.strut_lattice(kind, 1.0, largest, 3)
    fraction = fields.volume_fraction(thick, ((1.0,) * 3, (2.0,) * 3))
    stored = LARGEST_DIAMETERS[kind]
    print(
        f"{kind:22} largest {largest:.6f} stored {stored:.6f} fraction {fraction:.4f} struts, void from: {line}",
        flush=True,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("levels", "offsets", "struts"))
    parser.add_argument("--surfaces", default=",".join(surfaces.CATALOGUE))
    parser.add_argument("--kinds", default=",".join(KINDS))
    given = parser.parse_args(arguments)
    if given.what == "struts":
        for kind in given.kinds.split(","):
            print_struts(kind)
        return
    for name in given.surfaces.split(","):
        (print_levels if given.what == "levels" else print_offsets)(name)


if __name__ == "__main__":
    main()
