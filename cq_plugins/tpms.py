"""Lattices on the CadQuery stack: `import cq_plugins.tpms` adds `tpms`, `struts`, `tpmsInfill` and `tpmsModels` to Workplane.

import cadquery as cq
import cq_plugins.tpms

part = cq.Workplane().tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)
frame = cq.Workplane().struts("octet", cell=10, cells=(2, 2, 2), diameter=1)
filled = cq.Workplane().cylinder(50, 20).tpmsInfill("gyroid", cell=8, thickness=0.8, skin=1.5)
filled.faces(">Z").workplane().hole(4).tpmsModels()[-1].certificate
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated, Any, Literal

from tpmscad.api.arguments import select_arguments
from tpmscad.api.public_calls import validate_method_options
from tpmscad.api.shared_kinds import ANYTHING, FACES, FLAG
from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.kernel_wheels import WITH_CADQUERY, explained_load_failure
from tpmscad.requests.face_selection import is_face_selection
from tpmscad.requests.lattice_options import InfillOptions, LatticeOptions
from tpmscad.requests.lattice_request import lattice_size, size_of_cells
from tpmscad.requests.strut_options import StrutOptions
from tpmscad.results.model import Model
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice
from tpmscad.solids._struts import struts as make_struts

with explained_load_failure("CadQuery", WITH_CADQUERY):
    import cadquery as cq

__all__ = ["struts", "tpms", "tpmsInfill", "tpmsModels"]


def __dir__() -> list[str]:
    return sorted(__all__)


Centered = Annotated[
    bool | tuple[bool, bool, bool],
    ANYTHING,
    "Whether the center of the box of `cells` x `cell` lies on the point, or its lowest corner; per axis.",
]
Combine = Annotated[
    bool | Literal["cut", "a", "s"],
    ANYTHING,
    "As in ``Workplane.box``: lattices are joined to the solid in the chain, if there is one. False leaves them on the stack "
    "by themselves, as they were made.",
]
Clean = Annotated[
    bool,
    FLAG,
    "As in ``Workplane.box``, but False by default: of thousands of patches no two can be merged, and to try takes minutes.",
]


@dataclass(frozen=True)
class WorkplaneLatticeOptions(LatticeOptions):
    """The arguments of `tpms`."""

    _: KW_ONLY
    centered: Centered = False
    combine: Combine = True
    clean: Clean = False


@validate_method_options(WorkplaneLatticeOptions, 'tpms("gyroid", cell=10, cells=(2, 2, 2), thickness=1)')
def tpms(self: cq.Workplane, options: WorkplaneLatticeOptions) -> cq.Workplane:
    """Put a lattice of a minimal surface at each point on the stack, or at the origin of the workplane if there is none.

    The lattice is made once and placed in workplane coordinates.

    Returns
    -------
    Workplane
        With the lattices, or the combined solid, on the stack.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    NotMet
        If the result misses the request; it carries the certificate.

    See Also
    --------
    tpmsModels : The models and certificates behind a chain.

    Examples
    --------
    >>> import cadquery as cq
    >>> lattices = cq.Workplane().rarray(30, 30, 2, 2).tpms("gyroid", cell=10, thickness=1, centered=True)
    """
    _require_combine(options.combine)
    if options.map is not None and any(_per_axis(options.centered)):
        raise InvalidRequest("a mapped lattice lies where the map puts it: leave centered out")
    model = lattice(**select_arguments(options, LatticeOptions))
    size = lattice_size(options)
    return _put_at_points(self, model, size, options.centered, options.combine, clean=options.clean)


@dataclass(frozen=True)
class WorkplaneStrutsOptions(StrutOptions):
    """The arguments of `struts`."""

    _: KW_ONLY
    centered: Centered = False
    combine: Combine = True
    clean: Clean = False


@validate_method_options(WorkplaneStrutsOptions, 'struts("octet", cell=10, cells=(2, 2, 2), diameter=1)')
def struts(self: cq.Workplane, options: WorkplaneStrutsOptions) -> cq.Workplane:
    """Put a lattice of round struts at each point on the stack, or at the origin of the workplane if there is none.

    The lattice is made once and placed in workplane coordinates.

    Returns
    -------
    Workplane
        With the lattices, or the combined solid, on the stack.

    Raises
    ------
    InvalidRequest, NotMet
        As `tpms`.

    See Also
    --------
    tpmsModels : The models and certificates behind a chain.

    Examples
    --------
    >>> import cadquery as cq
    >>> frame = cq.Workplane().struts("octet", cell=10, cells=(2, 2, 2), diameter=1, centered=True)
    """
    _require_combine(options.combine)
    model = make_struts(**select_arguments(options, StrutOptions))
    size = size_of_cells(options.cell, options.cells)
    return _put_at_points(self, model, size, options.centered, options.combine, clean=options.clean)


@dataclass(frozen=True)
class WorkplaneInfillOptions(InfillOptions):
    """The arguments of `tpmsInfill`: those of `infill` in global coordinates, for the solids on the stack."""

    body: Any = field(init=False, default=None)
    solid: int | str | None = field(init=False, default=None)
    box: Sequence[Sequence[float]] | None = field(init=False, default=None)
    _: KW_ONLY
    open_faces: Annotated[
        Any,
        FACES,
        "As in `tpmscad.infill`, for each solid; also any selector of CadQuery, such as ``'>Z[-2] and #X'``.",
    ] = ()
    combine: Annotated[
        bool,
        ANYTHING,
        "Whether the filled solids become one object on the stack, as after ``Workplane.fillet``. False leaves each by itself.",
    ] = True


@validate_method_options(WorkplaneInfillOptions, 'tpmsInfill("gyroid", cell=8, thickness=0.8)')
def tpmsInfill(self: cq.Workplane, options: WorkplaneInfillOptions) -> cq.Workplane:
    """Fill every solid on the stack, or the nearest up the chain, with a lattice.

    Returns
    -------
    Workplane
        With the filled solids on the stack.

    Raises
    ------
    InvalidRequest, NotMet
        As `tpms`.

    See Also
    --------
    tpmsModels : The models and certificates behind a chain.

    Examples
    --------
    >>> import cadquery as cq
    >>> filled = cq.Workplane().box(30, 20, 20).tpmsInfill("gyroid", cell=8, thickness=0.8, skin=1.5, open_faces=">Z")
    """
    combine = options.combine
    if not isinstance(combine, bool):
        raise InvalidRequest(
            f"combine {combine!r} is neither True nor False; to cut or join, go on with .cut() or .union()"
        )
    solids = _find_solids(self)
    if len(solids) > 1 and not (options.keep is None and options.clear is None):
        raise InvalidRequest(
            f"keep and clear are for one solid, and {len(solids)} are on the stack: fill them one at a time"
        )
    keywords = select_arguments(options, InfillOptions)
    models = []
    for solid in solids:
        openings = _faces_of_solid(self, solid, options.open_faces, only=len(solids) == 1)
        models.append(_require_met(infill(**keywords | {"body": solid, "open_faces": openings})))
    filled = [cq.Shape.cast(model.wrapped) for model in models]
    stack = [cq.Compound.makeCompound(filled)] if combine and len(filled) > 1 else filled
    return _with_models(self.newObject(stack), models)


def tpmsModels(self: cq.Workplane) -> tuple[Model, ...]:
    """The models that `tpms`, `struts` and `tpmsInfill` have made in this chain, with their certificates.

    They stay with the chain: selections, booleans and further features keep them.

    Returns
    -------
    tuple of Model
        The first one made first; of a stack of several solids one for each. Empty if the chain has none.

    Examples
    --------
    >>> import cadquery as cq
    >>> part = cq.Workplane().box(30, 20, 20).tpmsInfill("gyroid", cell=8, thickness=0.8).faces(">Z")
    >>> part.tpmsModels()[-1].certificate.met
    True
    """
    found: list[Model] = []
    work: cq.Workplane | None = self
    while work is not None:
        found[:0] = getattr(work, "_tpms_models", ())
        work = work.parent
    return tuple(found)


def _require_combine(combine: Any) -> None:
    """InvalidRequest unless it is a value that ``Workplane.box`` takes."""
    if combine not in (True, False, "cut", "a", "s"):
        raise InvalidRequest(f'combine {combine!r} is none of True, False, "cut", "a" and "s"')


def _per_axis(centered: bool | tuple[bool, bool, bool]) -> tuple[bool, bool, bool]:
    return (centered,) * 3 if isinstance(centered, bool) else centered


def _put_at_points(
    work: cq.Workplane,
    model: Model,
    size: tuple[float, float, float],
    centered: bool | tuple[bool, bool, bool],
    combine: Any,
    *,
    clean: bool,
) -> cq.Workplane:
    """The workplane with the model at every point on its stack, its box of a size centred along the axes that say so."""
    shift = (-length / 2 if half else 0.0 for length, half in zip(size, _per_axis(centered), strict=True))
    shape = cq.Shape.cast(_require_met(model).wrapped).move(cq.Location(cq.Vector(*shift)))
    return _with_models(work.eachpoint(shape, True, combine, clean), [model])


def _with_models(work: cq.Workplane, models: list[Model]) -> cq.Workplane:
    """The workplane, which keeps the models it holds; those made after it have it as an ancestor."""
    work._tpms_models = tuple(models)
    return work


def _find_solids(work: cq.Workplane) -> list[cq.Solid]:
    """The solids on the stack, or those of the nearest solid or compound up the chain."""
    on_stack = [solid for value in work.vals() if isinstance(value, cq.Shape) for solid in value.Solids()]
    if on_stack:
        return on_stack
    try:
        return work.findSolid().Solids()
    except ValueError:
        raise InvalidRequest("the chain holds no solid to fill: make one before tpmsInfill") from None


def _faces_of_solid(work: cq.Workplane, solid: cq.Solid, given: Any, *, only: bool) -> Any:
    """The open faces of one solid: those a selection finds, or those of the given ones that are its own.

    Text that `open_faces` of `tpmscad.infill` does not take is left to CadQuery's selectors.
    """
    if isinstance(given, str) and not is_face_selection(given):
        try:
            found = work.newObject([solid]).faces(given).vals()
        except Exception as error:  # those of the parser belong to a package below CadQuery
            raise InvalidRequest(f'open_faces {given!r} is no selector of faces, such as ">Z" or "|Z"') from error
        if not found:
            raise InvalidRequest(
                f'open_faces {given!r} selects no face of the solid: try another selector, such as ">Z"'
            )
        return found
    if only or isinstance(given, str):
        return given
    own = solid.Faces()
    return [face for face in given if isinstance(face, int | str) or any(face.isSame(other) for other in own)]


def _require_met(model: Model) -> Model:
    """The model; NotMet with its certificate if it misses the request."""
    if not model.certificate.met:
        raise NotMet(
            f"the {model.name} misses the request: {'; '.join(model.certificate.shortfalls)}", model.certificate
        )
    return model


def _register_methods() -> None:
    """Make the functions methods of Workplane; ImportError if another plug-in has taken one of the names."""
    for method in (tpms, struts, tpmsInfill, tpmsModels):
        taken = getattr(cq.Workplane, method.__name__, method)
        if taken.__module__ != __name__:
            raise ImportError(
                f"cadquery.Workplane already has a method {method.__name__}, from {taken.__module__}: "
                "import only one of the two"
            )
    cq.Workplane.tpms = tpms
    cq.Workplane.struts = struts
    cq.Workplane.tpmsInfill = tpmsInfill
    cq.Workplane.tpmsModels = tpmsModels


_register_methods()
