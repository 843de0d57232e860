"""The results of `lattice`, `solidify` and `infill`: a solid, the patches it is made of, and its certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpmscad import kernel
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest
from tpmscad.workflows.certificate import Certificate
from tpmscad.workflows.checked_write import (
    REREAD_VOLUME_RTOL,
    REREAD_VOLUME_RTOL_OF_BODIES,
    write_checked_brep,
    write_checked_shape,
)


@dataclass(frozen=True, slots=True, eq=False)
class UnitCell:
    """The cell that a lattice repeats, made on demand, and the translations of its copies: (n, 3), model units."""

    make: Callable[[], Brep]
    translations: Array


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A solid with its certificate.

    Attributes
    ----------
    name : str
        Name of the product in files.
    patches : Brep
        The boundary representation in arrays, in model units.
    certificate : Certificate
        What was measured on the solid, and whether it meets the request.
    built : BuiltSolids
        The kernel's solids, and which shells bound them.
    unit_cell : UnitCell or None
        The cell that the solid repeats; None if it repeats none.
    """

    name: str
    patches: Brep
    certificate: Certificate
    built: kernel.BuiltSolids
    unit_cell: UnitCell | None = None

    @property
    def solid(self) -> Any:
        """The build123d Solid, or a Compound if there are several solids."""
        return self.built.solid

    @property
    def wrapped(self) -> Any:
        """The TopoDS shape, under the name that build123d and CadQuery give it."""
        return self.built.shape

    def export_step(self, path: str | Path, *, instanced: bool = False, schema: str = "ap242") -> None:
        """Write the model as a STEP file, read it back without healing and compare the volume.

        Parameters
        ----------
        path : str or Path
            The file to write. It is complete and verified, or absent.
        instanced : bool, optional
            Store one cell and place it once for each cell of the lattice, as touching solids of an assembly.
        schema : {"ap242", "ap214"}, optional
            STEP application protocol.

        Raises
        ------
        InvalidRequest
            If `instanced` is True and the solid repeats no cell.
        KernelError
            If the file does not read back as the valid solid that was written.

        Examples
        --------
        >>> model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
        >>> model.export_step("gyroid.step", instanced=True)
        """
        if not instanced:
            write_checked_brep(
                self.patches, self.built.nesting, path, schema=schema, name=self.name, rtol=REREAD_VOLUME_RTOL
            )
            return
        if self.unit_cell is None:
            raise InvalidRequest(f"the {self.name} has no cell that repeats: leave instanced out")
        cell = self.unit_cell.make()
        write_checked_brep(
            cell,
            kernel.build_solids(cell).nesting,
            path,
            schema=schema,
            name=self.name,
            rtol=REREAD_VOLUME_RTOL,
            placements=kernel.Instances.translated(self.unit_cell.translations),
            n_placements=len(self.unit_cell.translations),
        )


@dataclass(frozen=True, slots=True, eq=False)
class InfillModel(Model):
    """A CAD body filled with a lattice, as a solid with its certificate.

    Attributes
    ----------
    trimmed_by : {"patches", "kernel"}
        "patches" if the lattice was trimmed on the parameter domains of its patches; "kernel" if by a boolean of the kernel,
        as for bodies with faces that are neither planes nor quadrics.
    patches_bound_solid : bool
        Whether `patches` bound the solid. If not (the kernel trimmed, or there is a skin), `patches` are those of the whole
        lattice.
    """

    trimmed_by: str = "kernel"
    patches_bound_solid: bool = False

    def export_step(self, path: str | Path, *, instanced: bool = False, schema: str = "ap242") -> None:
        """Write the filled body as a STEP file, read it back without healing and compare the volume.

        Parameters
        ----------
        path : str or Path
            The file to write. It is complete and verified, or absent.
        instanced : bool, optional
            Must be False: a filled body repeats no cell.
        schema : {"ap242", "ap214"}, optional
            STEP application protocol.

        Raises
        ------
        InvalidRequest
            If `instanced` is True.
        KernelError
            If the file does not read back as the valid solid that was written.
        """
        if instanced:
            raise InvalidRequest(f"the {self.name} has no cell that repeats: leave instanced out")
        if self.patches_bound_solid:
            nesting, rtol = self.built.nesting, REREAD_VOLUME_RTOL_OF_BODIES
            write_checked_brep(self.patches, nesting, path, schema=schema, name=self.name, rtol=rtol)
        else:
            write_checked_shape(self.built.shape, path, schema=schema, name=self.name, volume=self.certificate.volume)
