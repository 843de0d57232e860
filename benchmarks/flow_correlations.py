"""Correlations of flow beside the points of their sources, and beside what printed exchangers were measured to lose.

    python -m benchmarks.flow_correlations [--picture FILE.png]

Points carried over: table 2 of Gajetti et al. (2025) in two digits; the table df_cfd_coeffs_dev.csv of the repository
alexlu997/SJTU-TPMSHX (2026), K in m2 and c in 1/m of viscosity u / K + density c u^2 in 40 geometries; the inertial coefficients
of two printed exchangers there, of cells of 7 mm with walls of 0.6 mm, by fluid.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tpmscad import surfaces
from tpmscad.simulation.flow_correlations import (
    GAJETTI_DIAMOND,
    GAJETTI_GYROID,
    SJTU_DIAMOND,
    SJTU_GYROID,
    YAN_GYROID,
    ChannelFlow,
)

GAJETTI = {
    "gyroid": (GAJETTI_GYROID, ((0.3, 5.6e-4, 0.81), (0.4, 1.2e-3, 0.53), (0.5, 2.2e-3, 0.31), (0.6, 3.9e-3, 0.20))),
    "diamond": (GAJETTI_DIAMOND, ((0.3, 3.5e-4, 0.52), (0.4, 7.6e-4, 0.30), (0.5, 1.4e-3, 0.20), (0.6, 2.4e-3, 0.19))),
}
"""Porosity, K in cells squared, C."""

CELLS, WALLS = (4, 5, 6, 7, 8), (0.3, 0.4, 0.5, 0.6)
SJTU = {
    "gyroid": (
        SJTU_GYROID,
        "2.283 1.845 1.470 1.276 3.174 2.997 2.470 2.205 5.000 4.557 3.812 3.475 7.113 6.551 5.577 5.124 9.579 9.524 7.259 7.097",
        "325.4 344.5 353.9 361.0 237.2 244.5 244.9 262.8 182.9 192.2 195.4 206.9 147.2 153.8 169.5 167.3 126.4 127.0 125.1 126.3",
    ),
    "diamond": (
        SJTU_DIAMOND,
        "1.531 1.229 1.267 .8342 1.957 1.917 1.721 1.287 3.051 2.668 2.795 2.370 4.310 3.764 4.092 3.417 7.448 4.829 5.431 4.093",
        "390.6 417.2 538.3 523.1 221.0 326.1 346.1 352.3 182.8 228.3 237.0 264.8 156.2 169.2 214.2 188.0 92.19 112.9 145.6 121.8",
    ),
}
"""The fit; K in 1e-8 m2 and c in 1/m, by cell and then by wall, mm."""

PRINTED = {
    "gyroid": (("air", 881, 8235, 400.5), ("water", 106, 729, 829.3), ("carbon dioxide", 10632, 48961, 1511.6)),
    "diamond": (("air", 917, 8196, 429.8), ("water", 42, 1102, 1339.5), ("carbon dioxide", 8801, 40949, 1522.1)),
}
"""Of printed exchangers, cell 7, wall 0.6: fluid, Reynolds numbers from and to, median inertial coefficient, 1/m."""

REYNOLDS = (94.0, 300.0, 1000.0, 3000.0, 10000.0, 50600.0)


def make_flow(surface: str, cell: float, wall: float, reynolds: float) -> ChannelFlow:
    """Water in a channel, mm, at a Reynolds number."""
    porosity = surfaces.skeletal_volume_fraction(surface, "minimal", 0.5 * wall / cell, "+")
    diameter = 4e-3 * cell * porosity / surfaces.cell_measures(surface, "minimal").swept_area(0.5 * wall / cell)
    return ChannelFlow(1e-3 * cell, diameter, porosity, 1.0, 998.0, 998.0 * diameter / reynolds, 7.0)


def compare_table(surface: str, reynolds: float) -> np.ndarray:
    """Friction factors (20, 2) of the fit and of the table."""
    fit, permeabilities, inertias = SJTU[surface]
    found = []
    sizes = [(cell, wall) for cell in CELLS for wall in WALLS]
    for (cell, wall), k, c in zip(sizes, permeabilities.split(), inertias.split(), strict=True):
        flow = make_flow(surface, cell, wall, reynolds)
        gradient = flow.viscosity / (1e-8 * float(k)) + flow.density * float(c)
        found.append((fit.friction(flow), flow.friction_factor(gradient)))
    return np.array(found)


def print_tables() -> None:
    """The correlations beside their points."""
    print("Gajetti et al. 2025, table 2: porosity, K of the law over that of the table, C likewise")
    for surface, (law, rows) in GAJETTI.items():
        for porosity, k, c in rows:
            print(f"  {surface:8} {porosity:.1f}  {law.a * porosity**law.n / k:.3f}  {law.b * porosity**law.m / c:.3f}")
    print(
        "SJTU-TPMSHX 2026, 20 geometries: friction factor of the fit over that of the table, rms and greatest difference"
    )
    for surface in SJTU:
        for reynolds in REYNOLDS:
            fit, table = compare_table(surface, reynolds).T
            off = fit / table - 1.0
            rms = np.sqrt((off**2).mean())
            print(f"  {surface:8} Re {reynolds:6.0f}  f {table.mean():.3f}  rms {rms:.1%}  {abs(off).max():.1%}")


def print_exchangers() -> None:
    """Printed exchangers, recomputed: friction as measured, of smooth walls, and in the printed exchanger of Yan et al. 2024."""
    print("printed exchangers, cell 7, wall 0.6: friction as measured, of smooth walls, by Yan et al. 2024")
    for surface, rows in PRINTED.items():
        fit, permeabilities, _ = SJTU[surface]
        k = 1e-8 * float(permeabilities.split()[CELLS.index(7) * len(WALLS) + WALLS.index(0.6)])
        for fluid, low, high, inertia in rows:
            flow = make_flow(surface, 7.0, 0.6, (low * high) ** 0.5)
            measured = flow.friction_factor(flow.viscosity / k + flow.density * inertia)
            smooth = fit.friction(flow)
            applies = surface == "gyroid" and 150 <= flow.reynolds <= 3000
            yan = f"{YAN_GYROID.friction(flow):.2f}" if applies else "-"
            print(
                f"  {surface:8} {fluid:14} Re {flow.reynolds:6.0f}  {measured:6.2f}  {smooth:.2f}  {yan:>5}  "
                f"measured over smooth {measured / smooth:.1f}"
            )


def draw(path: Path) -> None:
    """Friction factors over the Reynolds number: the fit as a line, the table as points."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained", sharey=True)
    for ax, surface in zip(axes, SJTU, strict=True):
        for reynolds in REYNOLDS:
            fit, table = compare_table(surface, reynolds).T
            ax.loglog(np.full(len(table), reynolds), table, "k.", ms=3)
            ax.loglog([reynolds] * 2, [fit.min(), fit.max()], "C0-", lw=4, alpha=0.5)
        ax.set(title=surface, xlabel="Reynolds number", ylabel="Darcy friction factor")
    figure.savefig(path)


def main() -> None:
    """Print the tables, and draw them on demand."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    print_tables()
    print_exchangers()
    if given.picture:
        draw(given.picture)


if __name__ == "__main__":
    main()
