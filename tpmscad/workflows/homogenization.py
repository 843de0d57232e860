"""`homogenize`: stiffness and conductivity of a lattice that repeats, from a name or a model, with an error by refinement."""

from __future__ import annotations

import time

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import ProgressOption
from tpmscad.errors import InvalidRequest
from tpmscad.public_calls import public
from tpmscad.simulation import HomogenizedProperties, IsotropicMaterial, solve_cell
from tpmscad.stage_timer import StageTimer
from tpmscad.workflows.lattice_solid import lattice
from tpmscad.workflows.model import Model

EDGES_PER_WALL = 1.25
"""Edges of elements in the mean thickness of the wall, on the finer mesh: the error is then some tenths of a percent."""

MAX_SIZE = 0.09
"""Greatest edge on the finer mesh, in cells: curvature, too, has to be resolved where walls are thick."""

REFINEMENT = 1.35
"""Ratio of the sizes of the two meshes."""

POISSON_LIMIT = 0.49
"""Elements of second order lock beyond."""


@public()
def homogenize(
    surface: str | Model,
    *,
    volume_fraction: float | None = None,
    kind: str = "sheet",
    reference: str | None = None,
    youngs_modulus: float = 1.0,
    poisson_ratio: float = 0.3,
    size: float | None = None,
    progress: ProgressOption = None,
) -> HomogenizedProperties:
    """Stiffness and conductivity of a lattice that repeats for ever, on two meshes of the exact cell.

    Parameters
    ----------
    surface : str or Model
        A surface of the catalogue, of which a cell of edge 1 is made; or a model whose box repeats, as one of
        ``tpmscad.lattice(...)`` with whole cells.
    volume_fraction : float, optional
        Volume of the solid over that of the cell; needed with a name, and not taken with a model.
    kind : {"sheet", "skeletal"}, optional
        With a name: as in `tpmscad.lattice`.
    reference : {"minimal", "nodal"}, optional
        With a name: as in `tpmscad.lattice`.
    youngs_modulus : float, optional
        Young's modulus of the solid, in any unit.
    poisson_ratio : float, optional
        Poisson's ratio of the solid, from 0 to 0.49.
    size : float, optional
        Mean edge length of the elements of the finer mesh, model units; the coarser has 1.35 times as long ones. By default
        0.8 of the mean thickness of the wall, and at most 0.09 of the cell.
    progress : callable or bool, optional
        Who shows the progress; see `tpmscad.lattice`.

    Returns
    -------
    HomogenizedProperties
        `stiffness` (6, 6), `conductivity` (3, 3) relative to the solid's, `error`, and what follows from them.

    Raises
    ------
    InvalidRequest
        If gmsh or scikit-fem is not installed (pip install "tpmscad[simulation]"), or the model's box does not repeat.
    KernelError
        If the cell cannot be meshed or solved.

    Notes
    -----
    Second-order tetrahedra on the exact surface, periodic displacements, conjugate gradients with two levels of order.

    Examples
    --------
    >>> found = tpmscad.homogenize("gyroid", volume_fraction=0.2)  # doctest: +SKIP
    >>> found.stiffness[0, 0], found.error  # doctest: +SKIP
    """
    begun = time.process_time()
    import_extra("skfem", "homogenised properties", "simulation")
    if not 0.0 <= poisson_ratio <= POISSON_LIMIT:
        raise InvalidRequest(f"poisson_ratio = {poisson_ratio:g}: it must lie from 0 to {POISSON_LIMIT}")
    stages = StageTimer(progress)
    if isinstance(surface, Model):
        if volume_fraction is not None or kind != "sheet" or reference is not None:
            raise InvalidRequest("a model has its own volume_fraction, kind and reference: leave them out")
        model = surface
    else:
        if volume_fraction is None:
            raise InvalidRequest(f'homogenize("{surface}") needs volume_fraction=, as in volume_fraction=0.2')
        with stages("lattice"):
            model = lattice(
                surface, cell=1.0, volume_fraction=volume_fraction, kind=kind, reference=reference, progress=False
            )
    material = IsotropicMaterial(youngs_modulus, poisson_ratio)
    size = _choose_size(model) if size is None else size
    found = []
    for stage, edge in (("coarse mesh", REFINEMENT * size), ("fine mesh", size)):
        with stages(stage):
            mesh = model.mesh(edge, periodic=True, progress=False)
        missing = ", ".join(sorted(set("xyz") - set(mesh.periodic)))
        if missing:
            raise InvalidRequest(f"the {model.name} does not repeat along {missing}: make a box of whole cells")
        with stages(f"{stage}: solve"):
            found.append(solve_cell(mesh, material))
    coarse, fine = found
    error = max(
        float(np.abs(a - b).max() / np.abs(b).max())
        for a, b in ((coarse.stiffness, fine.stiffness), (coarse.conductivity, fine.conductivity))
    )
    return HomogenizedProperties(
        model.name,
        fine.stiffness,
        fine.conductivity,
        fine.volume_fraction,
        error,
        coarse.stiffness,
        coarse.conductivity,
        youngs_modulus,
        poisson_ratio,
        mesh.n_cells,
        fine.unknowns,
        time.process_time() - begun,
    )


def _choose_size(model: Model) -> float:
    """Edge length of the finer mesh: a part of the mean thickness, twice the volume over the area, or of the cell."""
    low, high = np.array(model.bounding_box)
    cell = float((high - low).min())
    if model.unit_cell is not None:
        cell /= round(len(model.unit_cell.translations) ** (1.0 / 3.0))
    return min(2.0 * model.volume / model.area / EDGES_PER_WALL, MAX_SIZE * cell)
