"""Benchmarks of blending: the tables of the porous-blending paper beside ours, random pairs, large grids, necks, persistence.

    python -m benchmarks.blending [table1] [table2] [pairs [COUNT]] [specks [COUNT]] [large] [necks] [persistence]

Without arguments it prints table1 and table2. Seconds are CPU seconds of one process. Compiled loops are called once before the
measurements, and the cost of that first call is printed. "on gudhi" is our optimiser with each count of defects replaced by
gudhi's persistence: the time of one call at each resolution, times the number of counts. "its own" is the paper's descent
(eqs 20 to 23, with Adam, 12 steps) on gudhi's pairs, at the working resolution only. Our figures include the checks at twice the
resolution.
"""

from __future__ import annotations

import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from benchmarks.baseline_weights import blend_by_baseline
from benchmarks.blending_cases import Case, table1, table2, tpms
from benchmarks.random_pairs import random_pair
from tpmscad import fields, topology
from tpmscad.blending import BlendResult, blend
from tpmscad.blending.composition.sampled_composition import sample_composition
from tpmscad.blending.optimise import blend_state
from tpmscad.blending.optimise.blend_state import find_grid_defects
from tpmscad.blending.optimise.neck_width import measure_necks
from tpmscad.blending.optimise.subgrid_defects import is_isolated
from tpmscad.blending.sampling_domain import resolve_domain
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.topology import gudhi_complex

EARLIER = ("beta-growth", "discrete-reconstruction", "sigmoid")


def timed(run: Callable[[], BlendResult]) -> tuple[BlendResult, float]:
    """The result of a call, and its CPU seconds."""
    start = time.process_time()
    result = run()
    return result, time.process_time() - start


def run(case: Case, method: str = "topological", **options: object) -> BlendResult:
    """The blend of a case."""
    return blend(
        case.structures, case.regions, case.blending,
        method=method, weight=case.weight, resolution=case.resolution, **options,
    )  # fmt: skip


def counts(result: BlendResult, level: int = 0) -> str:
    """Components and cavities of a blend at one resolution."""
    return f"{result.errors.n0.final[level] + 1:4d} {result.errors.n2.final[level]:3d}"


def print_table1() -> None:
    """Print the defects of all methods for Table 1 of the paper."""
    print("Table 1: components n0 and holes n2 at 50^3 (paper's in brackets), joined through faces in both phases")
    print(f"{'':22s}{'beta growth':>20s}{'discrete rec.':>20s}{'sigmoid':>20s}{'topological':>20s}   at 100^3")
    for case in table1():
        line = f"{case.name:22s}"
        results = [
            *(
                blend_by_baseline(
                    case.structures, case.regions, case.blending, method, case.resolution, weight=case.weight
                )
                for method in EARLIER
            ),
            run(case),
        ]
        for result, paper in zip(results, case.table1, strict=True):
            line += f"{counts(result)} ({paper[0]:2d} {paper[1]:2d})".rjust(20)
        print(f"{line}   {counts(result, 1)}   {case.parameters}")


def print_table2() -> None:
    """Print rounds and seconds for Table 2 of the paper."""
    print("Table 2: rounds and seconds")
    print(
        f"{'':22s}{'rounds':>7s}{'paper':>6s}{'seconds':>9s}{'paper':>7s}{'ratio':>7s}{'on gudhi':>10s}{'ratio':>7s}"
        f"{'its own':>9s}{'left 1x':>9s}{'left 2x':>9s}{'intrinsic':>10s}"
    )
    for case in table2():
        result, seconds = timed(lambda case=case: run(case))
        with count_censuses() as seen:
            run(case)
        slow = seconds + sum(count * gudhi_seconds(case, shape) for shape, count in seen.items())
        with gudhi_persistence():
            _, printed = timed(lambda case=case: run(case, "paper", max_iterations=12))
        left = [a + b for a, b in zip(result.errors.n0.remaining, result.errors.n2.remaining, strict=True)]
        print(
            f"{case.name:22s}{result.iterations:7d}{case.paper_iterations:6d}{seconds:9.2f}{case.paper_seconds:7.2f}"
            f"{case.paper_seconds / seconds:7.1f}{slow:10.1f}{slow / seconds:7.0f}{printed:9.2f}{left[0]:9d}{left[1]:9d}"
            f"{max(result.errors.n0.intrinsic):10d}"
        )


