"""Scaffolds of four porous structures: in layers, and in four quadrants whose blending regions cross.

They follow figure 12 of the porous-blending paper (Algorithm 3): each blending region joins one more structure to those before.
"""

from __future__ import annotations

import numpy as np
from blend_slices import draw, figure, show

from tpmscad import fields
from tpmscad.blending import BlendResult, blend

KINDS = (("schwarz_p", -0.6), ("gyroid", -0.6), ("diamond", -0.3), ("iwp", -1.0))


def rods(period: float) -> list[fields.Field]:
    """Rods of four surfaces."""
    return [fields.rod(fields.tpms(name, period=period), level) for name, level in KINDS]


def graded() -> BlendResult:
    """Layers along z, 10 mm each, blended over 4 mm; periods of 5 mm."""
    layers = [fields.box((0, 0, 10 * k), (15, 15, 10 * k + 10)) for k in range(4)]
    bands = [fields.box((0, 0, 10 * k - 2), (15, 15, 10 * k + 2)) for k in (1, 2, 3)]
    return blend(rods(5.0), layers, bands, minimum_neck=0.4)


def quadrants() -> BlendResult:
    """A quarter of a drum for each structure, inside a drum of radius 10 mm; blending regions 5 mm wide cross at its axis."""
    h = 2.5
    corners = ((-10, -10), (0, -10), (-10, 0), (0, 0))
    regions = [fields.box((x, y, 0), (x + 10, y + 10, 8)) for x, y in corners]
    bands = [
        fields.box((-h, -10, 0), (h, 0, 8)),
        fields.box((-10, -h, 0), (0, h, 8)),
        fields.box((-h, 0, 0), (h, 10, 8)) | fields.box((0, -h, 0), (10, h, 8)),
    ]
    drum = fields.cylinder((0, 0, 4), 10, axis="z")
    return blend([f & drum for f in rods(5.0)], regions, bands, weight="volume", resolution=(60, 60, 25))


def main() -> dict[str, BlendResult]:
    """Both scaffolds, without topological defects and narrow necks."""
    results = {"graded": graded(), "quadrants": quadrants()}
    for name, result in results.items():
        assert result.converged, f"{name}: {result.message}"
        assert len(result.weights) == 3
    shares = results["quadrants"].weight(np.array([[0.0, 0.0, 4.0], [-8.0, -3.0, 4.0]]))
    assert np.allclose(shares.sum(axis=1), 1)
    assert shares[1].tolist() == [1, 0, 0, 0]
    assert results["graded"].necks == (), results["graded"].message
    return results


def picture(results: dict[str, BlendResult], path: str) -> None:
    """A slice of each scaffold."""

    def fill(panels: list) -> None:
        draw(panels[0], results["graded"], ((0, 15), (0, 40)), 2.0, axes=(0, 2))
        draw(panels[1], results["quadrants"], ((-10, 10), (-10, 10)), 2.0)
        for panel, name in zip(panels, results, strict=True):
            panel.set_title(name)

    figure(1, 2, (11, 8), path, fill)


if __name__ == "__main__":
    show(main, picture, "blend_scaffold.png")
