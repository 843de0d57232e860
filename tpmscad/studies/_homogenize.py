"""`homogenize`: stiffness and conductivity of a lattice that repeats, from a name or a model, with an error by refinement."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from functools import partial

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad.api.public_calls import validate_options
from tpmscad.catalogue import CATALOGUE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.thresholds import rod, sheet
from tpmscad.fields.kinds.volume_fraction_thresholds import threshold_for
from tpmscad.requests.study_options import HomogenizeOptions
from tpmscad.results.model import Model
from tpmscad.simulation.periodic_cell import CellProperties, IsotropicMaterial, solve_cell
from tpmscad.simulation.properties import HomogenizedProperties
from tpmscad.solids._lattice import lattice
from tpmscad.solids._solidify import solidify
from tpmscad.solids._struts import struts
from tpmscad.stage_timer import StageTimer
from tpmscad.strut_cells import KINDS

EDGES_PER_WALL = 1.25
"""Edges of elements in the mean thickness of the wall, on the finer mesh: the error is then some tenths of a percent."""

MAX_SIZE = 0.09
"""Greatest edge on the finer mesh, in cells: curvature, too, has to be resolved where walls are thick."""

FLAT_SIZE, MOST_THICKNESSES = 0.03, 2.0
"""Edge, in cells, at which the finer mesh of a thin wall is fine enough along it, and how many mean thicknesses it may be: a wall
of 0.016 cells then has 30 thousand elements, where those of its thickness would be so many that the factors need 5 GB."""

ELEMENTS_PER_TURN = 10
"""Elements round a strut thinner than FLAT_SIZE, on the finer mesh."""

REFINEMENT = 1.35
"""Ratio of the sizes of the two meshes of tetrahedra."""

REFINEMENTS_OF_HEXAHEDRA = ((2, 1), (3, 1), (4, 1))
"""Cuts of each patch's wall along it and through it: elements are 3 to 5 along a patch, and 2 through the wall."""

ERROR_GOAL = 4e-3
"""Relative error at which hexahedra are not refined further."""

NOT_PERIODIC = (
    "the field has no periods, so it does not repeat: give a periodic field, such as fields.tpms, or a model of whole cells, "
    "such as tpmscad.struts(...)"
)

FIELD_TOL_CELLS = 1e-3
"""Tolerance of the solid of a field, in its shortest period."""

POISSON_LIMIT = 0.49
"""Elements of second order lock beyond."""


