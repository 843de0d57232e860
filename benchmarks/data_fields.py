"""Solids of data: a topology-optimised density, scattered points, formulas, an image stack like a CT scan of bone.

    python -m benchmarks.data_fields [density] [points] [formulas] [scan] [--samples 64]

Columns: whether the solid meets the request, faces, deviation from the field (which interpolates the data), Betti numbers,
volume beside a count of random points with negative value, CPU seconds of the field and of the solid, and MB of the STEP file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import cg

import tpmscad
from tpmscad import fields
from tpmscad._typing import BoxCorners

Array = NDArray[np.float64]
Row = tuple[str, fields.Field, BoxCorners, float, float]
"""Name, field, domain, tolerance, CPU seconds to make the field."""

COUNTED_POINTS = 400_000


def optimise_density(n: int, steps: int = 12, fraction: float = 0.25) -> Array:
    """Density (n, n, n) of the conductor that cools a heated cube through the middle of its floor, after some steps of SIMP.

    Conductivity 1e-3 + (1 - 1e-3) density^3 between the centres of voxels (harmonic means), one unit of heat in each voxel, zero
    temperature at the sink; optimality criteria with a density filter of 1.5 voxels (Gersborg-Hansen, Bendsoe and Sigmund,
    Struct. Multidisc. Optim. 31 (2006) 251, state the problem).
    """
    density = np.full((n, n, n), fraction)
    sink = np.zeros((n, n, n))
    sink[n * 3 // 8 : n * 5 // 8, n * 3 // 8 : n * 5 // 8, 0] = 1.0
    index = np.arange(n**3).reshape(n, n, n)
    temperature = np.zeros(n**3)
    for _ in range(steps):
        smooth = gaussian_filter(density, 1.0, mode="nearest")
        conductivity = 1e-3 + (1 - 1e-3) * smooth**3
        rows, columns, entries = [], [], []
        diagonal = 10.0 * sink.ravel()
        for axis in range(3):
            low, high = (np.take(index, range(*part), axis).ravel() for part in ((0, n - 1), (1, n)))
            a, b = conductivity.ravel()[low], conductivity.ravel()[high]
            link = 2 * a * b / (a + b)
            rows += [low, high]
            columns += [high, low]
            entries += [-link, -link]
            np.add.at(diagonal, low, link)
            np.add.at(diagonal, high, link)
        matrix = csr_array(
            (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=(n**3, n**3)
        ) + diags_array(diagonal)
        temperature, _ = cg(matrix, np.ones(n**3), temperature, rtol=1e-3, M=diags_array(1 / diagonal))
        slope = sum(np.gradient(temperature.reshape(n, n, n), axis=axis) ** 2 for axis in range(3))
        gain = gaussian_filter(3 * smooth**2 * slope, 1.0, mode="nearest")
        low_price, high_price = 1e-12 * gain.max(), gain.max() * 1e3
        while high_price / low_price > 1 + 1e-4:
            price = np.sqrt(low_price * high_price)
            update = np.clip(
                density * np.sqrt(gain / price), np.maximum(density - 0.2, 0), np.minimum(density + 0.2, 1)
            )
            low_price, high_price = (price, high_price) if update.mean() > fraction else (low_price, price)
        density = update
    return np.asarray(gaussian_filter(density, 1.0, mode="nearest"))


def scan_bone(n: int) -> Array:
    """Grey values (n, n, n) like a scan of trabecular bone: a random medium, blurred, with the detector's noise, filtered."""
    rng = np.random.default_rng(20)
    medium = gaussian_filter(rng.normal(size=(n, n, n)), 5.0, mode="wrap")
    grey = 1000 / (1 + np.exp(-12 * (0.45 - np.abs(medium / medium.std()))))
    return np.asarray(gaussian_filter(grey + rng.normal(scale=60, size=grey.shape), 1.2))


def density_row(n: int, folder: Path) -> Iterator[Row]:
    """The optimised density through a `.npy` file."""
    np.save(folder / "density.npy", optimise_density(n))
    started = time.process_time()
    field = fields.sampled(folder / "density.npy", spacing=1.0, level=0.5)
    yield f"optimised density {n}^3", field, field.domain, 0.1, time.process_time() - started


