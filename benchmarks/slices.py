"""Slices of a lattice: time, the sum of areas against the volume, chord error, crossings, and files read by other readers.

`python -m benchmarks.slices [CELLS [LAYERS]]`; 4 cells along each axis and 1000 layers by default.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import build123d as bd
import numpy as np
from scipy.spatial import cKDTree

import tpmscad
from tpmscad._typing import Array
from tpmscad.studies.layer_slices import slice_shape

CHORD_ERROR = 0.01
LAYERS_PROBED = 3
CHORDS_PROBED = 200


def worker_seconds() -> float:
    """CPU time of the processes that have ended, which this one started."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def chord_errors(model: tpmscad.Model, layer: object) -> float:
    """Greatest distance of middles of chords from the section that the kernel cuts."""
    middle = layer.middle  # type: ignore[attr-defined]
    wire = bd.Compound(bd.section(model.solid, bd.Plane.XY.offset(middle)).edges())
    middles = np.concatenate([0.5 * (c + np.roll(c, -1, axis=0)) for c in layer.contours])  # type: ignore[attr-defined]
    chosen = middles[:: max(1, len(middles) // CHORDS_PROBED)]
    return max(float(bd.Vertex(*p, middle).distance(wire)) for p in chosen.tolist())


def count_crossings(contours: tuple[Array, ...]) -> int:
    """Pairs of chords of a layer that cross each other, found among chords near each other."""
    a = np.concatenate(contours)
    b = np.concatenate([np.roll(c, -1, axis=0) for c in contours])
    reach = float(np.linalg.norm(b - a, axis=1).max())
    pairs = cKDTree(0.5 * (a + b)).query_pairs(reach, output_type="ndarray")
    i, j = pairs.T
    apart = (a[i] != a[j]).any(axis=1) & (a[i] != b[j]).any(axis=1) & (b[i] != a[j]).any(axis=1)
    i, j = i[apart], j[apart]

    def side(p: Array, q: Array, r: Array) -> Array:
        (x, y), (u, v) = (q - p).T, (r - p).T
        return np.asarray(np.sign(x * v - y * u))

    cross = (side(a[i], b[i], a[j]) * side(a[i], b[i], b[j]) < 0) & (
        side(a[j], b[j], a[i]) * side(a[j], b[j], b[i]) < 0
    )
    return int(cross.sum())


def read_cli(path: Path) -> tuple[int, int, float]:
    """Layers, contours and the sum of areas times heights of a CLI file, read by its specification alone."""
    heights, layers, contours, volume = [], 0, 0, 0.0
    with path.open(encoding="ascii") as file:
        for line in file:
            keyword, _, text = line.strip().partition("/")
            if keyword == "$$DIMENSION":
                heights.append(float(text.split(",")[2]))
            elif keyword == "$$LAYER":
                heights.append(float(text))
                layers += 1
            elif keyword == "$$POLYLINE":
                _, direction, count, *values = text.split(",")
                x, y = np.array(values, float).reshape(int(count), 2).T
                assert (x[0], y[0]) == (x[-1], y[-1]), "an open contour"
                area = 0.5 * float((x[:-1] * y[1:] - y[:-1] * x[1:]).sum())
                assert (area > 0) == (direction == "1"), "a contour of the wrong direction"
                contours += 1
                volume += area * (heights[-1] - heights[-2])
    return layers, contours, volume


def read_3mf(path: Path) -> tuple[int, int]:
    """Layers and contours of a 3MF file, by lib3mf."""
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    stacks = model.GetSliceStacks()
    stacks.MoveNext()
    stack = stacks.GetCurrentSliceStack()
    count = stack.GetSliceCount()
    return count, sum(stack.GetSlice(i).GetPolygonCount() for i in range(count))


def main() -> None:
    """Print the table."""
    cells, layers = (int(a) for a in (sys.argv[1:] + ["4", "1000"][len(sys.argv) - 1 :])[:2])
    model = tpmscad.lattice("gyroid", cell=10.0, cells=(cells,) * 3, thickness=1.0)
    begun, wall, workers = time.process_time(), time.perf_counter(), worker_seconds()
    found = model.slices(10.0 * cells / layers, CHORD_ERROR)
    print(found)
    took = time.process_time() - begun + worker_seconds() - workers
    print(f"time               {took:.1f} CPU s, {time.perf_counter() - wall:.1f} s")
    begun, workers = time.process_time(), worker_seconds()
    bounds = [z for *_, z in model.bounding_box]
    whole = slice_shape(model.wrapped, model.name, 10.0 * cells / layers, CHORD_ERROR, bounds)
    other = time.process_time() - begun + worker_seconds() - workers
    print(f"every face cut     {other:.1f} CPU s, {other / took:.1f} times as long")
    contours = sum(len(a.contours) == len(b.contours) for a, b in zip(found, whole, strict=True))
    areas = max(abs(a.area - b.area) for a, b in zip(found, whole, strict=True))
    print(f"compared           {contours} of {layers} layers with as many contours, areas within {areas:.1e} mm2")
    print(f"sum of areas       {found.volume / model.volume - 1:.2e} off the volume, relative")
    probed = [found[int(i)] for i in np.linspace(0, layers - 1, LAYERS_PROBED + 2)[1:-1]]
    print(f"chord error        {max(chord_errors(model, layer) for layer in probed):.4g} mm, {CHORD_ERROR} asked for")
    print(f"chords unresolved  {found.unresolved}")
    print(f"crossings          {sum(count_crossings(layer.contours) for layer in found if layer.contours)}")
    with tempfile.TemporaryDirectory() as folder:
        for suffix, read in ((".cli", read_cli), (".3mf", read_3mf)):
            path = Path(folder) / f"slices{suffix}"
            found.write(path)
            print(f"{suffix} read back     {read(path)}, {path.stat().st_size / 1e6:.1f} MB")
    print(
        f"written            {len(found)} layers, {found.n_contours} contours, polygons' volume within the chord error"
    )


if __name__ == "__main__":
    main()
