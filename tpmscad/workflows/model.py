"""A result: the solid, the patches it is made of, and its certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest
from tpmscad.workflows.certificate import Certificate

if TYPE_CHECKING:
    from tpmscad.kernel import BuiltSolids


@dataclass(frozen=True, slots=True, eq=False)
class UnitCell:
    """The one cell that a lattice repeats, made when it is asked for, and where its copies stand: (n, 3), model units."""

    make: Callable[[], Brep]
    translations: Array


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A solid with its certificate, in model units (mm in files). `name` becomes the product's name."""

    name: str
    patches: Brep
    certificate: Certificate
    built: BuiltSolids
    cells: UnitCell | None = None

    @property
    def solid(self) -> Any:
        """The build123d Solid, or a Compound where there are several pieces; `.wrapped` is the TopoDS shape."""
        return self.built.solid

    def export_step(self, path: str | Path, *, instanced: bool = False, schema: str = "ap242") -> None:
        """Write the model as STEP, read it back and check it; KernelError if the file does not hold what was written.

        `instanced=True` stores one cell and places it once for each cell of the lattice, as touching solids of an assembly.
        """
        from tpmscad.workflows.lattice_solid import write_checked_model

        if instanced and self.cells is None:
            raise InvalidRequest(f"the {self.name} has no cell that repeats: leave instanced out")
        write_checked_model(self, path, instanced=instanced, schema=schema)
