"""Cores of sandwich panels: in a box, a wing section and parts of files, with a skin and without; large panels; stiffness.

    python -m benchmarks.cores [bodies] [PART.step ...]
    python -m benchmarks.cores panel [CELLS]
    python -m benchmarks.cores stiffness

Volumes are judged by points in the body's box, in standard errors: whether a point lies in the body, asked of the kernel's
classifier, deeper than the skin, and in the walls. Panels are compared with their closed form. In-plane moduli of honeycombs are
those of Gibson and Ashby, Cellular Solids, 2nd ed. (1997), eqs. 4.10 and 4.12: of thin beams, and with shear and axial strain.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of

KINDS = ("honeycomb", "square", "triangular", "re-entrant")
POINTS = 20_000
PANEL = 6.0, 0.4, 12.0, 0.8
"""Cell, thickness of walls, height and skin of a panel, mm."""
LAYER = 0.1


def main() -> None:
    job, *rest = sys.argv[1:] or ["bodies"]
    if job == "panel":
        run_panel(int(rest[0]) if rest else 5000)
    elif job == "stiffness":
        run_stiffness()
    else:
        run_bodies([path for path in (*sys.argv[1:],) if path != "bodies"])


def run_bodies(paths: list[str]) -> None:
    bodies: dict[str, tuple[Any, float, float, float]] = {
        "box": (bd.Box(31, 25, 11), 6.0, 0.4, 0.8),
        "wing": (make_wing(), 12.0, 0.8, 0.8),
    }
    for path in paths:
        size = float(np.min(np.subtract(*enclosing_box(read_body(path).shape)[::-1])))
        bodies[Path(path).stem] = (path, size / 3, size / 40, size / 40)
    print(f"{'body':24} {'core':11} skin    s     met    volume        z     Betti        faces")
    for name, (body, cell, thickness, skin) in bodies.items():
        cad, rng = read_body(body), np.random.default_rng(1)
        low, high = enclosing_box(cad.shape)
        points = rng.uniform(low, high, (POINTS, 3))
        points = points[contains_points(cad.shape, points)]
        depths = SkinDepth(cad.shape, faces_of(cad.shape)).distances(points)
        for kind in KINDS:
            core = fields.core(kind, cell, thickness, "z" if name == "box" else "y")
            for deep in (None, skin):
                filled = (core(points) < 0) | (depths < (deep or 0))
                share, box = float(filled.sum()) / POINTS, float(np.prod(high - low))
                expected = box * share, box * float(np.sqrt(share * (1 - share) / POINTS))
                run_body(f"{name:24} {kind:11} {deep or 0:4.2f}", body, core, deep, *expected)


def run_body(label: str, body: Any, core: CoreField, skin: float | None, expected: float, error: float) -> None:
    began = time.process_time()
    try:
        model = tpmscad.infill(body, core, tol=0.05, skin=skin, loose="keep", progress=False)
    except tpmscad.TpmscadError as failure:
        print(f"{label} {time.process_time() - began:6.1f} refused: {failure}", flush=True)
        return
    seconds, certificate = time.process_time() - began, model.certificate
    print(
        f"{label} {seconds:6.1f} {certificate.met!s:5} {model.volume:12.3f} {(model.volume - expected) / error:+6.1f}     "
        f"{certificate.betti!s:12} {certificate.n_faces}",
        flush=True,
    )


def make_wing() -> Any:
    """Extruded section with the thickness of an aerofoil, its chord 120 and its span 30, along z; blunt at the trailing edge."""
    x = 0.5 * (1 - np.cos(np.linspace(0, np.pi, 13)))
    half = 84 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    upper = np.column_stack([120 * x, np.append(half[:-1], 0.35)])
    outline = np.concatenate([upper[::-1] * (1, -1), upper[1:]]).tolist()
    edges = [bd.Edge.make_spline([bd.Vector(*p) for p in outline]), bd.Edge.make_line(outline[-1], outline[0])]
    return bd.extrude(bd.make_face(edges), 30)


def run_panel(cells: int) -> None:
    """A square panel of hexagons within a skin, as a STEP file by references, and as layers."""
    cell, thickness, height, skin = PANEL
    side = float(np.sqrt(cells * cell**2 * np.sqrt(3) / 2))
    panel = bd.Box(side, side, height)
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        file = tpmscad.export_infill(
            panel,
            "honeycomb",
            Path(folder) / "panel.step",
            cell=cell,
            thickness=thickness,
            skin=skin,
            progress=False,
        )
        print(f"{file.summary()}\nSTEP by references: {time.process_time() - began:.1f} s")
        began = time.process_time()
        layers = tpmscad.infill_layers(
            panel, "honeycomb", height=LAYER, cell=cell, thickness=thickness, skin=skin, progress=False
        )
        layers.write(Path(folder) / "panel.cli")
        print(f"{layers}\nlayers: {time.process_time() - began:.1f} s")
        # walls are planes and skins end between layers: areas tell the volume exactly
        core_area = layers[len(layers) // 2].area
        expected = core_area * (height - 2 * skin) + side**2 * 2 * skin
        print(f"volume of the file over that by a layer's area, less 1: {file.volume / expected - 1:.1e}")


def run_stiffness() -> None:
    """Young's moduli of honeycombs beside closed forms, in units of that of the solid; in plane of thin walls and thick ones."""
    print("t/c    axial       1-(1-t)^2   in plane    thin beams  with shear and axial strain")
    for t in (0.05, 0.1, 0.2):
        found = tpmscad.homogenize(fields.core("honeycomb", 1.0, t), progress=False).compliance
        moduli = 1 / np.diag(found)[:3]
        slender = t * np.sqrt(3)  # thickness over the length of a wall, c / sqrt(3)
        thin = 4 / np.sqrt(3) * slender**3
        thick = thin / (1 + (5.4 + 1.5 * 0.3) * slender**2)
        print(f"{t:4.2f}   {moduli[2]:.8f}  {1 - (1 - t) ** 2:.8f}  {moduli[0]:.7f}   {thin:.7f}   {thick:.7f}")


if __name__ == "__main__":
    main()
