"""How time and memory grow with the number of cells: the solid of a filled cube, its triangles and its layers.

    python -m benchmarks.growth [--cells 8,125,1000,8000,97336] [--most-of-solids 1000] [--plot growth.png]

Cubes of whole numbers of cells of 1 mm, walls of .12. Each making runs in a process of its own: CPU seconds, its children
included, and memory at its peak. The last line of each kind is the exponent of the seconds between the last two numbers of cells.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

MAKE = """
import resource, sys
import build123d as bd
import tpmscad

kind, edge = sys.argv[1], int(sys.argv[2])
body, asked = bd.Pos(edge / 2, edge / 2, edge / 2) * bd.Box(edge, edge, edge), {"cell": 1, "thickness": 0.12, "progress": False}
if kind == "solid":
    tpmscad.infill(body, "gyroid", **asked)
elif kind == "triangles":
    tpmscad.infill_triangles(body, "gyroid", deviation=0.05, **asked)
else:
    tpmscad.infill_layers(body, "gyroid", height=0.1, chord_error=0.01, **asked)
used = [resource.getrusage(which) for which in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
print(sum(u.ru_utime + u.ru_stime for u in used), max(u.ru_maxrss for u in used) / 2**20)
"""

KINDS = ("solid", "triangles", "layers")


def measure(kind: str, edge: int) -> tuple[float, float]:
    """CPU seconds and GiB of a cube of edge^3 cells."""
    done = subprocess.run([sys.executable, "-c", MAKE, kind, str(edge)], capture_output=True, text=True, check=True)
    seconds, memory = done.stdout.split()[-2:]
    return float(seconds), float(memory)


def draw(path: Path, rows: dict[str, list[tuple[int, float, float]]]) -> None:
    """Seconds and memory against cells, both axes logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.6))
    for kind, found in rows.items():
        cells, seconds, memory = np.array(found).T
        axes[0].loglog(cells, seconds, "o-", label=kind)
        axes[1].loglog(cells, memory, "o-", label=kind)
    for axis, name in zip(axes, ("CPU seconds", "GiB"), strict=True):
        axis.set_xlabel("cells")
        axis.set_ylabel(name)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", default="8,125,1000,8000,97336")
    parser.add_argument("--most-of-solids", type=int, default=1000)
    parser.add_argument("--plot", type=Path)
    given = parser.parse_args()
    rows: dict[str, list[tuple[int, float, float]]] = {}
    for kind in KINDS:
        for cells in map(int, given.cells.split(",")):
            if kind == "solid" and cells > given.most_of_solids:
                continue
            found = measure(kind, round(cells ** (1 / 3)))
            rows.setdefault(kind, []).append((cells, *found))
            print(f"{kind:9s} {cells:7d} cells {found[0]:8.1f} s {found[1]:6.2f} GiB", flush=True)
        (few, less, _), (many, more, _) = rows[kind][-2:]
        print(f"{kind:9s} exponent {np.log(more / less) / np.log(many / few):.2f}", flush=True)
    if given.plot is not None:
        draw(given.plot, rows)


if __name__ == "__main__":
    main()
