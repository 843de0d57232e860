"""A heat exchanger: 4 x 4 x 6 cells of a gyroid in a box with four ports, as wall and two channels that share their faces."""

import build123d as bd
import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.results.domain_results import FluidDomains
from tpmscad.studies.flow_results import FlowEstimate

CELL, CELLS = 8.0, (4, 4, 6)
PHASE = (0.25, 0.0, 0.0)
"""Neither wall nor channels then lose a chip to the box."""

PORT, STUB = 1.0, 0.8
"""Radius and length of the ports: each stays within one channel, on its axis."""


def ports() -> dict[str, list[np.ndarray]]:
    """Where the ports go, an inlet below and an outlet above for each channel: where the field is farthest from the wall."""
    phi = fields.translate(fields.tpms("gyroid", period=CELL), CELL * np.array(PHASE))
    size = CELL * np.array(CELLS)
    x, y = (np.linspace(2 * PORT, size[axis] - 2 * PORT, 257) for axis in (0, 1))
    found: dict[str, list[np.ndarray]] = {"channel +": [], "channel -": []}
    for height, corner in ((0.0, (0.0, 0.0)), (size[2], (size[0], size[1]))):
        value = phi.on_grid(x, y, [height])[..., 0]
        apart = np.hypot(x[:, None] - corner[0], y[None, :] - corner[1]) / size[0]
        for name, sign in (("channel +", 1), ("channel -", -1)):
            i, j = np.unravel_index(np.argmax(sign * value - 0.02 * apart), value.shape)
            found[name].append(np.array([x[i], y[j], height]))
    return found


def body() -> bd.Part:
    """The box from the origin, with a stub at each port."""
    size = CELL * np.array(CELLS)
    part = bd.Box(*size, align=bd.Align.MIN)
    for places in ports().values():
        for x, y, z in places:
            part += bd.Pos(x, y, z + (STUB / 2 - 0.5 if z else 0.5 - STUB / 2)) * bd.Cylinder(PORT, STUB + 1)
    return part


def exchanger(tol: float = 0.02) -> FluidDomains:
    """Wall, channel + and channel -."""
    return tpmscad.fluid_domains(body(), "gyroid", cell=CELL, thickness=0.8, phase=PHASE, tol=tol)


WATER = {"density": 998.0, "viscosity": 1.0e-3, "conductivity": 0.6, "specific_heat": 4180.0}
"""At 20 degrees Celsius, SI units."""


def estimate(domains: FluidDomains, volume_flow: float = 5e-6) -> FlowEstimate:
    """What published correlations say of 0.3 litres of water a minute through one channel, without its ports."""
    return tpmscad.estimate_flow(domains, side="+", length=CELL * CELLS[2], volume_flow=volume_flow, **WATER)


if __name__ == "__main__":
    made = exchanger()
    print(made.certificate)
    assert made.certificate.met
    print(estimate(made))
    made.export_step("heat_exchanger.step")
    print(tpmscad.check_step("heat_exchanger.step"))