@contextmanager
def count_censuses() -> Iterator[Counter[tuple[int, ...]]]:
    """Counts how often defects are counted on grids of each shape."""
    seen: Counter[tuple[int, ...]] = Counter()
    ours = blend_state.count_defects

    def counted(values: np.ndarray) -> object:
        seen[values.shape] += 1
        return ours(values)

    blend_state.count_defects = counted
    try:
        yield seen
    finally:
        blend_state.count_defects = ours


def gudhi_seconds(case: Case, shape: tuple[int, ...]) -> float:
    """Seconds of one call of gudhi, which computes all dimensions, for the initial blend."""
    grid = SampleGrid(*resolve_domain(case.regions, None), shape)
    values = run(case, "initial").field.on_grid(*grid.axes)
    start = time.process_time()
    gudhi_complex.gudhi_pairs(values, 0)
    return time.process_time() - start


@contextmanager
def gudhi_persistence() -> Iterator[None]:
    """The paper's descent on gudhi's persistence pairs instead of ours."""

    def gudhi_pairs_at_level(
        values: np.ndarray, dimension: int, convention: str, level: float
    ) -> topology.PersistencePairs:
        return gudhi_complex.gudhi_pairs(values, dimension, convention).alive_at(level)

    ours = topology.compute_pairs_at_level
    topology.compute_pairs_at_level = gudhi_pairs_at_level
    try:
        yield
    finally:
        topology.compute_pairs_at_level = ours


def print_pairs(count: int) -> None:
    """Print the success and the seconds for random pairs."""
    seconds, initial, failed = [], 0, 0
    for seed in range(count):
        pair = random_pair(seed)
        result, took = timed(
            lambda pair=pair: blend(pair.structures, pair.regions, [pair.blending], resolution=(50, 50, 50))
        )
        seconds.append(took)
        initial += result.errors.n0.initial[0] + result.errors.n2.initial[0] > 0
        if not result.converged:
            failed += 1
            print(f"  {seed}: {pair.name}: {result.message}")
    print(
        f"{count} random pairs: {count - failed} without errors at 50^3 and 100^3 ({100 * (count - failed) / count:.1f} %), "
        f"{initial} had errors at first; seconds median {np.median(seconds):.3f}, "
        f"90 % {np.quantile(seconds, 0.9):.3f}, max {max(seconds):.2f}"
    )


def print_specks(count: int) -> None:
    """Print the defects of repaired pairs on a grid that was not checked, without and with the search for subgrid defects."""
    for wanted in (False, None, True):
        repaired = seen = real = blends = 0
        seconds = []
        for seed in range(count):
            pair = random_pair(seed)
            result, took = timed(
                lambda pair=pair, wanted=wanted: blend(
                    pair.structures, pair.regions, [pair.blending], resolution=(50, 50, 50), subgrid_check=wanted
                )
            )
            seconds.append(took)
            if result.errors.n0.initial[0] + result.errors.n2.initial[0] == 0:
                continue
            repaired += 1
            finer = sample_composition(result.field, SampleGrid(*result.domain, (150, 150, 150)))
            found, values = find_grid_defects(finer, 0, result.weights), finer.values(result.weights)
            true = 0
            for phase, labels in found.phases():
                for label in labels:
                    samples = np.flatnonzero(phase.mask_of(np.array([label])))
                    deepest = samples[np.argmin(phase.sign * values.ravel()[samples])]
                    true += is_isolated(result.field, finer.grid, finer.grid.points([deepest])[0], phase.sign)
            seen, real, blends = seen + found.n_defects, real + true, blends + (true > 0)
        print(
            f"subgrid_check={wanted}: {repaired} repaired pairs of {count}; at 150^3 {seen} parts stand alone, {real} of "
            f"them isolated on a close grid around, in {blends} blends; seconds median {np.median(seconds):.3f}"
        )


def print_large() -> None:
    """Print the seconds and the memory for a grid of 200^3 samples."""
    n = 200
    structures = fields.rod(tpms("schwarz_p", 6), -0.8), fields.rod(tpms("iwp", 6), -2.0)
    regions = fields.box((0, 0, 0), (0.5, 1, 1)), fields.box((0.5, 0, 0), (1, 1, 1))
    middle = fields.box((0.3, 0, 0), (0.7, 1, 1))
    for weight in ("auto", "volume"):
        result, seconds = timed(
            lambda weight=weight: blend(structures, regions, [middle], resolution=(n, n, n), weight=weight)
        )
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"{n}^3 ({weight}): {seconds:.1f} s, peak {peak:.2f} GiB, {result.iterations} rounds, n0 at first "
            f"{result.errors.n0.initial}: {result.message}"
        )


