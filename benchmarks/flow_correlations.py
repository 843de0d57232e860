"""Correlations of flow beside the points of their sources, and beside what printed exchangers lose and transfer.

    python -m benchmarks.flow_correlations [--picture FILE.png]

Points carried over: table 2 of Gajetti et al. (2025) in two digits; the table df_cfd_coeffs_dev.csv of the repository
alexlu997/SJTU-TPMSHX (2026), K in m2 and c in 1/m of viscosity u / K + density c u^2 in 40 geometries; the inertial coefficients
of two printed exchangers there, of cells of 7 mm with walls of 0.6 mm, by fluid. Heat and pressure drop of three printed
exchangers there, of steel (16 W/(m K)), 182 x 42 x 42 mm: air against water, from shanghai_3d_baseline.csv and gamma_hx_air.csv;
carbon dioxide at 9 MPa against itself, from exp_points.csv, with the properties of that table.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tpmscad
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

AIR_WATER = (
    (2.2769, 126.03, 350.8, 101.8, 0.016584, 18.13, 248.4, 1149),
    (4.5538, 153.56, 348.3, 106.0, 0.033167, 18.14, 621.1, 5195),
    (9.1077, 161.81, 357.9, 117.8, 0.066418, 23.90, 1269.1, 18456),
    (18.2153, 166.29, 359.7, 156.6, 0.099781, 29.72, 2513.9, 58703),
    (27.3230, 131.24, 354.2, 202.6, 0.166359, 30.89, 2775.8, 106605),
    (40.9845, 97.51, 331.2, 274.4, 0.225169, 38.75, 2481.3, 178684),
)
"""The water enters and leaves at the ends of one side: it is taken to flow against the air. Air, g/s,
its inlet, degrees Celsius, mean temperature, K, and pressure, kPa; water, m/s in the pores, and its inlet; heat, W;
pressure drop of the air, Pa, with that of its manifolds. Cases 1, 2, 4, 6, 10 and 16."""

PORE_AREA = 650.03e-6
"""Flow area of one channel that the velocities of the table refer to, m2."""

CARBON_DIOXIDE = {
    "diamond": (
        (
            (0.074177, 199.15, 115.36, 2.3068e-5, 1178.3, 0.032214),
            (0.075140, 110.57, 131.66, 2.2640e-5, 1225.7, 0.031672),
            6.291,
            6.596,
            34.8,
        ),
        (
            (0.074238, 215.35, 113.04, 2.3353e-5, 1170.7, 0.032684),
            (0.074864, 102.32, 126.11, 2.2529e-5, 1212.6, 0.031419),
            7.801,
            8.104,
            36.5,
        ),
        (
            (0.098998, 214.79, 119.47, 2.3512e-5, 1182.7, 0.033013),
            (0.100937, 100.54, 132.91, 2.2600e-5, 1230.1, 0.031622),
            10.255,
            11.115,
            61.5,
        ),
        (
            (0.122977, 225.15, 105.96, 2.3524e-5, 1155.6, 0.032923),
            (0.124269, 99.30, 121.89, 2.2496e-5, 1201.8, 0.031313),
            13.459,
            14.709,
            110.3,
        ),
    ),
    "gyroid": (
        (
            (0.073973, 199.05, 108.75, 2.3098e-5, 1163.8, 0.032205),
            (0.073587, 100.93, 156.76, 2.2554e-5, 1310.3, 0.031901),
            5.521,
            5.904,
            47.1,
        ),
        (
            (0.098583, 200.44, 113.61, 2.3296e-5, 1172.3, 0.032592),
            (0.099096, 101.28, 162.19, 2.2680e-5, 1325.8, 0.032184),
            7.220,
            7.879,
            81.1,
        ),
        (
            (0.122766, 200.63, 109.88, 2.3234e-5, 1165.1, 0.032450),
            (0.123310, 100.47, 166.77, 2.2721e-5, 1342.3, 0.032326),
            8.870,
            9.643,
            131.5,
        ),
        (
            (0.149115, 201.13, 114.43, 2.3354e-5, 1173.6, 0.032699),
            (0.148809, 99.01, 171.88, 2.2772e-5, 1361.3, 0.032497),
            10.809,
            11.683,
            183.8,
        ),
    ),
}
"""Of both streams: kg/s, inlet, degrees Celsius, density, viscosity, specific heat and conductivity at the means, SI units; heat
that the hot one gave and the cold one took, kW; pressure drop of the hot one, kPa. Cases 15, 21, 22, 23 and 15 to 18."""

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


def print_heat() -> None:
    """Three printed exchangers, recomputed: heat and pressure drop as measured and as estimated, the least and the greatest."""
    print(
        "printed exchangers, 182 x 42 x 42, cell 7, wall 0.6, steel: heat measured, estimated; pressure drop measured, estimated"
    )
    for flow, inlet, mean, pressure, velocity, cold_inlet, heat, drop in AIR_WATER:
        density = 1e3 * pressure / (287.05 * mean) - 0.5 * drop / (287.05 * mean)
        air = {
            "density": density,
            "viscosity": 1.458e-6 * mean**1.5 / (mean + 110.4),
            "conductivity": 0.0241 * (mean / 273.15) ** 0.82,
        }
        hot = air | {"specific_heat": 1009.0, "mass_flow": 1e-3 * flow, "temperature": inlet}
        water = {"density": 997.0, "viscosity": 9e-4, "conductivity": 0.606, "specific_heat": 4180.0}
        cold = water | {"volume_flow": velocity * PORE_AREA, "temperature": cold_inlet}
        _print_estimate("gyroid", hot, cold, (heat, heat), drop)
    names = ("mass_flow", "temperature", "density", "viscosity", "specific_heat", "conductivity")
    for surface, rows in CARBON_DIOXIDE.items():
        for *streams, given, taken, drop in rows:
            hot, cold = (dict(zip(names, stream, strict=True)) for stream in streams)
            _print_estimate(surface, hot, cold, (1e3 * given, 1e3 * taken), 1e3 * drop)


def _print_estimate(
    surface: str,
    hot: dict[str, float],
    cold: dict[str, float],
    heat: tuple[float, float],
    drop: float,
) -> None:
    """One line of what was measured beside what is estimated."""
    size = {"core": (182.0, 42.0, 42.0), "cell": 7.0, "thickness": 0.6, "wall_conductivity": 16.0}
    found = tpmscad.estimate_exchanger(surface, plus=hot, minus=cold, **size)
    assert found.heat is not None
    drops = found.pressure_drops["+"]
    smooth = "none" if drops is None else f"{drops[0]:7.0f} to {drops[1]:7.0f} Pa"
    measured = 0.5 * sum(heat)
    print(
        f"  {surface:8} Re {found.plus.reynolds:6.0f} {found.minus.reynolds:6.0f}  {heat[0]:6.0f} {heat[1]:6.0f} W, estimated "
        f"{found.heat[0]:6.0f} to {found.heat[1]:6.0f} W ({found.heat[0] / measured - 1:+.0%} to "
        f"{found.heat[1] / measured - 1:+.0%}); "
        f"{drop:7.0f} Pa, estimated {smooth}"
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
    print_heat()
    if given.picture:
        draw(given.picture)


if __name__ == "__main__":
    main()
