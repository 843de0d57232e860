"""`design_derivatives`: how volume, area, stiffness and conductivity of a sheet change with its thickness, offset and cell.

Volume and area per cell follow from Steiner's formula on the exact surface. Stiffness and conductivity are differentiated on
hexahedra whose nodes move as the two offset surfaces do. What depends on ratios of lengths alone is homogeneous in them, so the
derivative with respect to the cell follows from the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FLAG, NOT_NEGATIVE, NUMBER, POSITIVE, TEXT
from tpmscad.catalogue import find_surface
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.result_display import format_html_table
from tpmscad.simulation.periodic_cell import IsotropicMaterial
from tpmscad.simulation.shape_derivatives import differentiate_cell
from tpmscad.solids._lattice import lattice
from tpmscad.surfaces import cell_measures

STEP = 1e-3
"""Of the thickness: step of the central differences of nodes, whose motion is nearly linear."""

CUTS = (3, 1)
"""Cuts of each patch's wall along it and through it."""

PARAMETERS = ("thickness", "offset", "cell")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DesignDerivatives:
    """A sheet's properties per cell, and their derivatives.

    Attributes
    ----------
    volume, area : float
        Of one cell, in mm3 and mm2; the area is that of both sides of the wall.
    stiffness : (6, 6) array or None
        As in `HomogenizedProperties`; None if it was not asked for.
    conductivity : (3, 3) array or None
        Relative to that of the solid.
    derivatives : dict
        For "thickness", "offset" (of the middle of the wall along the normal) and "cell" (thickness and offset kept) a dict with
        the derivatives of "volume", "area" and, where asked for, "stiffness" and "conductivity", per mm.
    """

    volume: float
    area: float
    stiffness: Array | None
    conductivity: Array | None
    derivatives: dict[str, dict[str, Any]]

    def __repr__(self) -> str:
        lines = [f"one cell: volume {self.volume:.6g} mm3, area {self.area:.6g} mm2; derivatives per mm by"]
        for name, of in self.derivatives.items():
            more = "".join(f", {key}" for key in of if key not in ("volume", "area"))
            lines.append(f"  {name:<10} volume {of['volume']:.6g}, area {of['area']:.6g}{more}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = [("value", self.volume, self.area)]
        rows += [(f"by {name}, per mm", of["volume"], of["area"]) for name, of in self.derivatives.items()]
        return format_html_table("one cell and its derivatives", rows, ("", "volume, mm3", "area, mm2"))


@validate_call()
def design_derivatives(
    surface: Annotated[str, TEXT, "A surface of the catalogue."],
    *,
    cell: Annotated[float, POSITIVE.described_as(example="10.0"), "Edge of the cubic cell in mm."] = 1.0,
    thickness: Annotated[float, POSITIVE, "Thickness of the wall in mm."],
    shift: Annotated[float, NUMBER, "Offset of the middle of the wall from the surface along its normal, in mm."] = 0.0,
    reference: Annotated[str | None, TEXT.described_as(example='"nodal"'), "As in `tpmscad.lattice`."] = None,
    elastic: Annotated[
        bool, FLAG, "Whether stiffness and conductivity are computed, which takes some 10 seconds."
    ] = True,
    youngs_modulus: Annotated[float, POSITIVE.described_as(example="1.0"), "Those of the solid."] = 1.0,
    poisson_ratio: Annotated[float, NOT_NEGATIVE.described_as(example="0.3"), "Those of the solid."] = 0.3,
) -> DesignDerivatives:
    """Derivatives of a sheet's volume, area, stiffness and conductivity with respect to thickness, offset and cell.

    Returns
    -------
    DesignDerivatives
        `volume`, `area`, `stiffness`, `conductivity`, and `derivatives` of each by "thickness", "offset" and "cell".

    Raises
    ------
    InvalidRequest
        If the surface has no hexahedra (see `Model.hexahedra`), or scikit-fem is not installed.

    Notes
    -----
    Stiffness and conductivity are those of one mesh of 27-node hexahedra, and their derivatives exact for it.

    Examples
    --------
    >>> found = tpmscad.design_derivatives("gyroid", cell=10, thickness=1, elastic=False)
    >>> round(found.area, 3), round(found.derivatives["thickness"]["volume"], 3)
    (593.156, 296.578)
    """
    record = find_surface(surface)
    reference = record.references[0] if reference is None else reference
    measures = cell_measures(surface, reference)
    low, high = ((shift + side * thickness / 2) / cell for side in (-1, 1))
    area = [measures.swept_area(offset) * cell**2 for offset in (low, high)]
    rate = [measures.swept_area_rate(offset) * cell for offset in (low, high)]
    volume = (measures.swept_volume(high) - measures.swept_volume(low)) * cell**3
    derivatives: dict[str, dict[str, Any]] = {
        "thickness": {"volume": sum(area) / 2, "area": (rate[1] - rate[0]) / 2},
        "offset": {"volume": area[1] - area[0], "area": rate[0] + rate[1]},
        "cell": {},
    }
    stiffness = conductivity = None
    if elastic:
        import_extra("skfem", "derivatives of properties", "simulation")
        mesh, velocities = _move_mesh(surface, cell, thickness, shift, reference)
        found, moved = differentiate_cell(mesh, IsotropicMaterial(youngs_modulus, poisson_ratio), velocities)
        stiffness, conductivity = found.stiffness, found.conductivity
        for name, change in zip(PARAMETERS, moved, strict=False):
            derivatives[name] |= {"stiffness": change.stiffness, "conductivity": change.conductivity}
    for name, value, degree in (
        ("volume", volume, 3),
        ("area", sum(area), 2),
        ("stiffness", stiffness, 0),
        ("conductivity", conductivity, 0),
    ):
        if value is not None:
            by_lengths = thickness * derivatives["thickness"][name] + shift * derivatives["offset"][name]
            derivatives["cell"][name] = (degree * value - by_lengths) / cell
    return DesignDerivatives(volume, sum(area), stiffness, conductivity, derivatives)


def _move_mesh(surface: str, cell: float, thickness: float, shift: float, reference: str) -> tuple[VolumeMesh, Array]:
    """Hexahedra of one cell, and the velocities of nodes by thickness and by offset (2, n, 3)."""
    step = STEP * thickness

    def mesh(thicker: float, higher: float) -> VolumeMesh:
        offset = (shift + higher - (thickness + thicker) / 2, shift + higher + (thickness + thicker) / 2)
        model = lattice(surface, cell=cell, offset=offset, reference=reference, boundary="natural", progress=False)
        found = model.hexahedra(2, CUTS)
        if set(found.periodic) < set("xyz"):
            raise InvalidRequest(f"the hexahedra of the {model.name} do not repeat along x, y and z: no derivatives")
        return found

    velocities = [
        (mesh(*(step * d for d in way)).points - mesh(*(-step * d for d in way)).points) / (2 * step)
        for way in ((1.0, 0.0), (0.0, 1.0))
    ]
    return mesh(0.0, 0.0), np.array(velocities)
