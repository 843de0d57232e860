"""A diamond that turns into an I-WP over one period, as one solid in STEP; the fits on all cores where there are many."""

from __future__ import annotations

from pathlib import Path

from tpmscad import blend, fields
from tpmscad.solids._solidify import solidify


def main(path: str | Path = "blend.step", half: float = 10.0) -> dict[str, object]:
    """Write the solid and return what its certificate says. `half`: length of each structure, periods are 10 mm."""
    pore = fields.pore(fields.tpms("diamond", period=10.0), -0.2)
    rod = fields.rod(fields.tpms("iwp", period=10.0), -0.65)
    left, right = fields.box((0, 0, 0), (half, 10, 10)), fields.box((half, 0, 0), (2 * half, 10, 10))
    layer = fields.box((half - 5, 0, 0), (half + 5, 10, 10))
    blended = blend([pore, rod], [left, right], [layer])
    model = solidify(blended.field, ((0, 0, 0), (2 * half, 10, 10)), tol=0.05)
    model.export_step(path)
    return model.certificate.to_dict()


if __name__ == "__main__":
    print(main())
