"""CAD files, meshes and images of a folder, filled with a gyroid with and without a skin, and judged apart.

    python -m benchmarks.real_files FOLDER [--cells 30] [--skin-cells 0.1] [--seconds 120] [--only PART OF A NAME]
                                        [--points 20000]

Of a CAD file the largest solid is filled, healed if it must be; of an image what is above Otsu's threshold, or all labels, which
is also made a solid without a lattice. The cell is that of which the volume holds as many as asked for; the wall is a tenth, and
the tolerance .005 of it, of images at least a tenth of their spacing, the command line's default. Each file has a line with its
kind and faces or samples, and one for each task: outcome, CPU seconds, faces and method. Each task runs in a process of its own.

Outcomes: met; WRONG if the file read again is not valid, or its volume is not that of random points which lie in the body (by the
kernel's classifier, by winding numbers of the triangles, by the samples), and in the wall by the published formula of the surface
or within the skin of the body's triangles, together with what a skin by the distance states to leave solid in narrow parts;
"not met" and "refused" with the reason; "hang" after three times the CPU seconds given, without the judgement.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Plane, GeomAbs_Sphere, GeomAbs_Torus
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_IN
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D, vtkImplicitPolyDataDistance
from vtkmodules.vtkFiltersModeling import vtkSelectEnclosedPoints

import tpmscad
from benchmarks.trial_judges import MINIMAL_OFF, STANDARD_ERRORS, NodalFunction, signed_distance
from benchmarks.trial_statements import triangulate
from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.fields.data.field_notes import DEFAULT_TOL_SPACINGS
from tpmscad.kernel.measure.edge_gaps import measure_accuracy
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import faces_of, solids_of

CAD, MESHES = (".step", ".stp", ".brep", ".iges", ".igs"), (".stl", ".obj", ".ply", ".3mf")
IMAGES = (".nii", ".nrrd", ".mha", ".map", ".mrc", ".tif", ".npy", ".npz", ".vti", ".vtu")

QUADRICS = (GeomAbs_Plane, GeomAbs_Cylinder, GeomAbs_Cone, GeomAbs_Sphere, GeomAbs_Torus)

WALL_CELLS, TOL_CELLS = 0.1, 0.005
MAX_BATCHES = 20
"""How often random points are drawn in the body's box, until a quarter of a batch lies in it."""

SAMPLES_PER_SPACING, MAX_SAMPLES = 2.5, 8_000_000
"""Samples of an image's field to its own spacing, and the most in its box, for triangles of its level set."""

VOXEL_RTOL = 0.1
"""Difference allowed between the volume of an image's solid and that of its samples inside: they are few."""


@dataclass(frozen=True)
class Judged:
    """A body by means of its own: which points are inside, how far they are from its surface, its box and volume.

    `given` is filled.

    rtol: of the volume; tol: the least tolerance that what is given deserves.
    """

    given: Any
    is_inside: Callable[[Array], Array]
    distances: Callable[[Array], Array]
    low: Array
    high: Array
    volume: float
    what: str
    rtol: float = 0.0
    tol: float = 0.0


def load_cad(path: Path) -> Judged:
    """The largest solid of a CAD file, as `read_body` heals it."""
    file = tpmscad.read_body(path)
    (body,) = solids_of(file.shape)
    measured = check_shape(body)
    volume = measured.volume
    deflection = 0.001 * volume ** (1 / 3)
    vertices, triangles = triangulate(body, deflection)
    classifier = BRepClass3d_SolidClassifier(body)

    def is_inside(points: Array) -> Array:
        """Far from the triangles by these; near them by the classifier, which takes up to 50 ms for a point."""
        found, distances = locate_in_triangles(vertices, triangles, points)
        for k in np.flatnonzero(distances < 1.5 * deflection):
            classifier.Perform(gp_Pnt(*points[k].tolist()), 1e-7)
            found[k] = classifier.State() == TopAbs_IN
        return found

    faces = faces_of(body)
    free = sum(BRepAdaptor_Surface(face).GetType() not in QUADRICS for face in faces)
    words = f"{len(file.solids)} solids, {len(faces)} faces, {free} free-form, gaps {measure_accuracy([body]):.1e}"
    distances = partial(measure_distances, vertices, triangles)
    box = vertices.min(axis=0), vertices.max(axis=0)
    return Judged(file, is_inside, distances, *box, volume, words + (", healed" if file.healed else ""))