@validate_options(HomogenizeOptions, 'homogenize("gyroid", volume_fraction=0.2)')
def homogenize(options: HomogenizeOptions) -> HomogenizedProperties:
    """Compute the stiffness and conductivity of an infinite periodic lattice on refined meshes of its exact cell.

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
    if not 0.0 <= options.poisson_ratio <= POISSON_LIMIT:
        raise InvalidRequest(f"poisson_ratio = {options.poisson_ratio:g}: it must lie from 0 to {POISSON_LIMIT}")
    surface, elements, size = options.surface, options.elements, options.size
    stages, material = StageTimer(options.progress), IsotropicMaterial(options.youngs_modulus, options.poisson_ratio)
    if size is not None and elements == "hexahedra":
        raise InvalidRequest("size is that of tetrahedra: leave it out, or elements")
    wants_tetrahedra = elements == "tetrahedra" or size is not None
    fractions = [name for name in ("volume_fraction", "porosity") if getattr(options, name) is not None]
    if isinstance(surface, Model):
        if fractions or options.kind != "sheet" or options.reference is not None:
            own = ", ".join([*(fractions or ["volume_fraction"]), "kind"])
            raise InvalidRequest(f"a model has its own {own} and reference: leave them out")
        model = surface
    elif isinstance(surface, Field) and not fractions:
        with stages("cell"):
            model = _solidify_period(surface)
    else:
        if len(fractions) != 1:
            here = "both" if fractions else "none of them"
            raise InvalidRequest(f"give exactly one of `volume_fraction`, `porosity`; here: {here}")
        with stages("cell"):
            if isinstance(surface, Field):
                model = _solidify_period(_cut_structure(surface, options))
            elif surface in KINDS and surface not in CATALOGUE:
                model = _make_strut_cell(options)
            else:
                model = _make_cell(options, wants_tetrahedra)
    if not wants_tetrahedra and (elements == "hexahedra" or _repeats_as_hexahedra(model)):
        meshes = [partial(model.hexahedra, 2, refine) for refine in REFINEMENTS_OF_HEXAHEDRA]
    else:
        size, per_turn = _choose_size(model) if size is None else (size, None)
        meshes = [
            partial(
                model.mesh,
                ratio * size,
                periodic=True,
                per_turn=None if per_turn is None else round(per_turn / ratio),
                progress=False,
            )
            for ratio in (REFINEMENT, 1.0)
        ]
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
        options.youngs_modulus,
        options.poisson_ratio,
        mesh.n_cells,
        fine.unknowns,
        time.process_time() - begun,
    )


def _compare(coarse: CellProperties, fine: CellProperties) -> float:
    """Greatest change of stiffness and conductivity, over their greatest entries."""
    pairs = (coarse.stiffness, fine.stiffness), (coarse.conductivity, fine.conductivity)
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in pairs)


def _make_cell(options: HomogenizeOptions, in_box: bool) -> Model:
    """A cell of edge 1: in a box, or with natural boundary where that alone makes hexahedra that repeat."""
    make = partial(
        lattice,
        str(options.surface),
        cell=1.0,
        volume_fraction=options.volume_fraction,
        porosity=options.porosity,
        kind=options.kind,
        reference=options.reference,
        progress=False,
    )
    if not in_box and options.kind == "sheet":
        with suppress(InvalidRequest):  # no natural boundary; what else is wrong is found below
            model = make(boundary="natural")
            if _repeats_as_hexahedra(model):
                return model
    return make()


def _make_strut_cell(options: HomogenizeOptions) -> Model:
    """A cell of struts of edge 1."""
    if options.kind != "sheet" or options.reference is not None:
        raise InvalidRequest(
            f"kind and reference are those of surfaces, not of {options.surface} struts: leave them out"
        )
    return struts(
        str(options.surface),
        cell=1.0,
        volume_fraction=options.volume_fraction,
        porosity=options.porosity,
        progress=False,
    )


def _cut_structure(phi: Field, options: HomogenizeOptions) -> Field:
    """The sheet {|phi| <= c}, or the solid {phi <= c}, that has the volume fraction of the options."""
    if options.reference is not None:
        raise InvalidRequest("reference is that of a name: leave it out, and make the field with it")
    if phi.periods() is None:
        raise InvalidRequest(NOT_PERIODIC)
    fraction = 1.0 - options.porosity if options.porosity is not None else options.volume_fraction
    assert fraction is not None
    kind = "sheet" if options.kind == "sheet" else "rod"
    threshold = threshold_for(phi, fraction, kind)
    return sheet(phi, *threshold) if isinstance(threshold, tuple) else rod(phi, threshold)


def _solidify_period(field: Field) -> Model:
    """The solid of a periodic field in one period from the origin."""
    periods = field.periods()
    if periods is None or 0 in periods:
        raise InvalidRequest(NOT_PERIODIC)
    return solidify(field, ((0.0, 0.0, 0.0), periods), tol=FIELD_TOL_CELLS * min(periods), loose="keep", progress=False)


def _repeats_as_hexahedra(model: Model) -> bool:
    """Whether the model's walls are hexahedra, with no fold, that repeat along all axes."""
    if model.make_spline_volumes is None:
        return False
    try:
        return set("xyz") <= set(model.hexahedra().periodic)
    except InvalidRequest:
        return False


def _choose_size(model: Model) -> tuple[float, int | None]:
    """Edge length of the finer mesh, a part of the mean thickness, twice the volume over the area, or of the cell.

    Thin walls have longer edges than their thickness; then the elements along a turn, which keep thin struts round.
    """
    low, high = np.array(model.bounding_box)
    cell = float((high - low).min())
    if model.unit_cell is not None:
        cell /= round(math.prod(model.unit_cell.counts) ** (1.0 / 3.0))
    thickness = 2.0 * model.volume / model.area
    size = min(thickness / EDGES_PER_WALL, MAX_SIZE * cell)
    flat = min(FLAT_SIZE * cell, MOST_THICKNESSES * thickness)
    return (size, None) if size >= flat else (flat, ELEMENTS_PER_TURN)
