"""`design_for`: the wall of a surface, or the diameter of struts, for a stiffness, a conductivity or a permeability.

Over the volume fraction these properties are nearly power laws (Gibson and Ashby, Cellular Solids, 1997), so that in logarithms
a few computed values, joined by a monotone interpolant, lead to the fraction asked for. The value there is computed, too: it is
that which meets the target.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from tpmscad import surfaces
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import ProgressKeyword
from tpmscad.api.shared_kinds import NOT_NEGATIVE, POSITIVE, TEXT
from tpmscad.catalogue import CATALOGUE
from tpmscad.errors import InvalidRequest
from tpmscad.solids._lattice import lattice
from tpmscad.solids._struts import struts
from tpmscad.stage_timer import StageTimer
from tpmscad.strut_cells import KINDS
from tpmscad.studies._homogenize import homogenize
from tpmscad.studies._permeability import permeability
from tpmscad.studies.surface_limits import thickest_wall

STIFFNESSES = ("E1", "E2", "E3", "G12", "G13", "G23", "C11", "C12", "C44", "bulk_modulus")
PROPERTIES = (*STIFFNESSES, "conductivity", "permeability")

RTOL = 2e-3
"""Relative difference from the target at which a design is accepted."""

STARTS = (0.1, 0.25)
"""Parts of the range of volume fractions that are computed first."""

LEAST_FRACTION, MOST_STRUTS, LIMIT_SHARE = 0.02, 0.5, 0.97
"""Least volume fraction that is tried, the greatest one of struts, and the part of a sheet's limit that is."""

MAX_EVALUATIONS = 9


@dataclass(frozen=True, slots=True, repr=False)
class LatticeDesign:
    """A lattice with a property asked for.

    Attributes
    ----------
    surface : str
        Name of the surface, or of the cell of struts.
    cell : float
        Edge of the cell, mm.
    property : str
    target, value : float
        What was asked for, and what the finest mesh of the design gives.
    error : float
        Relative change of the value by the last refinement of its mesh.
    volume_fraction : float
    thickness, diameter : float or None
        Of the wall, or of the struts, mm; the other is None.
    evaluations : int
        Lattices that were computed.
    seconds : float
        CPU time.
    """

    surface: str
    cell: float
    property: str
    target: float
    value: float
    error: float
    volume_fraction: float
    thickness: float | None
    diameter: float | None
    evaluations: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """All figures as plain values, ready for JSON. The attributes by their names."""
        return asdict(self)

    def __repr__(self) -> str:
        size = f"diameter {self.diameter:.5g}" if self.thickness is None else f"thickness {self.thickness:.5g}"
        return (
            f"{self.surface}, cell {self.cell:g} mm: {size} mm, volume fraction {self.volume_fraction:.4g}\n"
            f"{self.property} {self.value:.5g} for {self.target:.5g}, relative error of the mesh {self.error:.1e}; "
            f"{self.evaluations} lattices, {self.seconds:.0f} s"
        )


