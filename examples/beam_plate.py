"""Topology optimisation with two lattices: a cantilever of Schwarz P and I-WP, which of them where, and how dense.

The optimisation of figure 14 of the porous-blending paper. The stiffness of both lattices as a function of the volume fraction
comes from `tpmscad.homogenize` and is kept in unit_stiffness.csv; without that file it is computed. Plane stress, quadratic
quadrilaterals (scikit-fem), method of moving asymptotes (NLopt). The volume fraction and the share of the second lattice vary
over the plate, both filtered; intermediate shares are penalised, so that each place gets one lattice.

    pip install "tpmscad[simulation]" matplotlib nlopt
    python examples/beam_plate.py
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import nlopt
import numpy as np
import skfem
from scipy import ndimage, sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import splu

import tpmscad

TABLE = Path(__file__).with_name("unit_stiffness.csv")
CELL = 10.0
UNITS = {"schwarz_p": "-", "iwp": "+"}
"""Skeletal lattices by the side of the surface that is solid: struts along the axes of P, along the diagonals of I-WP."""

FRACTIONS = (0.3, 0.5, 0.7)
"""Volume fractions in the table of stiffness."""

PENALTIES = (1.0, 2.0, 3.0)
"""Exponents of the shares, one after the other."""

LEAST, GREATEST, MEAN = 0.3, 0.7, 0.5
"""Volume fractions: bounds and mean."""


@dataclass(frozen=True, slots=True)
class Design:
    """Volume fraction and share of the second lattice (nx, ny) in elements of edge `size`, and the compliance."""

    density: np.ndarray
    share: np.ndarray
    size: float
    compliance: float
    history: tuple[float, ...]


def homogenise_unit(name: str, volume_fraction: float, size: float = 0.15) -> tuple[float, float, float, float]:
    """C11, C12 and C44 of a cell over Young's modulus of its solid (Poisson's ratio 0.3), and their relative error."""
    cell = tpmscad.lattice(
        name,
        cell=1.0,
        volume_fraction=volume_fraction,
        kind="skeletal",
        side=UNITS[name],
        reference="nodal",
        tol=0.02,
        progress=False,
    )
    found = tpmscad.homogenize(cell, elements="tetrahedra", size=size, progress=False)
    return found.stiffness[0, 0], found.stiffness[0, 1], found.stiffness[3, 3], found.error


def read_units(path: Path = TABLE) -> np.ndarray:
    """Rows (fraction, C11, C12, C44) of each unit, (2, n, 4), from the table, which is made if it is missing."""
    if not path.exists():
        rows = [
            (name, side, fraction, *(f"{value:.5f}" for value in homogenise_unit(name, fraction)))
            for name, side in UNITS.items()
            for fraction in FRACTIONS
        ]
        with path.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("surface", "side", "volume_fraction", "C11", "C12", "C44", "error"))
            table.writerows(rows)
    with path.open(newline="") as file:
        table = list(csv.DictReader(file))
    columns = ("volume_fraction", "C11", "C12", "C44")
    return np.array([[[float(r[c]) for c in columns] for r in table if r["surface"] == name] for name in UNITS])


def plane_stress(stiffness: np.ndarray) -> np.ndarray:
    """C11, C12, C44 (..., 3) of cubic cells, made those of a plate that is free in its thickness."""
    c11, c12, c44 = np.moveaxis(np.asarray(stiffness, float), -1, 0)
    return np.stack([c11 - c12**2 / c11, c12 - c12**2 / c11, c44], axis=-1)


def fit_stiffness(table: np.ndarray) -> list[CubicSpline]:
    """Plane-stress constants as splines of the volume fraction; rows of a lattice: fraction, C11, C12, C44."""
    return [CubicSpline(rows[:, 0], plane_stress(rows[:, 1:])) for rows in table]


class Plate:
    """A cantilever of `elements` (nx, ny): clamped at the left, a shear traction of total 1 on the right edge, downwards."""

    def __init__(self, length: float, height: float, size: float) -> None:
        nx, ny = round(length / size), round(height / size)
        self.shape, self.size = (nx, ny), size
        mesh = skfem.MeshQuad.init_tensor(np.linspace(0, length, nx + 1), np.linspace(0, height, ny + 1))
        element = skfem.ElementVector(skfem.ElementQuad2())
        self.basis = skfem.Basis(mesh, element)
        centers = mesh.p[:, mesh.t].mean(axis=1)
        i, j = np.floor(centers / size).astype(int)
        self.order = i * ny + j  # of each element of the mesh in an array (nx, ny)
        right = skfem.FacetBasis(mesh, element, facets=mesh.facets_satisfying(lambda x: np.isclose(x[0], length)))
        self.load = skfem.LinearForm(lambda v, w: -v[1] / height).assemble(right)
        clamped = self.basis.get_dofs(lambda x: np.isclose(x[0], 0.0))
        self.free = np.setdiff1d(np.arange(self.basis.N), clamped.all())

    def solve(self, constants: np.ndarray) -> tuple[float, np.ndarray]:
        """Compliance for constants (nx, ny, 3), and its derivatives (nx, ny, 3)."""
        c = constants.reshape(-1, 3)[self.order]

        def energy(u, v, w):
            (exx, exy), (eyx, eyy) = u.grad
            (fxx, fxy), (fyx, fyy) = v.grad
            normal = w.c11 * (exx * fxx + eyy * fyy) + w.c12 * (exx * fyy + eyy * fxx)
            return normal + w.c44 * (exy + eyx) * (fxy + fyx)

        points = self.basis.dx.shape[1]
        named = {n: np.repeat(c[:, [k]], points, axis=1) for k, n in enumerate(("c11", "c12", "c44"))}
        matrix = skfem.BilinearForm(energy).assemble(self.basis, **named)[self.free][:, self.free]
        u = np.zeros(self.basis.N)
        u[self.free] = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
            self.load[self.free]
        )
        (exx, exy), (eyx, eyy) = self.basis.interpolate(u).grad
        parts = [exx**2 + eyy**2, 2 * exx * eyy, (exy + eyx) ** 2]
        slopes = np.empty((c.shape[0], 3))
        slopes[self.order] = -np.stack([(part * self.basis.dx).sum(axis=1) for part in parts], axis=1)
        return float(self.load @ u), slopes.reshape(*self.shape, 3)


def cone_filter(shape: tuple[int, int], radius: float) -> sparse.csr_array:
    """Averages over a disc of a radius in elements with weights that fall linearly to its edge."""
    reach = int(np.ceil(radius))
    offsets = [(a, b) for a in range(-reach, reach + 1) for b in range(-reach, reach + 1) if np.hypot(a, b) < radius]
    i, j = np.indices(shape)
    rows, columns, weights = [], [], []
    for a, b in offsets:
        inside = (i + a >= 0) & (i + a < shape[0]) & (j + b >= 0) & (j + b < shape[1])
        rows.append((i * shape[1] + j)[inside])
        columns.append(((i + a) * shape[1] + j + b)[inside])
        weights.append(np.full(rows[-1].size, radius - np.hypot(a, b)))
    n = shape[0] * shape[1]
    matrix = sparse.csr_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (n, n))
    return sparse.diags_array(1 / matrix.sum(axis=1)) @ matrix


def evaluate(
    plate: Plate, splines: list[CubicSpline], density: np.ndarray, share: np.ndarray, penalty: float = 1.0
) -> tuple[float, np.ndarray, np.ndarray]:
    """Compliance, and its derivatives with respect to the volume fraction and the share."""
    first, second = (1 - share) ** penalty, share**penalty
    a, b = (spline(density) for spline in splines)
    slope_a, slope_b = (spline(density, 1) for spline in splines)
    compliance, slopes = plate.solve(first[..., None] * a + second[..., None] * b)
    by_density = (slopes * (first[..., None] * slope_a + second[..., None] * slope_b)).sum(axis=-1)
    by_share = penalty * (
        (slopes * b).sum(axis=-1) * share ** (penalty - 1) - (slopes * a).sum(axis=-1) * (1 - share) ** (penalty - 1)
    )
    return compliance, by_density, by_share


def optimise(
    plate: Plate, splines: list[CubicSpline], radius: float, iterations: int, kinds: tuple[bool, bool] = (True, True)
) -> Design:
    """The stiffest design with the mean volume fraction, of the lattices chosen by `kinds`; `radius` of the filter in mm."""
    n = plate.shape[0] * plate.shape[1]
    smooth = cone_filter(plate.shape, radius / plate.size)
    history: list[float] = []
    both = all(kinds)
    x = np.concatenate([np.full(n, MEAN), np.full(n, 0.5 if both else float(kinds[1]))])
    low = np.concatenate([np.full(n, LEAST), np.full(n, 0.0 if both else x[-1])])
    high = np.concatenate([np.full(n, GREATEST), np.full(n, 1.0 if both else x[-1])])
    scale = evaluate(plate, splines, *x.reshape(2, *plate.shape))[0]

    def objective(x: np.ndarray, slope: np.ndarray, penalty: float) -> float:
        density, share = (smooth @ part for part in x.reshape(2, n))
        value, *slopes = evaluate(plate, splines, density.reshape(plate.shape), share.reshape(plate.shape), penalty)
        history.append(value)
        if slope.size:
            slope[:] = np.concatenate([smooth.T @ part.ravel() for part in slopes]) / scale
        return value / scale

    weight = np.concatenate([np.asarray(smooth.T @ np.full(n, 1 / n)), np.zeros(n)])

    def volume(x: np.ndarray, slope: np.ndarray) -> float:
        if slope.size:
            slope[:] = weight
        return float(weight @ x) - MEAN

    for penalty in PENALTIES if both else PENALTIES[:1]:
        solver = nlopt.opt(nlopt.LD_MMA, 2 * n)
        solver.set_lower_bounds(low)
        solver.set_upper_bounds(high)
        solver.set_min_objective(lambda x, slope, p=penalty: objective(x, slope, p))
        solver.add_inequality_constraint(volume, 1e-6)
        solver.set_maxeval(iterations)
        solver.set_ftol_rel(1e-5)
        x = solver.optimize(np.clip(x, low, high))
    density, share = (np.asarray(smooth @ part).reshape(plate.shape) for part in x.reshape(2, n))
    if both:
        share = remove_islands(share, radius / plate.size)
    return Design(density, share, plate.size, evaluate(plate, splines, density, np.round(share))[0], tuple(history))


def remove_islands(share: np.ndarray, radius: float) -> np.ndarray:
    """The share with parts of a lattice that are smaller than a disc of so many elements given to the other lattice."""
    share = share.copy()
    for second in (False, True):
        part = (share > 0.5) == second
        labels, count = ndimage.label(part)
        for k in range(1, count + 1):
            if (labels == k).sum() < np.pi * radius**2:
                share[labels == k] = 1 - share[labels == k]
    return share


def main(
    path: str | Path = "beam_plate.png",
    cells: tuple[int, int] = (8, 4),
    sizes: tuple[float, ...] = (5.0, 2.5),
    iterations: int = 8,
) -> dict[str, dict[str, float]]:
    """Optimise on elements of several sizes, mm, and draw the last design; return compliances, of uniform plates among them.

    `refinement` has the compliance of the optimum for each size, `designs` those of other designs on the largest elements.
    """
    length, height = (CELL * n for n in cells)
    splines = fit_stiffness(read_units())
    plates = [Plate(length, height, size) for size in sizes]
    optima = [optimise(plate, splines, CELL, iterations) for plate in plates]
    flat = np.full(plates[0].shape, MEAN)
    choose = partial(optimise, plates[0], splines, CELL, iterations)
    designs = {
        "Schwarz P, uniform": evaluate(plates[0], splines, flat, 0 * flat)[0],
        "I-WP, uniform": evaluate(plates[0], splines, flat, 0 * flat + 1)[0],
        "Schwarz P, graded": choose((True, False)).compliance,
        "I-WP, graded": choose((False, True)).compliance,
        "both, each place one of them": optima[0].compliance,
    }
    picture(optima[-1], (length, height), Path(path))
    return {"refinement": {f"{d.size:g} mm": d.compliance for d in optima}, "designs": designs}


def picture(design: Design, size: tuple[float, float], path: Path) -> None:
    """Draw the volume fraction and the lattice at every place."""
    import matplotlib.pyplot as plt

    extent = (0, size[0], 0, size[1])
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.2), layout="constrained")
    density = axes[0].imshow(design.density.T, origin="lower", extent=extent, cmap="viridis")
    figure.colorbar(density, ax=axes[0], label="volume fraction")
    kinds = axes[1].imshow(design.share.T, origin="lower", extent=extent, cmap="coolwarm", vmin=0, vmax=1)
    figure.colorbar(kinds, ax=axes[1], label="share of I-WP (0: Schwarz P)")
    for panel in axes:
        panel.set(xlabel="x, mm", ylabel="y, mm")
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
