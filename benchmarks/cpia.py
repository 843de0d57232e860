"""CPIA and its relatives, iteration by iteration, and the update that TPMS2STEP prints (eqs. 14-18), which diverges.

    python -m benchmarks.cpia [gyroid|diamond|schwarz_p]

The printed update adds to PIA's differences Q - B P, for each side i with its half-turn T_i,

    1/2 (b_i P T_i - b_i P) + 1/2 (a_i P T_i - a_i P),      b = M_2 - M_1,   a = 3 M_4 - 2 M_3 - M_5,

where M picks the first, second and third row of poles from a side. The paper leaves to its supplement which row the correction
is added to; all nine placements are tried, each with the printed sign of the first-order relation (b P T = b P) and with the
one a half-turn needs (b P T = -b P), the copy's row run backwards or not. Each is an affine iteration: it converges for
every start if and only if the spectral radius is below 1.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import islice, product

import numpy as np

from benchmarks.progressive_iteration import (
    cpia_convergence_rate,
    iterate_lspia,
    iterate_pia,
    pia_convergence_rate,
)
from tpmscad import surfaces
from tpmscad.splines import (
    BSplineSurface,
    Joint,
    bezier_knots,
    design_matrix,
    fit_surface,
    gauss_axis,
    joint_conditions,
    pole_axis,
    sampled_axis,
    solve_conditions,
    trapezoidal_grid,
    uniform_knots,
)
from tpmscad.splines.cpia import iterate_cpia
from tpmscad.splines.knots import greville_abscissae
from tpmscad.splines.surface_fit import gram_eigenvalue_bounds
from tpmscad.splines.surface_fit import surface_from_coordinates as surface_of

SIZE = 11
"""Poles along each parameter, the same 121 for every method."""

OFFSET = 0.5
"""The offset surface that is fitted, as a share of the greatest offset."""

SHOWN = (0, 1, 2, 5, 10, 20, 50, 100, 200)


def side_rows(side: int, row: int) -> list[tuple[int, int]]:
    """Indices of the poles in the given row from a side, counter-clockwise along it."""
    last = SIZE - 1
    along = range(SIZE)
    return [
        [(i, row) for i in along],
        [(last - row, i) for i in along],
        [(last - i, last - row) for i in along],
        [(row, last - i) for i in along],
    ][side]


def printed_iteration(
    basis: np.ndarray, rotations: np.ndarray, first_row: int, second_row: int, sign: int, backwards: bool
) -> np.ndarray:
    """The matrix of eq. 18 on the 3 n^2 coordinates of the poles: P <- this P + Q.

    first_row and second_row are the rows that the first- and second-order corrections are added to; sign +1 is the printed
    relation, -1 the one of a half-turn; `backwards` whether the copy's row runs the other way, as a half-turn's does.
    """
    matrix = np.eye(3 * SIZE**2) - np.kron(np.kron(basis, basis), np.eye(3))
    blocks = matrix.reshape(SIZE, SIZE, 3, SIZE, SIZE, 3)
    for side, rotation in enumerate(rotations):
        first = {0: -1.0, 1: 1.0}
        second = {0: -2.0, 1: 3.0, 2: -1.0}
        for coefficients, target, relation in ((first, first_row, sign), (second, second_row, 1)):
            for row, coefficient in coefficients.items():
                places, here, copy = side_rows(side, target), side_rows(side, row), side_rows(side, row)
                copy = copy[::-1] if backwards else copy
                for place, own, other in zip(places, here, copy, strict=True):
                    weight = 0.5 * coefficient
                    blocks[place][:, own[0], own[1]] -= weight * np.eye(3)
                    blocks[place][:, other[0], other[1]] += weight * relation * rotation
    return matrix


def spectral_radius(matrix: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def run(name: str = "gyroid") -> tuple[list[float], dict[str, list[float]]]:
    """The spectral radii of eq. 18, and the greatest distance from the exact surface at equal parameters (cells) after each
    number of SHOWN iterations, by method; all printed."""
    patch, symmetry = surfaces.primitive_patch(name), surfaces.patch_symmetry(name)
    offset = OFFSET * patch.max_offset
    joints = [Joint(s, symmetry.edge_motions.rotation[s], symmetry.edge_motions.translation[s], s) for s in range(4)]

    def exact(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return patch.jet(*np.meshgrid(u, v, indexing="ij"), offset).position

    dense = np.linspace(0, 1, 41)
    truth = exact(dense, dense)

    def errors(steps: Iterator[BSplineSurface]) -> list[float]:
        wanted = {k: float(np.linalg.norm(s.grid(dense, dense) - truth, axis=-1).max()) for k, s in _at(steps, SHOWN)}
        return [wanted[k] for k in SHOWN]

    cubic, tenth = uniform_knots(SIZE - 3, 3), bezier_knots(SIZE - 1)
    table: dict[str, list[float]] = {}
    print(
        f"{name}, offset {offset:.4f} cells, {SIZE}^2 poles (cubic B-splines; G2: degree {SIZE - 1}); distances in cells\n"
    )

    u = np.linspace(0, 1, SIZE)
    basis = design_matrix(cubic, 3, u)
    readings = list(product((1, -1), (True, False), range(3), range(3)))
    matrices = {
        (sign, backwards, a, b): printed_iteration(basis, symmetry.edge_motions.rotation, a, b, sign, backwards)
        for sign, backwards, a, b in readings
    }
    radii = {reading: spectral_radius(matrix) for reading, matrix in matrices.items()}
    print("eq. 18 as printed: spectral radius by the rows that the first- and second-order corrections go to")
    print(f"{'first-order sign, copy':26s}" + "".join(f"   ({a}, {b})" for a, b in product(range(3), range(3))))
    for sign, backwards in product((1, -1), (True, False)):
        label = ("printed (+)" if sign > 0 else "half-turn's (-)") + (", backwards" if backwards else ", as it is")
        print(f"{label:26s}" + "".join(f"{radii[sign, backwards, a, b]:9.3f}" for a, b in product(range(3), range(3))))
    print(f"PIA alone (no correction): {pia_convergence_rate(basis, basis):.3f}\n")

    best = min(radii, key=lambda key: radii[key])
    matrix = matrices[best]

    def printed() -> Iterator[BSplineSurface]:
        poles = target = exact(u, u)
        while True:
            yield BSplineSurface(poles, cubic, cubic, 3, 3)
            poles = (matrix @ poles.ravel()).reshape(poles.shape) + target

    table["eq. 18 as printed, best reading"] = errors(printed())
    table["PIA, cubic"] = errors(BSplineSurface(p, cubic, cubic, 3, 3) for p in iterate_pia(exact(u, u), basis, basis))
    t = np.linspace(0, 1, 3 * SIZE)
    more = design_matrix(cubic, 3, t)
    table["LSPIA, cubic"] = errors(
        BSplineSurface(p, cubic, cubic, 3, 3) for p in iterate_lspia(exact(t, t), more, more, exact(u, u))
    )

    cosine = (1 - np.cos(np.pi * np.linspace(0, 1, 3 * SIZE))) / 2
    start = greville_abscissae(tenth, SIZE - 1)
    first = BSplineSurface(exact(start, start), tenth, tenth, SIZE - 1, SIZE - 1)
    rates = {
        "eq. 18 as printed, best reading": radii[best],
        "PIA, cubic": pia_convergence_rate(basis, basis),
        "LSPIA, cubic": _descent_rate(*gram_eigenvalue_bounds(more, more)),
    }
    on_poles, orthonormal = pole_axis(tenth, SIZE - 1), gauss_axis(tenth, SIZE - 1)
    for label, axis, points, chebyshev in (
        ("CPIA on the poles, G2", on_poles, t, False),
        ("CPIA, G2", orthonormal, t, False),
        ("CPIA, G2, Chebyshev", orthonormal, t, True),
        ("CPIA, G2, Chebyshev, cosine grid", orthonormal, cosine, True),
    ):
        grid = trapezoidal_grid(points, points)
        subspace = solve_conditions(joint_conditions(joints, axis, axis, valence=6))
        steps = iterate_cpia(exact(points, points), grid, axis, axis, subspace, chebyshev=chebyshev, start=first)
        table[label] = errors(surface_of(x, axis, axis) for x, _ in steps)
        rates[label] = cpia_convergence_rate(grid, axis, axis, chebyshev=chebyshev)
    own = sampled_axis(tenth, SIZE - 1, cosine, trapezoidal_grid(cosine, cosine).weights_u)
    direct = fit_surface(
        exact(cosine, cosine), own, own, solve_conditions(joint_conditions(joints, own, own, valence=6))
    )
    limit = float(np.linalg.norm(direct.grid(dense, dense) - truth, axis=-1).max())

    print(f"{'greatest distance after k steps, k =':36s}" + "".join(f"{k:9d}" for k in SHOWN) + "   rate per step")
    for label, row in table.items():
        print(f"{label:36s}" + "".join(f"{value:9.1e}" for value in row) + f"   {_readable(rates[label])}")
    print(f"{'direct solution, G2':36s}{limit:9.1e}")
    return list(radii.values()), table


def _descent_rate(low: float, high: float) -> float:
    return (high - low) / (high + low)


def _readable(rate: float) -> str:
    return f"{rate:.3f}" if rate < 0.9995 or rate > 1 else f"1 - {1 - rate:.1e}"


def _at(steps: Iterator[BSplineSurface], wanted: tuple[int, ...]) -> Iterator[tuple[int, BSplineSurface]]:
    return ((k, step) for k, step in enumerate(islice(steps, wanted[-1] + 1)) if k in wanted)


if __name__ == "__main__":
    start = time.process_time()
    run(*sys.argv[1:2])
    print(f"\n{time.process_time() - start:.1f} CPU seconds")