@validate_call()
def design_for(
    surface: Annotated[str, TEXT, "A surface of the catalogue, whose sheet is meant, or a kind of struts."],
    property: Annotated[
        str,
        choice_of(*PROPERTIES),
        "Young's moduli E1 to E3, shear moduli G12 to G23, entries C11, C12, C44 of the stiffness, or the bulk modulus; the "
        "mean conductivity over that of the solid; the permeability of one channel beside the wall, mm2.",
    ],
    target: Annotated[float, POSITIVE.described_as(example="0.05"), "The value that the property is to have."],
    *,
    cell: Annotated[float, POSITIVE.described_as(example="10.0"), "Edge of the cubic cell, mm."] = 1.0,
    youngs_modulus: Annotated[
        float, POSITIVE.described_as(example="1.0"), "Young's modulus of the solid, in the unit of the target."
    ] = 1.0,
    poisson_ratio: Annotated[
        float, NOT_NEGATIVE.described_as(example="0.3"), "Poisson's ratio of the solid, from 0 to 0.49."
    ] = 0.3,
    progress: ProgressKeyword = None,
) -> LatticeDesign:
    """Find the thickness of a wall, or the diameter of struts, that gives an effective property.

    Returns
    -------
    LatticeDesign
        The design, whose `value` is within 0.2 % of the target; `error` says how well its mesh knows it.

    Raises
    ------
    InvalidRequest
        If no wall or diameter gives the target; the message names the values that are within reach.

    Notes
    -----
    See `tpmscad.homogenize` and `tpmscad.permeability` for what is computed.

    Examples
    --------
    >>> found = tpmscad.design_for("gyroid", "E1", 0.05, cell=10)  # doctest: +SKIP
    >>> model = tpmscad.lattice("gyroid", cell=found.cell, thickness=found.thickness)  # doctest: +SKIP
    """
    begun, stages = time.process_time(), StageTimer(progress)
    is_struts = surface in KINDS and surface not in CATALOGUE
    if is_struts and property == "permeability":
        raise InvalidRequest(f"the permeability of {surface} struts is not computed: give a surface of the catalogue")
    reference = "" if is_struts else surfaces.find_surface(surface).references[0]
    if is_struts:
        most = MOST_STRUTS
    else:
        half = LIMIT_SHARE * thickest_wall(surface, reference) / 2
        most = min(surfaces.volume_fraction(surface, reference, -half, half), LIMIT_SHARE)
    computed: dict[float, tuple[float, float]] = {}

    def compute(fraction: float) -> float:
        """The property at a volume fraction, kept with its error."""
        with stages(f"lattice {len(computed) + 1}"):
            if property == "permeability":
                wall = surfaces.thickness_for(surface, reference, fraction)
                channel = lattice(surface, kind="skeletal", cell=1.0, offset=-wall / 2, loose="keep", progress=False)
                flow = permeability(channel, progress=False)
                found, error = float(np.trace(flow.permeability)) / 3.0 * cell**2, flow.error
            else:
                properties = homogenize(
                    surface,
                    volume_fraction=fraction,
                    youngs_modulus=youngs_modulus,
                    poisson_ratio=poisson_ratio,
                    progress=False,
                )
                values = properties.to_dict()
                mean = float(np.trace(properties.conductivity)) / 3.0
                found, error = mean if property == "conductivity" else float(values[property]), properties.error
        computed[fraction] = found, error
        return found

    for share in STARTS:
        compute(LEAST_FRACTION + share * (most - LEAST_FRACTION))
    while True:
        best = min(computed, key=lambda each: abs(math.log(computed[each][0] / target)))
        if abs(computed[best][0] / target - 1.0) <= RTOL:
            break
        following = _interpolate({each: value for each, (value, _) in computed.items()}, target, most)
        if len(computed) >= MAX_EVALUATIONS or min(abs(following / each - 1.0) for each in computed) < 1e-6:
            ends = sorted(value for value, _ in computed.values())
            raise InvalidRequest(
                f"{property} {target:g} is out of reach of {surface} with cell {cell:g}: volume fractions from "
                f"{min(computed):.3g} to {max(computed):.3g} gave {ends[0]:.4g} to {ends[-1]:.4g}; ask for one between them, or "
                "for another surface or cell"
            )
        compute(following)
    thickness = diameter = None
    if is_struts:
        graph = struts(surface, cell=cell, volume_fraction=best, progress=False).struts
        assert graph is not None
        diameter = float(graph.diameters.max())
    else:
        thickness = cell * surfaces.thickness_for(surface, reference, best)
    seconds, (value, error) = time.process_time() - begun, computed[best]
    return LatticeDesign(
        surface, cell, property, target, value, error, best, thickness, diameter, len(computed), seconds
    )


def _interpolate(values: dict[float, float], target: float, most: float) -> float:
    """The fraction at which the interpolant of logarithms has the target; beyond the values by the slope of the nearest two."""
    fraction = np.log(sorted(values))
    misses = np.log([values[each] / target for each in sorted(values)])
    signs = np.flatnonzero(np.sign(misses[:-1]) != np.sign(misses[1:]))
    if len(signs) == 0:
        near = slice(0, 2) if abs(misses[0]) < abs(misses[-1]) else slice(-2, None)
        (a, b), (m, n) = fraction[near], misses[near]
        step = float(np.clip(-(m if near.start == 0 else n) * (b - a) / (n - m), -1.0, 1.0))
        reached = math.exp((a if near.start == 0 else b) + step)
        return min(max(reached, LEAST_FRACTION), most)
    low, high = fraction[signs[0]], fraction[signs[0] + 1]
    return math.exp(brentq(PchipInterpolator(fraction, misses), low, high))
