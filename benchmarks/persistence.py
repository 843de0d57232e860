"""Persistence of sampled fields: this package beside gudhi and, where it is installed, cripser, in one run.

    python -m benchmarks.persistence [--largest-gudhi 1000000] [--no-200] [--json FILE]

Both dimensions a blending loop needs, 0 and 2, of a blend of porous structures and of white noise. Times are CPU seconds of
one thread: the least of three for this package, one run for the others, which compute dimension 1 as well and can't leave it out.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import fields, topology
from tpmscad.topology import gudhi_complex

SHAPES = ((50, 50, 50), (100, 100, 25), (100, 100, 100), (200, 200, 200))
REPEATS = 3
COLUMNS = (
    "shape",
    "field",
    "gudhi",
    "cripser",
    "full",
    "straddle",
    "isolated",
    "gudhi/full",
    "gudhi/straddle",
    "pairs",
    "errors",
)

Row = dict[str, Any]


def samples(shape: tuple[int, int, int]) -> Iterator[tuple[str, np.ndarray]]:
    """Rod-P blended into rod-IWP along x, eight periods to the unit (porous blending, Table 1), and noise."""
    first = fields.rod(fields.tpms("schwarz_p", 1 / 8), -0.8)
    second = fields.rod(fields.tpms("iwp", 1 / 8), -2.0)
    weight = fields.ramp("x", (0.3, 0.7), (0.0, 1.0))
    longest = max(shape) - 1
    yield "blend", ((1 - weight) * first + weight * second).on_grid(*(np.arange(n) / longest for n in shape))
    yield "white", np.random.default_rng(0).normal(size=shape)


def seconds(call: Callable[[], Any], repeats: int = 1) -> tuple[float, Any]:
    """CPU seconds, the least of so many, and the last answer."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        answer = call()
        best = min(best, time.process_time() - start)
    return best, answer


def both(compute: Callable[..., Any], values: np.ndarray, *rest: Any) -> list[Any]:
    return [compute(values, dimension, *rest) for dimension in (0, 2)]


def row(shape: tuple[int, int, int], name: str, values: np.ndarray, with_gudhi: bool) -> Row:
    full, pairs = seconds(lambda: both(topology.compute_persistence, values), REPEATS)
    straddle, alive = seconds(lambda: both(topology.compute_pairs_at_level, values), REPEATS)
    isolated, _ = seconds(lambda: topology.count_components_and_cavities(values), REPEATS)
    result: Row = {
        "shape": "x".join(map(str, shape)),
        "field": name,
        "full": full,
        "straddle": straddle,
        "isolated": isolated,
    }
    result["pairs"] = "+".join(str(len(p)) for p in pairs)
    result["errors"] = "+".join(str(n) for n in (len(alive[0]) - 1, len(alive[1])))
    if with_gudhi:
        result["gudhi"], expected = seconds(lambda: gudhi_complex.gudhi_diagram(values, (0, 2)))
        result["gudhi/full"], result["gudhi/straddle"] = result["gudhi"] / full, result["gudhi"] / straddle
        for found, wanted in zip(pairs, expected, strict=True):
            assert np.array_equal(found.birth, wanted.birth), "births differ from gudhi's"
            assert np.array_equal(found.death, wanted.death), "deaths differ from gudhi's"
        for found, wanted in zip(alive, expected, strict=True):
            assert np.array_equal(found.death, wanted.alive_at().death), "deaths at the level differ from gudhi's"
    if with_gudhi and importlib.util.find_spec("cripser"):
        import cripser

        result["cripser"], _ = seconds(lambda: cripser.computePH(values, maxdim=2))
    return result


def first_call(cache: str) -> float:
    """CPU seconds of the first calls in a fresh process, the imports left out."""
    script = (
        "import numpy as np, time; from tpmscad import topology; a = np.random.default_rng(0).normal(size=(6, 6, 6))\n"
        "t = time.process_time()\n"
        "for d in (0, 2): topology.compute_persistence(a, d); topology.compute_pairs_at_level(a, d)\n"
        "topology.count_components_and_cavities(a); print(time.process_time() - t)"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def shown(value: Any, column: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.0f}x" if "/" in column else f"{value:.4f}" if value < 1 else f"{value:.2f}"
    return str(value)


def main(arguments: list[str] | None = None) -> list[Row]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--largest-gudhi", type=int, default=1_000_000, help="samples beyond which gudhi and cripser are left out"
    )
    parser.add_argument("--no-200", action="store_true", help="leave out 200^3")
    parser.add_argument("--json", type=Path, help="write the rows there, too")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as cache:
        compiling, loading = first_call(cache), first_call(cache)
    print(f"first calls in a process: {compiling:.1f} s compiling, once; {loading:.2f} s when cached on disk\n")
    both(topology.compute_persistence, np.zeros((2, 2, 2)))
    print("  ".join(f"{column:>14}" for column in COLUMNS))
    rows = []
    for shape in SHAPES[: -1 if options.no_200 else None]:
        for name, values in samples(shape):
            rows.append(row(shape, name, values, values.size <= options.largest_gudhi))
            print("  ".join(f"{shown(rows[-1].get(column), column):>14}" for column in COLUMNS), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"compile": compiling, "load": loading, "rows": rows}, indent=1))
    return rows


if __name__ == "__main__":
    main()
