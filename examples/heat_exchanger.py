"""A heat exchanger: 4 x 4 x 6 cells of a gyroid in a box with four ports, as wall and two channels that share their faces.

`main(cells=(5, 5, 8))` makes 200 cells in the same way.

    python examples/heat_exchanger.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.results.domain_results import FluidDomains
from tpmscad.studies.flow_results import FlowEstimate

CELL = 8.0
PHASE = (0.25, 0.0, 0.0)
"""Neither wall nor channels then lose a chip to the box."""

PORT, STUB = 1.0, 0.8
"""Radius and length of the ports: each stays within one channel, on its axis."""


def ports(cells: tuple[int, int, int]) -> dict[str, list[np.ndarray]]:
    """Where the ports go, an inlet below and an outlet above for each channel: where the field is farthest from the wall."""
    phi = fields.translate(fields.tpms("gyroid", period=CELL), CELL * np.array(PHASE))
    size = CELL * np.array(cells)
    x, y = (np.linspace(2 * PORT, size[axis] - 2 * PORT, 257) for axis in (0, 1))
    found: dict[str, list[np.ndarray]] = {"channel +": [], "channel -": []}
    for height, corner in ((0.0, (0.0, 0.0)), (size[2], (size[0], size[1]))):
        value = phi.on_grid(x, y, [height])[..., 0]
        apart = np.hypot(x[:, None] - corner[0], y[None, :] - corner[1]) / size[0]
        for name, sign in (("channel +", 1), ("channel -", -1)):
            i, j = np.unravel_index(np.argmax(sign * value - 0.02 * apart), value.shape)
            found[name].append(np.array([x[i], y[j], height]))
    return found


def body(cells: tuple[int, int, int]) -> bd.Part:
    """The box from the origin, with a stub at each port."""
    size = CELL * np.array(cells)
    part = bd.Box(*size, align=bd.Align.MIN)
    for places in ports(cells).values():
        for x, y, z in places:
            part += bd.Pos(x, y, z + (STUB / 2 - 0.5 if z else 0.5 - STUB / 2)) * bd.Cylinder(PORT, STUB + 1)
    return part


def exchanger(cells: tuple[int, int, int] = (2, 2, 2), tol: float = 0.1) -> FluidDomains:
    """Wall, channel + and channel -."""
    return tpmscad.fluid_domains(body(cells), "gyroid", cell=CELL, thickness=0.8, phase=PHASE, tol=tol)


WATER = {"density": 998.0, "viscosity": 1.0e-3, "conductivity": 0.6, "specific_heat": 4180.0}
"""At 20 degrees Celsius, SI units."""


def estimate(domains: FluidDomains, length: float, volume_flow: float = 5e-6) -> FlowEstimate:
    """What published correlations say of 0.3 litres of water a minute through one channel, without its ports."""
    return tpmscad.estimate_flow(domains, side="+", length=length, volume_flow=volume_flow, **WATER)


def main(
    path: str | Path = "heat_exchanger.step", cells: tuple[int, int, int] = (2, 2, 2), tol: float = 0.1
) -> dict[str, Any]:
    """Make, draw and write an exchanger of so many cells; return what was measured on it, in mm."""
    made = exchanger(cells, tol)
    made.export_step(path)
    made.render(Path(path).with_suffix(".png"), section=f"y={CELL * cells[1] / 2}")
    certificate = made.certificate
    assert certificate.met
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,
        "flow": str(estimate(made, CELL * cells[2])),
        "file": str(tpmscad.check_step(path)),
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
