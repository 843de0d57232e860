"""Persistence diagrams and barcodes of a blend before and after its optimisation, as in the porous-blending paper.

Rods of Schwarz P and of I-WP are blended along x. At level 0 the initial blend has isolated components and cavities: points of
the persistence diagram with birth < 0 < death, bars of the barcode that cross the line at 0. The optimisation moves all of them
off level 0 but one, the component that is the structure itself.
"""

from __future__ import annotations

from typing import Any

from tpmscad import fields, topology
from tpmscad.blending import BlendResult, blend

P_RODS = fields.rod(fields.tpms("schwarz_p", period=0.25), -0.8)
W_RODS = fields.rod(fields.tpms("iwp", period=0.25), -2.2)
LEFT, RIGHT = fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))
MIDDLE = fields.box((0.25, 0, 0), (0.75, 0.5, 0.5))


def make_blend(method: str) -> BlendResult:
    """The blend with its initial weight ("initial") or the optimised one ("topological")."""
    return blend([P_RODS, W_RODS], [LEFT, RIGHT], [MIDDLE], resolution=(37, 21, 19), method=method)


def main() -> dict[str, topology.PersistenceDiagram]:
    """The diagrams before and after, which differ at level 0 by the errors that the optimisation removed."""
    diagrams = {
        name: topology.persistence_diagram(make_blend(method))
        for name, method in (("before", "initial"), ("after", "topological"))
    }
    errors = {name: count_errors(diagram) for name, diagram in diagrams.items()}
    assert errors["before"] > 0, errors
    assert errors["after"] == 0, errors
    return diagrams


def count_errors(diagram: topology.PersistenceDiagram) -> int:
    """Components besides the structure, and cavities, at level 0."""
    alive = diagram.alive_at(0.0)
    return len(alive.pairs(0)) - 1 + len(alive.pairs(2))


def picture(results: dict[str, topology.PersistenceDiagram], path: str) -> None:
    """Diagrams above, barcodes of the features at level 0 below."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(11, 11), layout="constrained")
    for column, (name, diagram) in enumerate(results.items()):
        upper, lower = panels[:, column]
        diagram.plot_diagram(upper).set_title(f"{name}: {count_errors(diagram)} errors at level 0")
        diagram.alive_at(0.0).plot_barcode(lower).set_title(f"{name}: features alive at level 0")
    figure.savefig(path, dpi=100)
    plt.close(figure)


def report(diagrams: dict[str, topology.PersistenceDiagram], path: str) -> dict[str, Any]:
    """Draw the figure and return the errors that it shows."""
    picture(diagrams, path)
    return {name: count_errors(diagram) for name, diagram in diagrams.items()}


if __name__ == "__main__":
    print(report(main(), "persistence_diagrams.png"))
