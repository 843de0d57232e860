"""`homogenize`: stiffness and conductivity of a lattice that repeats, from a name or a model, with an error by refinement."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from functools import partial
from typing import Annotated

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import ProgressKeyword
from tpmscad.api.shared_kinds import ANYTHING, FRACTION, NOT_NEGATIVE, POSITIVE, TEXT
from tpmscad.errors import InvalidRequest
from tpmscad.results.model import Model
from tpmscad.simulation.periodic_cell import CellProperties, IsotropicMaterial, solve_cell
from tpmscad.simulation.properties import HomogenizedProperties
from tpmscad.solids._lattice import lattice
from tpmscad.stage_timer import StageTimer

EDGES_PER_WALL = 1.25
"""Edges of elements in the mean thickness of the wall, on the finer mesh: the error is then some tenths of a percent."""

MAX_SIZE = 0.09
"""Greatest edge on the finer mesh, in cells: curvature, too, has to be resolved where walls are thick."""

REFINEMENT = 1.35
"""Ratio of the sizes of the two meshes of tetrahedra."""

REFINEMENTS_OF_HEXAHEDRA = ((2, 1), (3, 1), (4, 1))
"""Cuts of each patch's wall along it and through it: elements are 3 to 5 along a patch, and 2 through the wall."""

ERROR_GOAL = 4e-3
"""Relative error at which hexahedra are not refined further."""

POISSON_LIMIT = 0.49
"""Elements of second order lock beyond."""


@validate_call()
def homogenize(
    surface: Annotated[
        str | Model,
        TEXT.or_else(ANYTHING),
        "A surface of the catalogue, of which a cell of edge 1 is made; or a model whose box repeats, as one of "
        "``tpmscad.lattice(...)`` with whole cells.",
    ],
    *,
    volume_fraction: Annotated[
        float | None,
        FRACTION,
        "Volume of the solid over that of the cell; needed with a name, and not taken with a model.",
    ] = None,
    kind: Annotated[str, choice_of("sheet", "skeletal"), "With a name: as in `tpmscad.lattice`."] = "sheet",
    reference: Annotated[
        str | None, TEXT.described_as(example='"nodal"'), "With a name: as in `tpmscad.lattice`."
    ] = None,
    youngs_modulus: Annotated[
        float, POSITIVE.described_as(example="1.0"), "Young's modulus of the solid, in any unit."
    ] = 1.0,
    poisson_ratio: Annotated[
        float, NOT_NEGATIVE.described_as(example="0.3"), "Poisson's ratio of the solid, from 0 to 0.49."
    ] = 0.3,
    elements: Annotated[
        str | None,
        choice_of("hexahedra", "tetrahedra"),
        "Hexahedra straight from the patches (see `Model.hexahedra`), which need fewer unknowns, have the symmetry of "
        "the cell and need no gmsh, where the lattice is one of whole walls; tetrahedra of gmsh else. By default "
        "hexahedra where possible.",
    ] = None,
    size: Annotated[
        float | None,
        POSITIVE.described_as(example="0.05"),
        "Mean edge length of the tetrahedra of the finer mesh, model units; the coarser has 1.35 times as long ones. "
        "By default 0.8 of the mean thickness of the wall, and at most 0.09 of the cell.",
    ] = None,
    progress: ProgressKeyword = None,
) -> HomogenizedProperties:
    """Stiffness and conductivity of a lattice that repeats for ever, on meshes of the exact cell that are refined.

    Returns
    -------
    HomogenizedProperties
        `stiffness` (6, 6), `conductivity` (3, 3) relative to the solid's, `error`, and what follows from them.

    Raises
    ------
    InvalidRequest
        If scikit-fem, or gmsh where it is needed, is not installed (pip install "tpmscad[simulation]"), or the model does not
        repeat.
    KernelError
        If the cell cannot be meshed or solved.

    Notes
    -----
    Second-order elements on the exact surface, periodic displacements, conjugate gradients with two levels of order.

    Examples
    --------
    >>> found = tpmscad.homogenize("gyroid", volume_fraction=0.2)  # doctest: +SKIP
    >>> found.stiffness[0, 0], found.error  # doctest: +SKIP
    """
    begun = time.process_time()
    import_extra("skfem", "homogenised properties", "simulation")
    if not 0.0 <= poisson_ratio <= POISSON_LIMIT:
        raise InvalidRequest(f"poisson_ratio = {poisson_ratio:g}: it must lie from 0 to {POISSON_LIMIT}")
    stages, material = StageTimer(progress), IsotropicMaterial(youngs_modulus, poisson_ratio)
    if size is not None and elements == "hexahedra":
        raise InvalidRequest("size is that of tetrahedra: leave it out, or elements")
    wants_tetrahedra = elements == "tetrahedra" or size is not None
    if isinstance(surface, Model):
        if volume_fraction is not None or kind != "sheet" or reference is not None:
            raise InvalidRequest("a model has its own volume_fraction, kind and reference: leave them out")
        model = surface
    else:
        if volume_fraction is None:
            raise InvalidRequest(f'homogenize("{surface}") needs volume_fraction=, as in volume_fraction=0.2')
        with stages("lattice"):
            model = _make_cell(surface, volume_fraction, kind, reference, wants_tetrahedra)
    if not wants_tetrahedra and (elements == "hexahedra" or _repeats_as_hexahedra(model)):
        meshes = [partial(model.hexahedra, 2, refine) for refine in REFINEMENTS_OF_HEXAHEDRA]
    else:
        size = _choose_size(model) if size is None else size
        meshes = [partial(model.mesh, edge, periodic=True, progress=False) for edge in (REFINEMENT * size, size)]
    found = []
    for number, make in enumerate(meshes, 1):
        stage = f"mesh {number}"
        with stages(stage):
            mesh = make()
        missing = ", ".join(sorted(set("xyz") - set(mesh.periodic)))
        if missing:
            raise InvalidRequest(f"the {model.name} does not repeat along {missing}: make a box of whole cells")
        with stages(f"{stage}: solve"):
            found.append(solve_cell(mesh, material))
        if len(found) > 1 and _compare(*found[-2:]) < ERROR_GOAL:
            break
    coarse, fine = found[-2:]
    return HomogenizedProperties(
        model.name,
        fine.stiffness,
        fine.conductivity,
        fine.volume_fraction,
        _compare(coarse, fine),
        coarse.stiffness,
        coarse.conductivity,
        youngs_modulus,
        poisson_ratio,
        mesh.n_cells,
        fine.unknowns,
        time.process_time() - begun,
    )


