"""Beams as exact solids, and as triangles: random graphs with cones, files of beams.

    python -m benchmarks.beams [graphs | diameters] [COUNT]     # random graphs, by radii at nodes, or by any diameters
    python -m benchmarks.beams FILE.3mf ...                     # triangles, layers and the solid of each
    python -m benchmarks.beams files DIR                        # ten files written, one for each feature, and read again

Volumes are compared with samples of the field, in standard errors; the first Betti number with that of the graph.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields
from tpmscad.fields.kinds.strut_graphs import StrutsField

SAMPLES, AT_A_TIME = 4_000_000, 250_000


def random_graph(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of a shaken grid and beams between some neighbours, in one piece: 3 to about 400 beams."""
    counts = rng.integers(2, 7, 3)
    numbers = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    points = 10.0 * numbers + rng.uniform(-2, 2, (len(numbers), 3))
    near = [(i, j) for i in range(len(points)) for j in range(i) if np.abs(numbers[i] - numbers[j]).sum() <= 1]
    far = [(i, j) for i in range(len(points)) for j in range(i) if np.abs(numbers[i] - numbers[j]).max() <= 1]
    kept = {pair for pair in near if rng.random() < 0.9} | {pair for pair in far if rng.random() < 0.04}
    return points, np.array(sorted(kept))


def run_graphs(count: int, *, by_nodes: bool) -> None:
    print("graph  beams  diameters  s      met    z     Betti 1, expected (of these contacts)  faces")
    for seed in range(count):
        rng = np.random.default_rng(seed)
        points, edges = random_graph(rng)
        values = rng.uniform(0.8, 2.0, rng.integers(1, 100))
        diameters = rng.choice(values, len(points))[edges] if by_nodes else rng.choice(values, (len(edges), 2))
        field = fields.struts(points, edges, diameters)
        low, high = field.points.min(axis=0) - 2, field.points.max(axis=0) + 2
        began = time.process_time()
        try:
            model = tpmscad.solidify(field, (tuple(low), tuple(high)), tol=0.02, progress=False)
        except tpmscad.TpmscadError as error:
            print(f"{seed:5}  {len(edges):5}  refused after {time.process_time() - began:.1f} s: {error}", flush=True)
            continue
        seconds = time.process_time() - began
        z = (model.volume - (found := sample_volume(field, low, high))[0]) / found[1]
        pieces = model.certificate.betti[0]
        contacts = count_contacts(field)
        expected = len(edges) - len(field.points) + pieces + contacts
        print(
            f"{seed:5}  {len(edges):5}  {len(np.unique(diameters)):9}  {seconds:5.1f}  {model.certificate.met!s:5}  {z:+.1f}  "
            f"{model.certificate.betti[1]:7}, {expected:8} ({contacts:2})  {model.certificate.n_faces:5}",
            flush=True,
        )


def count_contacts(field: StrutsField) -> int:
    """The places where struts touch that have no node in common, by points along them: each adds a tunnel to the graph's."""
    t = np.linspace(0, 1, 401)[:, None]
    start, along = field.points[field.edges[:, 0]], np.diff(field.points[field.edges], axis=1)[:, 0]
    radii = (1 - t) * field.radii[:, 0] + t * field.radii[:, 1]
    lines = start[None] + t[..., None] * along
    trees = [cKDTree(lines[:, k]) for k in range(len(start))]
    found: list[tuple[int, int, np.ndarray]] = []
    for i in range(len(start)):
        reach = field.radii[i].max() + field.radii.max()
        for j in range(i):
            near = np.abs(lines[200, i] - lines[200, j]).max() < 0.5 * np.abs(along[[i, j]]).sum() + reach
            if not near or set(field.edges[i]) & set(field.edges[j]):
                continue
            distance, at = trees[j].query(lines[:, i], distance_upper_bound=reach)
            depth = distance - radii[:, i] - np.append(radii[:, j], 0.0)[at]
            if depth.min() < 0:
                found.append((i, j, lines[np.argmin(depth), i]))
    same = [
        (a, b)
        for a, first in enumerate(found)
        for b, second in enumerate(found[:a])
        if {*first[:2]} & {*second[:2]} and np.linalg.norm(first[2] - second[2]) < 2 * field.radii.max()
    ]
    links = coo_array((np.ones(len(same)), tuple(np.array(same, int).reshape(-1, 2).T)), shape=(len(found),) * 2)
    return int(connected_components(links, directed=False)[0]) if found else 0


