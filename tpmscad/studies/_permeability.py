"""`permeability`: how well a channel that repeats lets a slow viscous flow through, on meshes that are refined."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import ProgressKeyword
from tpmscad.api.shared_kinds import ANYTHING, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.result_display import format_html_table
from tpmscad.results.model import Model
from tpmscad.simulation.permeability import permeability as solve_flow
from tpmscad.stage_timer import StageTimer

SIZE_IN_CELLS = 0.1
"""Mean edge of the tetrahedra of the finer mesh: at porosity 1/2 the error is then 1 %."""

REFINEMENT = 1.35
"""Ratio of the sizes of the two meshes."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ChannelPermeability:
    """What meshes of a channel give.

    Attributes
    ----------
    name : str
        Name of the channel.
    permeability : (3, 3) array
        Mean velocity over the whole cell times viscosity over the pressure gradient, squares of the model's unit (mm2).
    coarse_permeability : (3, 3) array
        The same on the coarser mesh.
    porosity : float
        Volume of the channel over that of the box.
    cells : int
        Elements of the finer mesh.
    seconds : float
        CPU time of the whole.
    """

    name: str
    permeability: Array
    coarse_permeability: Array
    porosity: float
    cells: int
    seconds: float

    @property
    def error(self) -> float:
        """Greatest change by the last refinement over the greatest entry; the finer value is too small, as a rule."""
        return float(np.abs(self.permeability - self.coarse_permeability).max() / np.abs(self.permeability).max())

    def to_dict(self) -> dict[str, Any]:
        """All figures as plain values, ready for JSON.

        The attributes and `error` by their names; permeabilities are in squares of the model's unit (mm2).
        """
        values = asdict(self) | {"error": self.error}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}

    def __repr__(self) -> str:
        rows = ("  ".join(f"{value:12.5g}" for value in row) for row in self.permeability)
        return "\n".join(
            [
                f"{self.name}, a channel of porosity {self.porosity:.4f}",
                *(f"{label}{row}" for label, row in zip(("permeability", *[" " * 12] * 2), rows, strict=True)),
                f"mm2; mean of the axes {np.trace(self.permeability) / 3.0:.5g} mm2",
                f"relative error {self.error:.1e}, {self.cells} elements, {self.seconds:.0f} s",
            ]
        )

    def _repr_html_(self) -> str:
        caption = f"{self.name}: permeability, mm2, relative error {self.error:.1e}"
        return format_html_table(caption, [(axis, *row) for axis, row in zip("xyz", self.permeability, strict=True)])


@validate_call()
def permeability(
    channel: Annotated[
        Model,
        ANYTHING,
        'The fluid itself, in a box of whole cells: ``tpmscad.lattice(..., kind="skeletal")`` is one side of a surface. '
        'The channel beside a sheet of thickness t has ``side="-"`` and ``offset=-t/2``, or ``side="+"`` and ``offset=t/2``.',
    ],
    *,
    size: Annotated[
        float | None,
        POSITIVE.described_as(example="0.8"),
        "Mean edge length of the tetrahedra of the finer mesh, model units; edges of the coarser mesh are 1.35 times as long. "
        "By default a tenth of the shortest edge of the box.",
    ] = None,
    progress: ProgressKeyword = None,
) -> ChannelPermeability:
    """Compute the permeability of an infinite periodic channel for slow viscous flow.

    Returns
    -------
    ChannelPermeability
        `permeability` (3, 3) in mm2, and its `error`.

    Raises
    ------
    InvalidRequest
        If scikit-fem or gmsh is not installed (pip install "tpmscad[simulation]"), or the model does not repeat.
    KernelError
        If the channel cannot be meshed, or the flow cannot be solved.

    Notes
    -----
    Taylor-Hood elements on the exact surface, where the fluid is at rest. The pressure drop of a flow of mean velocity v over the
    length L is viscosity * v * L / permeability while inertia does not count, at Reynolds numbers below about 1.

    Examples
    --------
    >>> channel = tpmscad.lattice("gyroid", cell=10, volume_fraction=0.5, kind="skeletal")  # doctest: +SKIP
    >>> tpmscad.permeability(channel).permeability[0, 0]  # doctest: +SKIP
    """
    begun = time.process_time()
    import_extra("skfem", "permeability", "simulation")
    if not isinstance(channel, Model):
        raise InvalidRequest(
            f'channel: a {type(channel).__name__} is no model; make one by tpmscad.lattice(..., kind="skeletal")'
        )
    stages = StageTimer(progress)
    low, high = np.array(channel.bounding_box)
    size = SIZE_IN_CELLS * float((high - low).min()) if size is None else size
    found = []
    for number, edge in enumerate((REFINEMENT * size, size), 1):
        with stages(f"mesh {number}"):
            mesh = channel.mesh(edge, periodic=True, progress=False)
        missing = ", ".join(sorted(set("xyz") - set(mesh.periodic)))
        if missing:
            raise InvalidRequest(f"the {channel.name} does not repeat along {missing}: make a box of whole cells")
        with stages(f"mesh {number}: solve"):
            found.append(solve_flow(mesh))
    coarse, fine = found
    porosity = channel.volume / float(np.prod(high - low))
    return ChannelPermeability(channel.name, fine, coarse, porosity, mesh.n_cells, time.process_time() - begun)
