"""Bone scaffolds of four structures, in four quadrants and along z, in a cylinder; the volume fraction grows with the radius.

They follow figure 12 of the porous-blending paper. The dense rim and the open core resemble cortical and trabecular bone. The
structures are blended without isolated components.
"""

from __future__ import annotations

from pathlib import Path

import build123d as bd

import tpmscad
from tpmscad import fields
from tpmscad.blending import BlendResult

NAMES = ("schwarz_p", "gyroid", "diamond", "iwp")
VOLUME_FRACTIONS = (0.3, 0.5)
"""On the axis and at the rim."""


def graded_rods(period: float, radius: float) -> list[fields.Field]:
    """Rods of four surfaces whose volume fraction grows from the axis to the rim."""
    rim = fields.cylinder((0, 0, 0), radius, axis="z")
    fraction = fields.ramp(rim, (-radius, 0.0), VOLUME_FRACTIONS)
    surfaces = [fields.tpms(name, period=period) for name in NAMES]
    return [fields.rod(phi, fields.graded_threshold(phi, fraction, VOLUME_FRACTIONS)) for phi in surfaces]


def blend_quadrants(period: float, radius: float, height: float) -> BlendResult:
    """A structure in each quadrant; the blending regions, half a period wide, cross at the axis (figure 12a)."""
    r, h = radius, period / 2
    regions = [fields.box((x, y, 0), (x + r, y + r, height)) for x, y in ((-r, -r), (0, -r), (-r, 0), (0, 0))]
    bands = [
        fields.box((-h, -r, 0), (h, 0, height)),
        fields.box((-r, -h, 0), (0, h, height)),
        fields.box((-h, 0, 0), (h, r, height)) | fields.box((0, -h, 0), (r, h, height)),
    ]
    return tpmscad.blend(graded_rods(period, r), regions, bands, weight="volume", progress=False)


def blend_layers(period: float, radius: float, height: float) -> BlendResult:
    """A structure in each quarter of the height (figure 12b)."""
    r, step, h = radius, height / 4, period / 2
    regions = [fields.box((-r, -r, step * k), (r, r, step * (k + 1))) for k in range(4)]
    bands = [fields.box((-r, -r, step * k - h), (r, r, step * k + h)) for k in (1, 2, 3)]
    return tpmscad.blend(graded_rods(period, r), regions, bands, progress=False)


ARRANGEMENTS = {"quadrants": (blend_quadrants, 1.25, 1.0), "layers": (blend_layers, 0.9, 5.0)}
"""How the structures are arranged, and radius and height in periods."""


def main(
    folder: str | Path = ".",
    arrangements: tuple[str, ...] = ("quadrants",),
    period: float = 4.0,
    tol: float = 0.16,
) -> dict[str, dict[str, object]]:
    """Make, draw and write a scaffold of each arrangement, in mm; return what was measured on it."""
    found: dict[str, dict[str, object]] = {}
    for name in arrangements:
        blend, *size = ARRANGEMENTS[name]
        radius, height = (period * n for n in size)
        blended = blend(period, radius, height)
        body = bd.Pos(0, 0, height / 2) * bd.Cylinder(radius, height)
        model = tpmscad.infill(body, blended.field, tol=tol)
        path = Path(folder) / f"bone_{name}.step"
        model.export(path)
        model.render(path.with_suffix(".png"), view=(0.5, -0.7, 0.9))
        certificate = model.certificate
        found[name] = {
            "met": certificate.met,
            "faces": certificate.n_faces,
            "deviation": certificate.max_deviation,
            "betti": certificate.betti,
            "volume fraction": model.volume / body.volume,
            "blend": blended.message,
            "isolated parts of the blend": blended.errors.remaining,
        }
    return found


if __name__ == "__main__":
    for name, values in main().items():
        print(name, values)
