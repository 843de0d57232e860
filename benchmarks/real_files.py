"""Every valid single solid of a folder of CAD files filled with a gyroid, with and without a skin, and judged apart.

    python -m benchmarks.real_files FOLDER [--cells 30] [--skin-cells 0.1] [--seconds 120] [--only PART OF A NAME]

The cell is that of which the body's volume holds as many as asked for; the wall is a tenth of it. Columns: faces of the body and
how many of them are no plane or quadric, the greatest distance of an edge from its faces, then for each filling its outcome, CPU
seconds, faces and method. Each filling runs in a process of its own.

Outcomes: met; WRONG if the file read again is not valid, or its volume is not that of random points that the kernel's classifier
finds in the body and the published formula of the surface in the wall; "not met" and "refused" with the reason; "hang" after
three times the CPU seconds given, without the judgement.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepTools import BRepTools
from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Plane, GeomAbs_Sphere, GeomAbs_Torus
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_IN
from OCP.TopoDS import TopoDS_Shape
from scipy.spatial import cKDTree

import tpmscad
from benchmarks.trial_judges import MINIMAL_OFF, STANDARD_ERRORS, NodalFunction, signed_distance
from benchmarks.trial_statements import triangulate
from tpmscad.kernel.measure.edge_gaps import measure_accuracy
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import faces_of, solids_of
from tpmscad.kernel.step.step_reader import read_step

SUFFIXES = (".step", ".stp", ".brep")
QUADRICS = (GeomAbs_Plane, GeomAbs_Cylinder, GeomAbs_Cone, GeomAbs_Sphere, GeomAbs_Torus)

WALL_CELLS = 0.1
SAMPLES = 20000
"""Random points in the body's box."""

SURFACE_SAMPLES = 400_000
"""Points of the body's triangles, from which depths in the body are measured."""


def load_solids(path: Path) -> list[Any]:
    """The solids of a STEP or BREP file."""
    if path.suffix == ".brep":
        shape = TopoDS_Shape()
        BRepTools.Read_s(shape, str(path), BRep_Builder())
        return list(solids_of(shape))
    return list(read_step(path, with_clear_seams=True).solids)


def sample_fraction(body: Any, cell: float, skin: float | None, samples: int) -> tuple[float, float]:
    """Part of the body that the filling takes by random points, and its standard error; a wall and a skin by distances."""
    vertices, triangles = triangulate(body, 0.005 * cell)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    rng = np.random.default_rng(5)
    points = low + (high - low) * rng.random((samples, 3))
    classifier = BRepClass3d_SolidClassifier(body)

    def is_inside(p: np.ndarray) -> bool:
        classifier.Perform(gp_Pnt(*map(float, p)), 1e-7)
        return bool(classifier.State() == TopAbs_IN)

    points = points[[is_inside(p) for p in points]]
    f = NodalFunction(tpmscad.surfaces.find_surface("gyroid").formula, (cell,) * 3, (0, 0, 0))
    half = WALL_CELLS * cell / 2
    taken = np.abs(signed_distance(f, points, half, cell)) < half
    if skin is not None:
        corners = vertices[triangles]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        chosen = corners[rng.choice(len(corners), SURFACE_SAMPLES, p=area / area.sum())]
        u, v = rng.random((2, SURFACE_SAMPLES, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        surface = chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])
        taken |= cKDTree(surface).query(points)[0] < skin
    mean = float(taken.mean())
    return mean, float(np.sqrt(max(mean * (1 - mean), 1e-4) / len(points)))