def points_row(n: int, folder: Path) -> Iterator[Row]:
    """2000 values at random points of a sheet of cells of 24 mm, through a CSV file."""
    rng = np.random.default_rng(7)
    points = rng.uniform(0, 40, (2000, 3))
    gyroid = fields.tpms("gyroid", 24.0)
    np.savetxt(folder / "points.csv", np.column_stack([points, gyroid(points) - 0.2]), delimiter=",")
    table = np.loadtxt(folder / "points.csv", delimiter=",")
    started = time.process_time()
    field = fields.scattered(table[:, :3], table[:, 3])
    yield "2000 points", field, ((1, 1, 1), (39, 39, 39)), 0.1, time.process_time() - started


def formula_rows(n: int, folder: Path) -> Iterator[Row]:
    """A surface of the catalogue graded along z, a wavy pipe, and a mixture of two surfaces."""
    box = ((0, 0, 0), (10, 10, 10))
    yield (
        "graded gyroid",
        fields.expression("abs(sin(x)*cos(y) + sin(y)*cos(z) + sin(z)*cos(x)) - 0.2 - 0.03*Z", 10.0),
        box,
        0.01,
        0.0,
    )
    wavy = "abs(hypot(x - 5 - sin(z), y - 5) - 3 - 0.5*cos(2*z)) - 0.4"
    yield "wavy pipe", fields.expression(wavy), box, 0.01, 0.0
    mixture = fields.expression(
        "g + (p - g) / (1 + exp(5 - X)) + 0.3", g=fields.tpms("gyroid", 5.0), p=fields.tpms("schwarz_p", 5.0)
    )
    yield "gyroid into P", mixture, box, 0.01, 0.0


def scan_row(n: int, folder: Path) -> Iterator[Row]:
    """The scan through a NRRD file of anisotropic voxels."""
    import nrrd

    grey = scan_bone(n)
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag([0.06, 0.06, 0.08]),
        "space origin": [3, 4, 5],
    }
    nrrd.write(str(folder / "scan.nrrd"), grey.astype(np.float32), header)
    started = time.process_time()
    field = fields.sampled(folder / "scan.nrrd", level=500.0)
    yield f"bone scan {n}^3", field, field.domain, 0.006, time.process_time() - started


ROWS = {"density": density_row, "points": points_row, "formulas": formula_rows, "scan": scan_row}


def print_row(row: Row, folder: Path) -> None:
    """Make the solid of a row and print what it is."""
    name, field, domain, tol, seconds = row
    started = time.process_time()
    try:
        model = tpmscad.solidify(field, domain, tol=tol)
    except tpmscad.TpmscadError as error:
        print(f"{name:22} refused after {time.process_time() - started:.1f} s: {error}", flush=True)
        return
    spent = time.process_time() - started
    model.export_step(folder / "solid.step")
    low, high = np.array(domain, float)
    points = np.random.default_rng(0).uniform(low, high, (COUNTED_POINTS, 3))
    counted = float((field(points) < 0).mean() * np.prod(high - low))
    c = model.certificate
    print(
        f"{name:22} {'met' if c.met else 'NOT MET':8} {c.n_faces:6} {c.max_deviation:9.2e} of {tol:<6g} {c.betti!s:16} "
        f"{c.volume:10.5g} {counted:10.5g} {seconds:7.1f} {spent:7.1f} {(folder / 'solid.step').stat().st_size / 1e6:7.1f}",
        flush=True,
    )
    for reason in () if c.met else c.shortfalls:
        print(f"    {reason}")


def main() -> None:
    """Print the table of the rows asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"one of {', '.join(ROWS)}; by default all")
    parser.add_argument("--samples", type=int, default=64, help="samples along each axis of density and scan")
    arguments = parser.parse_args()
    if unknown := set(arguments.rows) - set(ROWS):
        parser.error(f"{', '.join(sorted(unknown))}: the rows are {', '.join(ROWS)}")
    titles = f"{'solid':22} {'':8} {'faces':>6} {'deviation':>19} {'Betti':16} {'volume':>10} {'counted':>10}"
    print(titles, f"{'field s':>7} {'solid s':>7} {'MB':>7}")
    with TemporaryDirectory() as folder:
        for name in arguments.rows or ROWS:
            for row in ROWS[name](arguments.samples, Path(folder)):
                print_row(row, Path(folder))


if __name__ == "__main__":
    main()
