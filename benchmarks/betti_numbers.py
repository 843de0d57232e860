"""Betti numbers of random fields and blends in boxes against marching cubes on three finer grids.

    python -m benchmarks.betti_numbers [FIRST [LAST]]

The count of the program (`compute_betti_numbers`) is compared with one that shares no code with it: scikit-image's marching cubes
on uniform grids, closed by the void round the box. Its surfaces are the solid's components (positive volume) and cavities
(negative volume), and half its Euler characteristic is that of the solid. A case "agrees" if the finest grid, or the one before
it, says the same. It "changes" if the three grids differ among themselves and the last two differ from the program: a neck is
then thinner than their spacing. All grids alike, and the program different, is DIFFERENT. In both cases the counts on a grid of
NECK_LINES are printed, and beside them that of its voxels, joined through faces.

Kinds, in turn: a surface of the catalogue as rod, pore or sheet in a random box of one to two periods; the same with a level near
an extreme value or a saddle; a random periodic B-spline; two surfaces joined smoothly; a random trigonometric polynomial; the
blends of random_pairs.py in boxes of the part that is blended.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

import numpy as np
from scipy.ndimage import generate_binary_structure, label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage.measure import euler_number, marching_cubes

from benchmarks.random_pairs import random_pair
from benchmarks.solidify_blends import box_of
from tpmscad import fields
from tpmscad.blending import blend
from tpmscad.fields.analysis.betti_numbers import compute_betti_numbers

LINES = 113, 149, 179
"""Grid lines along the longest edge of the box: beyond the two grids, of 96 and 134 lines, that the program begins with."""

NECK_LINES = 311
KINDS = "surface", "near a critical level", "B-spline", "smooth union", "trigonometric", "blend"
Betti = tuple[int, int, int]
Case = tuple[str, fields.Field, np.ndarray, np.ndarray]


def count_by_marching_cubes(field: fields.Field, lo: np.ndarray, hi: np.ndarray, lines: int) -> Betti:
    """Betti numbers of {field < 0} in the box by the closed surface that marching cubes makes."""
    counts = np.maximum(8, np.ceil(lines * (hi - lo) / (hi - lo).max())).astype(int)
    values = field.on_grid(*(np.linspace(a, b, n + 1) for a, b, n in zip(lo, hi, counts, strict=True)))
    padded = np.pad(values, 1, constant_values=float(np.abs(values).max()))
    if padded.min() >= 0:
        return 0, 0, 0
    vertices, triangles, _, _ = marching_cubes(padded, 0.0, allow_degenerate=True, gradient_direction="ascent")
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    n_vertices = len(vertices)
    graph = coo_array((np.ones(len(ends), np.int8), ends.T), shape=(n_vertices, n_vertices))
    n_surfaces, surface = connected_components(graph, directed=False)
    corners = vertices[triangles].astype(float)
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    signed = np.bincount(surface[triangles[:, 0]], volume, n_surfaces)
    if signed.sum() < 0:  # the orientation of the triangles: the solid's volume is positive
        signed = -signed
    b0, b2 = int(np.count_nonzero(signed > 0)), int(np.count_nonzero(signed < 0))
    characteristic, odd = divmod(n_vertices - len(triangles) // 2, 2)  # three sides a triangle, each of two triangles
    assert not odd, "a closed surface has an even Euler characteristic"
    return b0, b0 + b2 - characteristic, b2


def count_by_voxels(field: fields.Field, lo: np.ndarray, hi: np.ndarray, lines: int) -> Betti:
    """Betti numbers of the voxels of {field <= 0}, which join through their faces only."""
    counts = np.maximum(8, np.ceil(lines * (hi - lo) / (hi - lo).max())).astype(int)
    axes = (np.linspace(a, b, n + 1) for a, b, n in zip(lo, hi, counts, strict=True))
    solid = np.pad(field.on_grid(*axes) <= 0, 1)
    b0 = int(label(solid)[1])
    b2 = int(label(~solid, generate_binary_structure(3, 3))[1]) - 1
    return b0, b0 + b2 - int(euler_number(solid, connectivity=1)), b2


def make_case(seed: int) -> Case:
    """A random field of the seed's kind, and its box."""
    rng = np.random.default_rng(1000 + seed)
    kind = KINDS[seed % len(KINDS)]
    lo = rng.uniform(-1, 1, 3)
    hi = lo + rng.uniform(0.8, 2.0, 3)
    if kind == "blend":
        pair = random_pair(seed)
        low, high, _ = box_of(pair, (2, 1, 1))
        return f"{kind} {pair.name}", blend(pair.structures, pair.regions, [pair.blending]).field, low, high
    if kind == "B-spline":
        unit = fields.bspline_unit(rng.normal(size=(4, 4, 4)), period=1.0)
        return (
            kind,
            fields.rod(unit, float(np.quantile(unit(rng.uniform(0, 1, (4000, 3))), rng.uniform(0.2, 0.8)))),
            lo,
            hi,
        )
    if kind == "trigonometric":
        waves, phases = rng.integers(-2, 3, (6, 3)), rng.uniform(0, 2 * np.pi, 6)
        terms = (f"sin({a}*x + {b}*y + {c}*z + {p:.17g})" for (a, b, c), p in zip(waves.tolist(), phases, strict=True))
        return kind, fields.expression(" + ".join(terms)) - float(rng.uniform(-1, 1)), 2 * lo, 2 * lo + 2 * (hi - lo)
    if kind == "smooth union":
        first, second = (_random_surface(rng, 0.3)[1] for _ in range(2))
        return kind, fields.smooth_union(first, second, float(rng.uniform(0.05, 0.3))), lo, hi
    name, field = _random_surface(rng, rng.uniform(0.2, 0.6), critical=kind != "surface")
    return f"{kind} {name}", field, lo, hi