def fill(path: Path, cells: float, skin_cells: float | None) -> dict[str, Any]:
    """Outcome, words, faces and method of one filling."""
    (body,) = load_solids(path)
    volume = check_shape(body).volume
    cell = (volume / cells) ** (1 / 3)
    skin = None if skin_cells is None else skin_cells * cell
    begun = time.process_time()
    try:
        model = tpmscad.infill(
            body if path.suffix == ".brep" else path,
            "gyroid",
            cell=cell,
            thickness=WALL_CELLS * cell,
            skin=skin,
            tol=0.005 * cell,
            progress=False,
        )
    except tpmscad.TpmscadError as error:
        return {"outcome": "refused", "words": str(error), "seconds": time.process_time() - begun}
    seconds = time.process_time() - begun
    resource.setrlimit(
        resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    )  # the judgement takes its time
    found = {"seconds": seconds, "faces": model.certificate.n_faces, "method": model.trimmed_by, "words": ""}
    if not model.certificate.met:
        return found | {"outcome": "not met", "words": "; ".join(model.certificate.shortfalls)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "filled.step"
        model.export_step(file)
        again = tpmscad.check_step(file)
        faults = [] if again.ok else ["the file read again is not valid"]
        fraction, error = sample_fraction(body, cell, skin, SAMPLES)
        allowed = STANDARD_ERRORS * error + 0.2 * MINIMAL_OFF["gyroid"] * 6
        taken = (again.shape.volume + sum(model.certificate.dropped)) / volume
        if abs(taken - fraction) > allowed:
            faults.append(f"it takes {taken:.4g} of the body, the sample says {fraction:.4g} +- {allowed:.2g}")
    return found | {"outcome": "WRONG" if faults else "met", "words": "; ".join(faults)}


def describe(path: Path) -> dict[str, Any] | None:
    """Faces, free-form faces and accuracy of a valid single solid, None for anything else."""
    solids = load_solids(path)
    if len(solids) != 1 or not BRepCheck_Analyzer(solids[0]).IsValid():
        return None
    faces = faces_of(solids[0])
    free = sum(BRepAdaptor_Surface(face).GetType() not in QUADRICS for face in faces)
    return {"faces": len(faces), "free": free, "gap": measure_accuracy(solids)}


def run_apart(path: Path, task: str, given: argparse.Namespace) -> dict[str, Any] | None:
    """The result of a task in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.real_files", str(path), "--task", task]
    command += ["--cells", str(given.cells), "--skin-cells", str(given.skin_cells)]
    limit = int(3 * given.seconds)
    command = ["bash", "-c", f'ulimit -S -t {limit}; exec "$@"', "limited", *command]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return {"outcome": "hang", "words": f"after {limit} s of CPU time", "seconds": float("nan")}
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        last = (done.stderr.strip().splitlines() or ["no words"])[-1]
        return {"outcome": "crash", "words": f"status {done.returncode}: {last}", "seconds": float("nan")}
    result: dict[str, Any] | None = json.loads(lines[-1])
    return result


def main(arguments: list[str] | None = None) -> None:
    """Print a line for each file and filling."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cells", type=float, default=30)
    parser.add_argument("--skin-cells", type=float, default=0.1)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--only", default="")
    parser.add_argument("--task", choices=("describe", "plain", "skin"), help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.task == "describe":
        print(json.dumps(describe(given.folder)))
        return
    if given.task:
        print(json.dumps(fill(given.folder, given.cells, given.skin_cells if given.task == "skin" else None)))
        return
    counts: dict[str, int] = {}
    for path in sorted(p for p in given.folder.iterdir() if p.suffix in SUFFIXES and given.only in p.name):
        what = run_apart(path, "describe", given)
        if what is None or "faces" not in what:
            print(f"{path.name:42s} {'no valid single solid' if what is None else what['words']}", flush=True)
            continue
        head = f"{path.name:42s} {what['faces']:4d} {what['free']:4d} {what['gap']:8.1e}"
        for task in ("plain", "skin"):
            found = run_apart(path, task, given)
            assert found is not None
            counts[found["outcome"]] = counts.get(found["outcome"], 0) + 1
            print(
                f"{head} {task:5s} {found['outcome']:8s} {found.get('seconds', 0):7.1f} {found.get('faces', 0):6d} "
                f"{found.get('method', '') or ''} {found['words'][:200]}",
                flush=True,
            )
    print(counts)


if __name__ == "__main__":
    main()
