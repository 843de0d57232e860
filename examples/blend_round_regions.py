"""Two porous structures blended across a plane, a cylinder and a sphere, inside free-form models.

These are the cases of figure 9 of the porous-blending paper: Schwarz P rods on one side of the interface, I-WP rods on the other,
each intersected with a model. The coordinate of the weight is found from the regions: x, the cylinder's radius, the sphere's
radius.
"""

from __future__ import annotations

from blend_slices import draw, figure, show

from tpmscad import fields
from tpmscad.blending import BlendResult, blend


def rods(periods: float) -> tuple[fields.Field, fields.Field]:
    """Rods of Schwarz P and I-WP."""
    p, w = fields.tpms("schwarz_p", period=1 / periods), fields.tpms("iwp", period=1 / periods)
    return fields.rod(p, -0.8), fields.rod(w, -2.0)


def across_plane() -> BlendResult:
    """A rounded block, blended across a plane."""
    block = fields.smooth_intersection(fields.box((0, 0, 0), (1, 1, 1)), fields.sphere((0.5, 0.5, 0.5), 0.75), 0.1)
    left, right = fields.box((0, 0, 0), (0.5, 1, 1)), fields.box((0.5, 0, 0), (1, 1, 1))
    layer = fields.box((0.4, 0, 0), (0.6, 1, 1))
    return blend([f & block for f in rods(4)], [left, right], [layer], resolution=(50, 50, 50))


def around_cylinder() -> BlendResult:
    """A drum, blended across a coaxial cylinder."""
    drum, box = fields.cylinder((0, 0, 0.5), 0.5, axis="z"), fields.box((-0.5, -0.5, 0), (0.5, 0.5, 1))
    core = fields.cylinder((0, 0, 0), 0.25, axis="z")
    ring = fields.cylinder((0, 0, 0), 0.3, axis="z") & ~fields.cylinder((0, 0, 0), 0.2, axis="z")
    return blend([f & drum for f in rods(4)], [core & box, box & ~core], [ring], resolution=(50, 50, 50))


def around_sphere() -> BlendResult:
    """An octant of a ball, blended across a concentric sphere."""
    ball, octant = fields.sphere((0, 0, 0), 0.5), fields.box((0, 0, 0), (0.5, 0.5, 0.5))
    core = fields.sphere((0, 0, 0), 0.25)
    shell = fields.sphere((0, 0, 0), 0.35) & ~fields.sphere((0, 0, 0), 0.15)
    return blend([f & ball for f in rods(8)], [core & octant, octant & ~core], [shell], resolution=(50, 50, 50))


def main() -> dict[str, BlendResult]:
    """The three blends without topological defects; chips that the models cut off are counted as intrinsic."""
    results = {"plane": across_plane(), "cylinder": around_cylinder(), "sphere": around_sphere()}
    for name, result in results.items():
        assert result.converged, f"{name}: {result.message}"
    kinds = [type(result.weights[0].coordinate).__name__ for result in results.values()]
    assert kinds == ["LinearCoordinate", "CylinderRadius", "SphereRadius"], kinds
    return results


def picture(results: dict[str, BlendResult], path: str) -> None:
    """Slices of the three solids."""
    spans = {"plane": (0, 1), "cylinder": (-0.5, 0.5), "sphere": (0, 0.5)}

    def fill(panels: list) -> None:
        for panel, (name, result) in zip(panels, results.items(), strict=True):
            draw(panel, result, (spans[name], spans[name]), 0.065 if name == "sphere" else 0.13)
            panel.set_title(f"{name}: {result.iterations} rounds")

    figure(1, 3, (15, 5), path, fill)


if __name__ == "__main__":
    show(main, picture, "blend_round_regions.png")