def _random_surface(rng: np.random.Generator, fraction: float, critical: bool = False) -> tuple[str, fields.Field]:
    """A rod, pore or sheet with a solid fraction; or with a level within 0.02 of that of a critical point."""
    names = sorted(fields.TPMS)
    name, kind = names[rng.integers(len(names))], ("rod", "pore", "sheet")[rng.integers(3)]
    phi = fields.tpms(name, period=1.0)
    points = rng.uniform(0, 1, (4000, 3))
    values = np.sort(phi(points))
    if critical:
        slope = np.linalg.norm(phi.gradient(points), axis=1)
        near = phi(points)[np.argsort(slope)[: 1 + rng.integers(10)][-1]]
        levels = [float(np.clip(near + rng.uniform(-0.02, 0.02), values[0], values[-1]))]
        if kind == "sheet":
            levels = sorted([*levels, float(values[rng.integers(len(values))])])
    elif kind == "sheet":
        start = rng.uniform(0.02, 0.98 - fraction)
        levels = np.quantile(values, [start, start + fraction]).tolist()
    else:
        levels = [float(np.quantile(values, fraction if kind == "rod" else 1 - fraction))]
    return f"{kind} {name} {np.round(levels, 3)}", getattr(fields, kind)(phi, *levels)


def main(first: int, last: int) -> None:
    """Print a line for each case that does not agree, and the totals of each kind."""
    totals: Counter[tuple[str, str]] = Counter()
    ours = theirs = 0.0
    for seed in range(first, last):
        name, field, lo, hi = make_case(seed)
        start = time.process_time()
        found = compute_betti_numbers(field, lo, hi)
        middle = time.process_time()
        counted = [count_by_marching_cubes(field, lo, hi, lines) for lines in LINES]
        ours, theirs = ours + middle - start, theirs + time.process_time() - middle
        if found is None:
            verdict = "not counted"
        elif found in counted[1:]:
            verdict = "agrees"
        elif len(set(counted)) > 1:
            verdict = "changes"
        else:
            verdict = "DIFFERENT"
        totals[KINDS[seed % len(KINDS)], verdict] += 1
        if verdict != "agrees":
            finest = count_by_marching_cubes(field, lo, hi, NECK_LINES)
            print(
                f"{seed:3d} {name}: {verdict}; ours {found}, marching cubes {counted}, {finest} of {NECK_LINES}",
                flush=True,
            )
    verdicts = "agrees", "changes", "not counted", "DIFFERENT"
    print(f"| kind | {' | '.join(verdicts)} |\n|---|{'---|' * len(verdicts)}")
    for kind in KINDS:
        print(f"| {kind} | {' | '.join(str(totals[kind, verdict]) for verdict in verdicts)} |")
    print(
        f"{last - first} cases; CPU seconds a case: ours {ours / (last - first):.2f}, three grids {theirs / (last - first):.2f}"
    )


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else 0, int(given[1]) if len(given) > 1 else 200)
