"""A cross-flow heat exchanger without baffles: each channel opens at two sides of a box, and closes towards the others."""

import build123d as bd

import tpmscad
from tpmscad.results.domain_results import FluidDomains

SIZE = (20.0, 18.0, 16.0)
OPENINGS = {"+": ["<X", ">X"], "-": ["<Y", ">Y"]}


def exchanger(tol: float = 0.1) -> FluidDomains:
    """Wall, channel + from side to side along x, and channel - along y."""
    return tpmscad.fluid_domains(
        bd.Box(*SIZE), "gyroid", cell=10, thickness=1, tol=tol, openings=OPENINGS, transition=6
    )


if __name__ == "__main__":
    made = exchanger()
    print(made.certificate)
    assert made.certificate.met
    print(made.summary())
    made.render("exchanger_openings.png", section="z=0", size=(640, 480))
    made.export_step("exchanger_openings.step")