def sample_volume(field: Any, low: np.ndarray, high: np.ndarray) -> tuple[float, float]:
    """The volume of a field by samples, and its standard error."""
    rng, inside = np.random.default_rng(1), 0
    for _ in range(SAMPLES // AT_A_TIME):
        inside += int((field(rng.uniform(low, high, (AT_A_TIME, 3))) < 0).sum())
    share, box = inside / SAMPLES, float(np.prod(high - low))
    return box * share, box * float(np.sqrt(share * (1 - share) / SAMPLES))


def run_samples(folder: Path) -> None:
    """Ten files written to a folder: what is read, the volume of triangles beside samples, validity, and the way out and in."""
    from benchmarks.beam_samples import save_all

    folder.mkdir(parents=True, exist_ok=True)
    print(
        "file                         beams nodes radii conical balls clipped triangles  volume    by samples         strict"
    )
    for path in save_all(folder):
        report, found, again = tpmscad.check_step(path), fields.beams(path), folder / f"again_{path.name}"
        low, high = np.array(report.bounds)
        low, high = low - 1, high + 1
        body = bd.Pos(*(0.5 * (low + high)).tolist()) * bd.Box(*(high - low).tolist())
        fine = 0.005 * float(found.diameters.min())
        part = tpmscad.infill_triangles(body, found, tol=fine, deviation=fine, progress=False)
        volume, error = sample_volume(found, low, high)
        tpmscad.export_beams(found.struts, again)
        back = fields.beams(again).struts
        apart = [
            float(np.abs(getattr(back, name) - getattr(found.struts, name)).max())
            for name in ("points", "diameters", "balls")
        ]
        assert np.array_equal(back.edges, found.edges)
        print(
            f"{path.stem:28} {report.beams:5} {report.nodes:5} {report.different_radii:5} {report.conical:7} {report.balls:5} "
            f"{report.clipped:7} {report.triangles:9}  {part.volume:<9.7g} {volume:<9.7g} +- {error:<6.2g} "
            f"{is_strictly_valid(path)}; written again {is_strictly_valid(again)}, off by {max(apart):.1g}",
            flush=True,
        )
        for note in report.notes:
            print(f"    {note}")


def is_strictly_valid(path: Path) -> bool:
    """Whether lib3mf's strict reader reads a file without a warning."""
    import lib3mf

    from tpmscad.fields.data.beam_files import keep_locale

    reader = lib3mf.Wrapper().CreateModel().QueryReader("3mf")
    reader.SetStrictModeActive(True)
    with keep_locale():
        try:
            reader.ReadFromFile(str(path))
        except lib3mf.ELib3MFException:
            return False
    return bool(reader.GetWarningCount() == 0)


def run_file(path: Path) -> None:
    print(tpmscad.check_step(path))
    began = time.process_time()
    found = fields.beams(path)
    print(f"read in {time.process_time() - began:.1f} s")
    struts: StrutsField = found.struts
    low, high = (f(struts.points, axis=0) + s * float(struts.balls.max()) * 1.5 for f, s in ((np.min, -1), (np.max, 1)))
    body = bd.Pos(*(0.5 * (low + high)).tolist()) * bd.Box(*(high - low).tolist())
    tol = 0.02 * float(np.median(struts.radii))
    began = time.process_time()
    part = tpmscad.infill_triangles(body, struts, tol=tol, progress=False)
    volume, error = sample_volume(struts, low, high)
    print(
        f"triangles in {time.process_time() - began:.1f} s, volume {part.volume:.6g}, by samples {volume:.6g} +- {error:.2g}"
    )
    began = time.process_time()
    layers = tpmscad.infill_layers(
        body, struts, tol=tol, height=float(np.ptp([low, high], axis=0)[2]) / 100, progress=False
    )
    print(f"100 layers in {time.process_time() - began:.1f} s, volume {layers.volume:.6g}")
    began = time.process_time()
    try:
        model = tpmscad.solidify(struts, (tuple(low), tuple(high)), tol=tol, progress=False)
        print(f"solid in {time.process_time() - began:.1f} s: {model}")
    except tpmscad.TpmscadError as error_:
        print(f"solid refused after {time.process_time() - began:.1f} s: {error_}")


def main() -> None:
    first, *rest = sys.argv[1:] or ["graphs"]
    if first in ("graphs", "diameters"):
        run_graphs(int(rest[0]) if rest else 20, by_nodes=first == "graphs")
    elif first == "files":
        run_samples(Path(rest[0]))
    else:
        for path in (first, *rest):
            run_file(Path(path))


if __name__ == "__main__":
    main()
