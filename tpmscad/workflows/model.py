"""A result: the solid, the patches it is made of, and its certificate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tpmscad._typing import Array, Progress
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


@dataclass(slots=True)
class StageTimer:
    """Times the stages of a piece of work and reports them as they begin and end."""

    progress: Progress | None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[Callable[[float], None]]:
        begun = time.perf_counter()
        report = self.progress or (lambda stage, done: None)
        report(stage, 0.0)
        try:
            yield lambda done: report(stage, done)
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begun
        report(stage, 1.0)