def load_mesh(path: Path) -> Judged:
    """The triangles of a file."""
    mesh: Any = trimesh.load(path, force="mesh")
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)

    def is_inside(points: Array) -> Array:
        corners = vertices[triangles]
        return np.concatenate(
            [find_winding(corners, batch) > 0.5 for batch in np.array_split(points, len(points) // 50 + 1)]
        )

    distances = partial(measure_distances, vertices, triangles)
    box = vertices.min(axis=0), vertices.max(axis=0)
    return Judged(path, is_inside, distances, *box, float(mesh.volume), f"{len(triangles)} triangles")


def locate_in_triangles(vertices: Array, triangles: Array, points: Array) -> tuple[Array, Array]:
    """Whether each of points (n, 3) lies inside closed triangles, and its distance to them, by VTK."""
    search = vtkSelectEnclosedPoints()
    search.SetSurfaceData(make_poly_data(vertices, triangles))
    search.SetInputData(make_poly_data(points))
    search.SetTolerance(0.0)
    search.Update()
    inside = vtk_to_numpy(search.GetOutput().GetPointData().GetArray("SelectedPoints")) == 1
    return np.asarray(inside), measure_distances(vertices, triangles, points)


def measure_distances(vertices: Array, triangles: Array, points: Array) -> Array:
    """Distances (n,) of points (n, 3) to triangles, by VTK."""
    distance, found = vtkImplicitPolyDataDistance(), vtkDoubleArray()
    distance.SetInput(make_poly_data(vertices, triangles))
    distance.FunctionValue(make_poly_data(points).GetPoints().GetData(), found)
    return np.abs(vtk_to_numpy(found))


def make_poly_data(vertices: Array, triangles: Array | None = None) -> vtkPolyData:
    """Points, and triangles between them, for VTK."""
    data, holder = vtkPolyData(), vtkPoints()
    holder.SetData(numpy_to_vtk(np.ascontiguousarray(vertices, float), deep=True))
    data.SetPoints(holder)
    if triangles is not None:
        cells, polygons = np.column_stack([np.full(len(triangles), 3), triangles]).astype(np.int64), vtkCellArray()
        polygons.ImportLegacyFormat(numpy_to_vtkIdTypeArray(cells.ravel(), deep=True))
        data.SetPolys(polygons)
    return data


def find_winding(corners: Array, points: Array) -> Array:
    """Winding numbers of triangles (m, 3, 3) about points (n, 3): van Oosterom and Strackee (1983)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    top = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    return np.arctan2(top, below).sum(axis=1) / (2 * np.pi)


def load_image(path: Path) -> Judged:
    """What is above Otsu's threshold in an image, or its greatest label."""
    read: Callable[..., Any] = fields.sampled
    given: dict[str, Any] = {}
    while True:
        try:
            field = read(path, **given)
            break
        except tpmscad.InvalidRequest as error:
            known = read, dict(given)
            if "labels" in str(error):
                read, given = fields.labels, {**given, "label": "all"}
            else:
                given |= {"volume": 0} if "volumes" in str(error) else {"centred": True}
            if (read, given) == known:
                raise
    low, high = np.array(field.domain)
    points = low + (high - low) * np.random.default_rng(3).random((200_000, 3))
    if read is fields.sampled:
        field = read(path, level=find_otsu_threshold(field(points)), **given)
    inside = field(points) < 0
    vertices, triangles = triangulate_level_set(field, low, high)

    def measure_depths(at: Array) -> Array:
        """Where a side of the box is nearer than the level set, the body ends there."""
        to_box = np.minimum(at - low, high - at).min(axis=1)
        return np.asarray(np.minimum(to_box, measure_distances(vertices, triangles, at)))

    return Judged(
        field,
        lambda at: field(at) < 0,
        measure_depths,
        points[inside].min(axis=0),
        points[inside].max(axis=0),
        float(inside.mean() * np.prod(high - low)),
        f"{field}"[:60],
        VOXEL_RTOL,
        DEFAULT_TOL_SPACINGS * min(field.spacing),
    )


def triangulate_level_set(field: Any, low: Array, high: Array) -> tuple[Array, Array]:
    """Vertices and triangles of {field = 0} in a box, by VTK's flying edges from samples closer than the field's own."""
    spacing = max(min(field.spacing) / SAMPLES_PER_SPACING, float((np.prod(high - low) / MAX_SAMPLES) ** (1 / 3)))
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    x, y, z = (np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True))
    values = np.stack([field(np.stack(np.meshgrid([a], y, z, indexing="ij"), axis=-1).reshape(-1, 3)) for a in x])
    image, edges = vtkImageData(), vtkFlyingEdges3D()
    image.SetDimensions(*counts.tolist())
    image.SetOrigin(*low.tolist())
    image.SetSpacing(*((high - low) / (counts - 1)).tolist())
    image.GetPointData().SetScalars(numpy_to_vtk(values.reshape(counts).ravel(order="F"), deep=True))
    edges.SetInputData(image)
    edges.SetValue(0, 0.0)
    edges.Update()
    found = edges.GetOutput()
    triangles = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return vtk_to_numpy(found.GetPoints().GetData()).astype(float), triangles


def find_otsu_threshold(values: Array) -> float:
    """The threshold that parts values (n,) into two classes with the greatest variance between them (Otsu 1979)."""
    counts, edges = np.histogram(values, 256)
    middles = 0.5 * (edges[1:] + edges[:-1])
    below, sums = np.cumsum(counts)[:-1], np.cumsum(counts * middles)[:-1]
    above, mean = len(values) - below, float(values.mean())
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.where((below > 0) & (above > 0), (mean * below - sums) ** 2 / (below * above), 0.0)
    return float(edges[1:-1][int(np.argmax(between))])


def sample_fraction(body: Judged, cell: float, skin: float | None, batch: int) -> tuple[float, float, float]:
    """By random points: the part of the body that wall and skin take, that of what is deeper which is no wall, and the standard
    error of the first; the wall and the skin by distances."""
    low, high = body.low, body.high
    rng = np.random.default_rng(5)
    batches: list[Array] = []
    while len(batches) < MAX_BATCHES and sum(map(len, batches)) < batch / 4:  # a thin body takes little of its box
        drawn = low + (high - low) * rng.random((batch, 3))
        batches.append(drawn[body.is_inside(drawn)])
    points = np.concatenate(batches)
    f = NodalFunction(tpmscad.surfaces.find_surface("gyroid").formula, (cell,) * 3, (0, 0, 0))
    half = WALL_CELLS * cell / 2
    wall = np.abs(signed_distance(f, points, half, cell)) < half
    in_skin = body.distances(points) < skin if skin is not None else np.zeros(len(points), bool)
    mean = float((wall | in_skin).mean())
    open_part = float((~wall[~in_skin]).mean()) if not in_skin.all() else 0.0
    return mean, open_part, float(np.sqrt(max(mean * (1 - mean), 1e-4) / len(points)))


def find_volume_left_solid(notes: Sequence[str]) -> float:
    """By how much cavities are smaller than what is deeper than the skin, as the notes state it: rounded edges, narrow parts."""
    found = [re.match(r"the cavity is (\S+) mm3 smaller", note) for note in notes]
    return sum(float(one[1]) for one in found if one)


def judge(
    body: Judged, model: Any, cell: float, skin: float | None, filled: bool, points: int
) -> tuple[list[str], str]:
    """What is wrong with the file of a solid, read again, and what part of the body it states to have left solid."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "filled.step"
        model.export_step(file)
        again: Any = tpmscad.check_step(file)
    faults = [] if again.ok else ["the file read again is not valid"]
    taken = (again.shape.volume + sum(model.certificate.dropped)) / body.volume
    fraction, open_part, error = sample_fraction(body, cell, skin, points) if filled else (1.0, 0.0, 0.0)
    left_solid = open_part * find_volume_left_solid(model.certificate.notes) / body.volume
    allowed = STANDARD_ERRORS * error + (0.2 * MINIMAL_OFF["gyroid"] * 6 if filled else 0.0) + body.rtol
    stated = f", and {left_solid:.4g} is stated to be left solid" if left_solid else ""
    if abs(taken - fraction - left_solid) > allowed:
        faults.append(f"it takes {taken:.4g} of the body, the sample says {fraction:.4g} +- {allowed:.2g}{stated}")
    return faults, f"takes {taken:.4g}, the sample says {fraction:.4g}{stated}" if stated else ""


def carry_out(path: Path, task: str, cells: float, skin_cells: float, points: int = 20_000) -> dict[str, Any]:
    """Outcome, words, faces and method of one task."""
    try:
        body = LOADERS[kind_of(path)](path)
    except tpmscad.TpmscadError as error:
        return {"outcome": "refused", "words": str(error), "seconds": time.process_time()}
    if task == "describe":
        return {"outcome": "read", "words": body.what}
    cell = (body.volume / cells) ** (1 / 3)
    skin = skin_cells * cell if task == "skin" else None
    tol = max(TOL_CELLS * cell, body.tol)
    begun = time.process_time()
    try:
        if task == "solid":
            model: Any = tpmscad.solidify(body.given, body.given.domain, tol=tol, progress=False)
        else:
            lattice = {"cell": cell, "thickness": WALL_CELLS * cell, "skin": skin, "tol": tol}
            model = tpmscad.infill(body.given, "gyroid", **lattice, progress=False)
    except tpmscad.TpmscadError as error:
        return {"outcome": "refused", "words": str(error), "seconds": time.process_time() - begun}
    seconds = time.process_time() - begun
    resource.setrlimit(
        resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    )  # the judgement takes its time
    found = {"seconds": seconds, "faces": model.certificate.n_faces, "method": model.trimmed_by, "words": ""}
    if not model.certificate.met:
        return found | {"outcome": "not met", "words": "; ".join(model.certificate.shortfalls)}
    faults, stated = judge(body, model, cell, skin, task != "solid", points)
    return found | {"outcome": "WRONG" if faults else "met", "words": "; ".join(faults) or stated}


LOADERS = {"CAD": load_cad, "mesh": load_mesh, "image": load_image}


def kind_of(path: Path) -> str:
    """The kind of a file, or "" for none that is read."""
    kinds = {"CAD": CAD, "mesh": MESHES, "image": IMAGES}
    return next((kind for kind, suffixes in kinds.items() if path.suffix.lower() in suffixes), "")


def run_apart(path: Path, task: str, given: argparse.Namespace) -> dict[str, Any]:
    """The result of a task in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.real_files", str(path), "--task", task]
    command += ["--cells", str(given.cells), "--skin-cells", str(given.skin_cells), "--points", str(given.points)]
    limit = int(3 * given.seconds)
    command = ["bash", "-c", f'ulimit -S -t {limit}; exec "$@"', "limited", *command]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return {"outcome": "hang", "words": f"after {limit} s of CPU time", "seconds": float("nan")}
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        last = (done.stderr.strip().splitlines() or ["no words"])[-1]
        return {"outcome": "crash", "words": f"status {done.returncode}: {last}", "seconds": float("nan")}
    result: dict[str, Any] = json.loads(lines[-1])
    return result


def main(arguments: list[str] | None = None) -> None:
    """Print a line for each file and task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cells", type=float, default=30)
    parser.add_argument("--skin-cells", type=float, default=0.1)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--only", default="")
    parser.add_argument(
        "--points", type=int, default=20_000, help="random points in the body's box, of which the volume is sampled"
    )
    parser.add_argument("--task", choices=("describe", "solid", "plain", "skin"), help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.task:
        print(json.dumps(carry_out(given.folder, given.task, given.cells, given.skin_cells, given.points)))
        return
    counts: dict[str, int] = {}
    for path in sorted(p for p in given.folder.rglob("*") if kind_of(p) and given.only in p.name):
        what = run_apart(path, "describe", given)
        print(f"{path.name} ({kind_of(path)}): {what['words'][:300]}", flush=True)
        if what["outcome"] != "read":
            counts[what["outcome"]] = counts.get(what["outcome"], 0) + 1
            continue
        for task in ("solid", "plain", "skin") if kind_of(path) == "image" else ("plain", "skin"):
            found = run_apart(path, task, given)
            counts[found["outcome"]] = counts.get(found["outcome"], 0) + 1
            print(
                f"    {task:5s} {found['outcome']:8s} {found.get('seconds', 0):7.1f} {found.get('faces', 0):6d} "
                f"{found.get('method', '') or ''} {found['words'][:250]}",
                flush=True,
            )
    print(counts)


if __name__ == "__main__":
    main()