def _compare(coarse: CellProperties, fine: CellProperties) -> float:
    """Greatest change of stiffness and conductivity, over their greatest entries."""
    pairs = (coarse.stiffness, fine.stiffness), (coarse.conductivity, fine.conductivity)
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in pairs)


def _make_cell(surface: str, volume_fraction: float, kind: str, reference: str | None, in_box: bool) -> Model:
    """A cell of edge 1: in a box, or with natural boundary where that alone makes hexahedra that repeat."""
    make = partial(
        lattice, surface, cell=1.0, volume_fraction=volume_fraction, kind=kind, reference=reference, progress=False
    )
    if not in_box and kind == "sheet":
        with suppress(InvalidRequest):  # no natural boundary; what else is wrong is found below
            model = make(boundary="natural")
            if _repeats_as_hexahedra(model):
                return model
    return make()


def _repeats_as_hexahedra(model: Model) -> bool:
    """Whether the model's walls are hexahedra, with no fold, that repeat along all axes."""
    if model.make_spline_volumes is None:
        return False
    try:
        return set("xyz") <= set(model.hexahedra().periodic)
    except InvalidRequest:
        return False


def _choose_size(model: Model) -> float:
    """Edge length of the finer mesh: a part of the mean thickness, twice the volume over the area, or of the cell."""
    low, high = np.array(model.bounding_box)
    cell = float((high - low).min())
    if model.unit_cell is not None:
        cell /= round(math.prod(model.unit_cell.counts) ** (1.0 / 3.0))
    return min(2.0 * model.volume / model.area / EDGES_PER_WALL, MAX_SIZE * cell)
