"""The blends of the porous-blending paper's tables and figures, with parameters where the paper gives none.

Lengths are those of the paper's unit box. Implicit periodic units (IPU) are cubic periodic B-splines of 4 x 4 x 4 normal random
coefficients with the seed stated, 30 % solid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad import fields
from tpmscad.blending import CylinderRadius, LineWeightSpec, SphereRadius, VolumeWeightSpec
from tpmscad.blending.weights.coordinates import LinearCoordinate

INF = np.inf


@dataclass(frozen=True)
class Case:
    """The arguments of a blend, the paper's iterations and seconds of Table 2, and its counts of Table 1 if it has them."""

    name: str
    parameters: str
    structures: tuple[fields.Field, ...]
    regions: tuple[fields.Field, ...]
    blending: tuple[fields.Field, ...]
    weight: LineWeightSpec | VolumeWeightSpec
    resolution: tuple[int, int, int]
    paper_iterations: int
    paper_seconds: float
    table1: tuple[tuple[int, int], ...] = ()
    """Components and holes of beta growth, discrete reconstruction, sigmoid, the paper's own."""


def tpms(name: str, periods: float) -> fields.Field:
    """A surface with this number of periods in the unit box."""
    return fields.tpms(name, period=1 / periods)


def unit(seed: int, periods: float, solid: float = 0.3) -> fields.Field:
    """An implicit periodic unit with a solid fraction."""
    coefficients = np.random.default_rng(seed).normal(size=(4, 4, 4))
    values = fields.bspline_unit(coefficients, period=1.0)(np.random.default_rng(1).uniform(0, 1, (8000, 3)))
    return fields.rod(fields.bspline_unit(coefficients, period=1 / periods), float(np.quantile(values, solid)))


def halves(height: float = 0.25) -> tuple[fields.Field, fields.Field]:
    """The two halves of the box along x."""
    return fields.box((0, 0, 0), (0.5, height, height)), fields.box((0.5, 0, 0), (1, height, height))


def layer(low: float, high: float, height: float = 0.25) -> fields.Field:
    """The layer between two values of x."""
    return fields.box((low, 0, 0), (high, height, height))


def table1() -> list[Case]:
    """Figures 7 and 8: boxes [0, 1] x [0, .25]^2, blending region .3 <= x <= .7, 50 coefficients, 50^3 samples, 8 periods."""
    weight, size = LineWeightSpec(LinearCoordinate(), count=50), (50, 50, 50)
    rod_p, sheet_p = fields.rod(tpms("schwarz_p", 8), -0.8), fields.sheet(tpms("schwarz_p", 8), -0.5, 0.5)
    rows = [
        ("Rod-IPU1 + Rod-IPU2", "seeds 43, 87", unit(43, 8), unit(87, 8), 3, 3.34, ((30, 4), (9, 4), (34, 4), (1, 0))),
        ("Rod-P + Sheet-P", "rod .4 at 5 periods, sheet -.5 to .5", fields.rod(tpms("schwarz_p", 5), 0.4), sheet_p, 1, np.nan,
         ((2, 0), (2, 0), (2, 0), (1, 0))),
        ("Rod-P + Rod-IWP", "rods -.8, -2.2", rod_p, fields.rod(tpms("iwp", 8), -2.2), 1, 1.61,
         ((18, 0), (2, 0), (34, 0), (1, 0))),
        ("Sheet-P + Sheet-G", "sheets -.8 to .2, .4 to 1.5", fields.sheet(tpms("schwarz_p", 8), -0.8, 0.2),
         fields.sheet(tpms("gyroid", 8), 0.4, 1.5), 1, 1.39, ((2, 9), (2, 0), (2, 6), (2, 0))),
    ]  # fmt: skip
    return [
        Case(name, text, (first, second), halves(), (layer(0.3, 0.7),), weight, size, steps, seconds, counts)
        for name, text, first, second, steps, seconds, counts in rows
    ]


def table2() -> list[Case]:
    """Every row of Table 2, with its number of coefficients and its resolution."""
    first = table1()
    sheet_iwp = (fields.sheet(tpms("schwarz_p", 8), -0.3, 0.9), fields.rod(tpms("iwp", 8), -0.9))
    wide = Case("Sheet-P + Rod-IWP", "sheet -.3 to .9, rod -.9", sheet_iwp, halves(), (layer(0.3, 0.7),),
                LineWeightSpec(LinearCoordinate(), count=50), (50, 50, 50), 1, 1.43)  # fmt: skip
    return [first[0], wide, first[2], first[3], *figure9(), *(figure10(d) for d in (0.2,)), figure11()]


def pair(periods: float = 4) -> tuple[fields.Field, fields.Field]:
    """Rods of Schwarz P and I-WP."""
    return fields.rod(tpms("schwarz_p", periods), -0.8), fields.rod(tpms("iwp", periods), -2.0)