NECKS = (
    ("schwarz_p", "rod", -0.8, "iwp", "rod", -2), ("schwarz_p", "pore", -0.5, "iwp", "rod", 2),
    ("gyroid", "rod", -0.8, "diamond", "rod", -0.4), ("schwarz_p", "pore", 0.6, "iwp", "pore", 2),
    ("schwarz_p", "rod", -0.5, "iwp", "pore", 2), ("gyroid", "pore", 0.4, "neovius", "rod", -3),
    ("schwarz_p", "rod", -0.4, "iwp", "pore", 1), ("diamond", "rod", -0.2, "iwp", "rod", -2),
    ("gyroid", "rod", -0.4, "iwp", "rod", -2), ("gyroid", "pore", 0.4, "iwp", "rod", -2),
)  # fmt: skip


def print_necks(periods: float = 8) -> None:
    """Print neck widths for a minimum of a tenth of the period, measured on another grid than the optimiser's."""
    width = 0.1 / periods
    regions = fields.box((0, 0, 0), (0.5, 0.25, 0.25)), fields.box((0.5, 0, 0), (1, 0.25, 0.25))
    middle, grid = fields.box((0.3, 0, 0), (0.7, 0.25, 0.25)), SampleGrid((0, 0, 0), (1, 0.25, 0.25), (97, 31, 31))
    print(f"minimum_neck {width:g}: narrowest neck in the blending region, of the request")
    for a, kind_a, level_a, b, kind_b, level_b in NECKS:
        structures = [
            getattr(fields, k)(tpms(s, periods), c) for s, k, c in ((a, kind_a, level_a), (b, kind_b, level_b))
        ]
        shown = []
        for wanted in (None, width):
            result, seconds = timed(
                lambda s=structures, w=wanted: blend(s, regions, [middle], resolution=(50, 50, 50), minimum_neck=w)
            )
            wide = measure_necks(sample_composition(result.field, grid), result.field, width)[1]
            shown.append(float(wide.min(initial=np.inf)) / width)
        print(
            f"  {kind_a}-{a} {level_a:g} + {kind_b}-{b} {level_b:g}: {shown[0]:.2f} -> {shown[1]:.2f}, {seconds:.2f} s, "
            f"missed {len(result.necks)}, {result.message}"
        )


def print_persistence() -> None:
    """Print the seconds of persistence computations."""
    print(
        "Persistence of a blend, dimensions 0 and 2, seconds: pairs alive at 0, all pairs, gudhi (which adds dimension 1)"
    )
    case = table1()[2]
    start = run(case, "initial").field
    for shape in ((50, 50, 50), (100, 100, 25), (100, 100, 100), (200, 200, 200)):
        values = start.on_grid(*SampleGrid((0, 0, 0), (1, 0.25, 0.25), shape).axes)
        took = []
        for pairs in (topology.compute_pairs_at_level, topology.compute_persistence, gudhi_complex.gudhi_pairs):
            if pairs is gudhi_complex.gudhi_pairs and values.size > 2_000_000:
                took.append(np.nan)
                continue
            begin = time.process_time()
            for dimension in (0, 2):
                pairs(values, dimension)
            took.append(time.process_time() - begin)
        took[2] /= 2  # one call of gudhi computes all dimensions; two were made
        print(f"  {'x'.join(map(str, shape)):14s}{took[0]:8.4f}{took[1]:8.3f}{took[2]:8.2f}   x{took[2] / took[0]:.0f}")


def main(arguments: list[str]) -> None:
    """Print the tables named in the arguments."""
    start = time.process_time()
    run(table1()[0])
    run(table1()[1], "paper", max_iterations=2)
    print(f"first call, with what has to be compiled or read from the cache: {time.process_time() - start:.1f} s")
    wanted = arguments or ["table1", "table2"]
    count = next((int(a) for a in wanted if a.isdigit()), 200)
    for name, print_table in (
        ("table1", print_table1), ("table2", print_table2), ("pairs", lambda: print_pairs(count)),
        ("specks", lambda: print_specks(count)), ("large", print_large),
        ("necks", print_necks), ("persistence", print_persistence),
    ):  # fmt: skip
        if name in wanted:
            print_table()


if __name__ == "__main__":
    main(sys.argv[1:])
