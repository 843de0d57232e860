"""Effective properties of a cell, with their error, and what follows from them: engineering constants, bounds, material cards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import PATH, POINTS
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.file_suffixes import MATERIAL_SUFFIXES
from tpmscad.result_display import format_html_table
from tpmscad.simulation.periodic_cell import VOIGT, IsotropicMaterial


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HomogenizedProperties:
    """Properties of the homogeneous material that acts like a cell that repeats.

    Attributes
    ----------
    name : str
        Name of the structure.
    stiffness : (6, 6) array
        Stiffness in Voigt's order 11, 22, 33, 23, 13, 12 with engineering shear, in the unit of `youngs_modulus`.
    conductivity : (3, 3) array
        Conductivity, relative to that of the solid.
    volume_fraction : float
        Volume of the solid over that of the cell.
    error : float
        Estimated relative error: the greatest change of stiffness and conductivity, over their greatest entries, by the last
        refinement of the mesh. Finite elements of exact geometry are too stiff, never too soft.
    coarse_stiffness, coarse_conductivity : arrays
        The same on the coarser mesh.
    youngs_modulus, poisson_ratio : float
        Constants of the solid.
    cells, unknowns : int
        Elements, and unknown displacements, of the finer mesh.
    seconds : float
        CPU time of the whole.

    Notes
    -----
    Engineering constants are those along the axes of the cell.
    """

    name: str
    stiffness: Array
    conductivity: Array
    volume_fraction: float
    error: float
    coarse_stiffness: Array
    coarse_conductivity: Array
    youngs_modulus: float
    poisson_ratio: float
    cells: int
    unknowns: int
    seconds: float

    @property
    def compliance(self) -> Array:
        """Compliance (6, 6), the inverse of the stiffness."""
        return np.asarray(np.linalg.inv(self.stiffness))

    @property
    def engineering_constants(self) -> dict[str, float]:
        """Young's moduli E1 to E3, Poisson's ratios nu12, nu13, nu23, and shear moduli G12, G13, G23 along the axes."""
        s = self.compliance
        found = {f"E{i + 1}": 1.0 / s[i, i] for i in range(3)}
        found |= {f"nu{i + 1}{j + 1}": -s[i, j] / s[i, i] for i, j in ((0, 1), (0, 2), (1, 2))}
        found |= {name: 1.0 / s[k, k] for name, k in (("G12", 5), ("G13", 4), ("G23", 3))}
        return {key: float(value) for key, value in found.items()}

    @property
    def cubic_constants(self) -> tuple[float, float, float]:
        """C11, C12 and C44 of the nearest stiffness of cubic symmetry."""
        c = self.stiffness
        return (
            float(np.diag(c)[:3].mean()),
            float((c[0, 1] + c[0, 2] + c[1, 2]) / 3.0),
            float(np.diag(c)[3:].mean()),
        )

    @property
    def cubic_deviation(self) -> float:
        """Greatest difference of the stiffness from the nearest one of cubic symmetry, over C11."""
        c11, c12, c44 = self.cubic_constants
        cubic = np.diag([c11 - c12] * 3 + [c44] * 3)
        cubic[:3, :3] += c12
        return float(np.abs(self.stiffness - cubic).max() / c11)

    @property
    def zener_ratio(self) -> float:
        """2 C44 / (C11 - C12): 1 if the stiffness is the same in all directions."""
        c11, c12, c44 = self.cubic_constants
        return 2.0 * c44 / (c11 - c12)

    @property
    def bulk_modulus(self) -> float:
        """Bulk modulus under uniform strain, in the unit of `youngs_modulus`."""
        return float(self.stiffness[:3, :3].sum() / 9.0)

    @property
    def hashin_shtrikman_ratio(self) -> float:
        """Bulk modulus over the upper bound of Hashin and Shtrikman for a porous isotropic solid."""
        first, shear = IsotropicMaterial(self.youngs_modulus, self.poisson_ratio).lame
        bulk, rho = first + 2.0 * shear / 3.0, self.volume_fraction
        return self.bulk_modulus / (4.0 * shear * bulk * rho / (4.0 * shear + 3.0 * bulk * (1.0 - rho)))

    @property
    def conductivity_ratio(self) -> float:
        """Mean conductivity over the upper bound of Hashin and Shtrikman."""
        rho = self.volume_fraction
        return float(np.trace(self.conductivity) / 3.0 / (2.0 * rho / (3.0 - rho)))

    @validate_call()
    def directional_modulus(self, directions: Annotated[Any, POINTS, "Directions of any length but 0."]) -> Array:
        """Young's modulus under tension along directions.

        Returns
        -------
        (...) array
            Young's moduli, in the unit of `youngs_modulus`.

        Examples
        --------
        >>> found = tpmscad.homogenize("gyroid", volume_fraction=0.2)  # doctest: +SKIP
        >>> found.directional_modulus([[1, 0, 0], [1, 1, 1]])  # doctest: +SKIP
        """
        unit = np.asarray(directions, float)
        unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
        stress = np.stack([unit[..., a] * unit[..., b] for a, b in VOIGT], axis=-1)
        return np.asarray(1.0 / np.einsum("...i,ij,...j", stress, self.compliance, stress))

    def to_dict(self) -> dict[str, Any]:
        """All figures as plain values, ready for JSON. The attributes, engineering constants and ratios by their names."""
        c11, c12, c44 = self.cubic_constants
        return {
            "name": self.name,
            "volume_fraction": self.volume_fraction,
            "youngs_modulus": self.youngs_modulus,
            "poisson_ratio": self.poisson_ratio,
            "stiffness": self.stiffness.tolist(),
            "conductivity": self.conductivity.tolist(),
            "error": self.error,
            "C11": c11,
            "C12": c12,
            "C44": c44,
            "cubic_deviation": self.cubic_deviation,
            **self.engineering_constants,
            "zener_ratio": self.zener_ratio,
            "bulk_modulus": self.bulk_modulus,
            "hashin_shtrikman_ratio": self.hashin_shtrikman_ratio,
            "conductivity_ratio": self.conductivity_ratio,
            "cells": self.cells,
            "unknowns": self.unknowns,
            "seconds": self.seconds,
        }

    @validate_call()
    def write(
        self,
        path: Annotated[
            str | Path,
            PATH,
            "``.inp``: the anisotropic stiffness and the conductivity as a material of Abaqus and CalculiX. ``.csv``: "
            "every figure, a line for each.",
        ],
    ) -> None:
        """Write a material card.

        Examples
        --------
        >>> tpmscad.homogenize("gyroid", volume_fraction=0.2).write("gyroid.inp")  # doctest: +SKIP
        """
        target = validate_output_path(path, MATERIAL_SUFFIXES)
        text = self._format_card() if target.suffix.lower() == ".inp" else self._format_table()
        with atomic_write(target) as aside:
            aside.write_text(text, encoding="utf-8", newline="\n")

    def _format_card(self) -> str:
        """The material of CalculiX: 21 constants in the order D1111, D1122, D2222, ..., whose shears are 12, 13, 23."""
        order = [0, 1, 2, 5, 4, 3]
        c = self.stiffness[np.ix_(order, order)]
        constants = [f"{c[i, j]:.9g}" for j in range(6) for i in range(j + 1)]
        k = self.conductivity
        heat = [f"{k[i, j]:.9g}" for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
        name = "".join(letter if letter.isalnum() else "_" for letter in self.name).upper()
        lines = [
            f"** {self.name}, volume fraction {self.volume_fraction:.6g}, relative error {self.error:.1e}",
            f"** solid: E = {self.youngs_modulus:g}, nu = {self.poisson_ratio:g}, conductivity 1",
            f"*MATERIAL, NAME={name}",
            "*ELASTIC, TYPE=ANISO",
            ", ".join(constants[:8]) + ",",
            ", ".join(constants[8:16]) + ",",
            ", ".join(constants[16:]) + ", 293.",
            "*CONDUCTIVITY, TYPE=ANISO",
            ", ".join(heat) + ", 293.",
        ]
        return "\n".join(lines) + "\n"

    def _format_table(self) -> str:
        """Every figure as "name,value"."""
        lines = ["quantity,value"]
        for key, value in self.to_dict().items():
            if isinstance(value, list):
                lines += [f"{key}_{i + 1}{j + 1},{x!r}" for i, row in enumerate(value) for j, x in enumerate(row)]
            else:
                lines.append(f"{key},{value}")
        return "\n".join(lines) + "\n"

    def __repr__(self) -> str:
        c11, c12, c44 = self.cubic_constants
        constants = self.engineering_constants
        k = np.diag(self.conductivity)
        return (
            f"{self.name}, volume fraction {self.volume_fraction:.4f}, of a solid with E = {self.youngs_modulus:g}, "
            f"nu = {self.poisson_ratio:g}\n"
            f"C11 {c11:.5g}, C12 {c12:.5g}, C44 {c44:.5g}, cubic within {self.cubic_deviation:.1e}\n"
            f"E {constants['E1']:.5g}, nu {constants['nu12']:.4f}, G {constants['G12']:.5g}, Zener ratio {self.zener_ratio:.4f}\n"
            f"K {self.bulk_modulus:.5g}, {self.hashin_shtrikman_ratio:.4f} of the Hashin-Shtrikman bound\n"
            f"conductivity {k.mean():.5g} of the solid's, {self.conductivity_ratio:.4f} of the Hashin-Shtrikman bound\n"
            f"relative error {self.error:.1e}, {self.cells} elements, {self.unknowns} unknowns, {self.seconds:.0f} s"
        )

    def _repr_html_(self) -> str:
        head, *lines = str(self).splitlines()
        axes = ["xyz"[a] + "xyz"[b] for a, b in VOIGT]
        rows = [(axis, *row) for axis, row in zip(axes, self.stiffness, strict=True)]
        return format_html_table(head, rows, ("stiffness", *axes)) + format_html_table(
            "", [("", line) for line in lines]
        )