def figure9() -> list[Case]:
    """Free-form models max(phi, model), 30 coefficients over the regions, 50^3 samples."""
    size = (50, 50, 50)
    block = fields.smooth_intersection(fields.box((0, 0, 0), (1, 1, 1)), fields.sphere((0.5, 0.5, 0.5), 0.75), 0.1)
    a = Case("Figure 9(a)", "rounded block, x in [.4, .6]", tuple(f & block for f in pair()),
             (fields.box((0, 0, 0), (0.5, 1, 1)), fields.box((0.5, 0, 0), (1, 1, 1))),
             (fields.box((0.4, 0, 0), (0.6, 1, 1)),), LineWeightSpec(LinearCoordinate(), count=30), size, 1, 1.73)  # fmt: skip
    domain = fields.box((-0.5, -0.5, 0), (0.5, 0.5, 1))
    drum = fields.cylinder((0, 0, 0.5), 0.5, axis="z")
    core, ring = fields.cylinder((0, 0, 0), 0.25, axis="z"), round_layer(fields.cylinder, 0.2, 0.3)
    b = Case("Figure 9(b)", "cylinder, r in [.2, .3]", tuple(f & drum for f in pair()), (core & domain, domain & ~core),
             (ring,), LineWeightSpec(CylinderRadius(), count=30), size, 4, 4.45)  # fmt: skip
    quarter = fields.box((0, 0, 0), (0.5, 0.5, 0.5))
    ball, inner = fields.sphere((0, 0, 0), 0.5), fields.sphere((0, 0, 0), 0.25)
    c = Case("Figure 9(c)", "ball, r in [.15, .35]", tuple(f & ball for f in pair(8)), (inner & quarter, quarter & ~inner),
             (round_layer(fields.sphere, 0.15, 0.35),), LineWeightSpec(SphereRadius(), count=30), size, 9, 9.69)  # fmt: skip
    return [a, b, c]


def round_layer(shape: object, low: float, high: float) -> fields.Field:
    """The layer between two radii of a cylinder or sphere."""
    make = shape  # fields.cylinder or fields.sphere around the origin
    return make((0, 0, 0), high) & ~make((0, 0, 0), low)  # type: ignore[operator]


def wave(shift: float) -> fields.Field:
    """The boundary of figure 10 moved along y: y + sin(2 pi x) / 4 - 1/2 - shift."""
    return fields.from_function(lambda p: p[:, 1] + 0.25 * np.sin(2 * np.pi * p[:, 0]) - 0.5 - shift)


def figure10(offset: float) -> Case:
    """Regions on both sides of a wave, the wave moved by -D and D bounding the blending region; 80 x 80 x 20 coefficients."""
    box = fields.box((0, 0, 0), (1, 1, 0.25))
    return Case(f"Figure 10 (D = {offset:g})", "rods -.8, -2", pair(), (wave(0) & box, ~wave(0) & box),
                (wave(offset) & ~wave(-offset),), VolumeWeightSpec((80, 80, 20)), (100, 100, 25), 2, 12.12)  # fmt: skip


def picture(size: int = 128) -> np.ndarray:
    """A two-valued picture with four separate shapes: disc, ring, square and bar (True: the second structure)."""
    y, x = np.mgrid[0:size, 0:size] / size
    disc = (x - 0.25) ** 2 + (y - 0.27) ** 2 < 0.15**2
    square = (abs(x - 0.74) < 0.13) & (abs(y - 0.26) < 0.13)
    bar = (abs(x - 0.26) < 0.15) & (abs(y - 0.75) < 0.10)
    diamond = abs(x - 0.74) + abs(y - 0.74) < 0.18
    return disc | square | bar | diamond


def figure11(pixels: int = 8, periods: int = 4) -> Case:
    """Regions from a picture of 128 x 128 pixels; its borders widened by 8 pixels inward and outward: four blending loops.

    The paper doesn't give the periods. At 4 the blending region is half of one wide, at 8 one.
    """
    from scipy.ndimage import distance_transform_edt

    white = picture()
    near = np.where(white, distance_transform_edt(white), distance_transform_edt(~white)) <= pixels
    box = (0, 0, 0), (1, 1, 0.25)
    limits = fields.box(*box)
    flat = (0, 0), (1, 1)
    second, band = fields.image_region(white.T, *flat), fields.image_region(near.T, *flat)
    structures = fields.rod(tpms("schwarz_p", periods), -0.8), fields.rod(tpms("gyroid", periods), -0.8)
    return Case("Figure 11", "rods -.8, -.8", structures, (limits & ~second, limits & second), (band,),
                VolumeWeightSpec((80, 80, 20)), (50, 50, 25), 3, 5.06)  # fmt: skip
