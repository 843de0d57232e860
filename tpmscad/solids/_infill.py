"""A CAD body filled with a lattice, or with the solid of a field, as one certified solid.

Without a skin the result is the intersection of body and lattice. With a skin it is the body without the voids that the lattice
leaves deeper than the skin: the body is offset inwards, the lattice is subtracted from the offset body, and what remains is
subtracted from the body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tpmscad._typing import ProgressOption
from tpmscad.api.public_calls import public
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces
from tpmscad.requests.face_selection import resolve_face_selectors
from tpmscad.requests.keyword_checks import check_finite
from tpmscad.requests.lattice_request import (
    INFILL_DEFAULTS,
    LatticeRequest,
    resolve_lattice_request,
    rotation_matrix,
)
from tpmscad.results.loose_pieces import DroppedPieces, drop_loose_pieces, drop_loose_solids
from tpmscad.results.model import Model
from tpmscad.solids.boolean_strategies import BooleanResult, certify_cut_solids, intersect_body_with_lattice
from tpmscad.solids.lattice_block import build_field_block, build_lattice_block
from tpmscad.solids.reference_distance import field_distance, lattice_distance
from tpmscad.solids.skin import fill_within_skin
from tpmscad.stage_timer import StageTimer

MIN_WALL_THICKNESS = 1e-5
"""Model units: a hundred times the kernel's tolerance, at which the trimmed edges of the two walls are still distinct."""


@public('infill(body, "gyroid", cell=8, thickness=0.8, skin=1.5)')
def infill(
    body: Any,
    surface: str | Field | Callable[..., Any],
    *,
    cell: float | Sequence[float] | None = None,
    thickness: float | None = None,
    offset: float | Sequence[float] | None = None,
    volume_fraction: float | None = None,
    porosity: float | None = None,
    pore_size: float | None = None,
    kind: str = "sheet",
    side: str = "-",
    reference: str | None = None,
    phase: Sequence[float] | None = None,
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    skin: float | None = None,
    open_faces: Iterable[Any] = (),
    loose: str = "drop",
    tol: float | None = None,
    progress: ProgressOption = None,
) -> Model:
    """Fill a CAD body with a lattice of a minimal surface, or with the solid of a field.

    The lattice is anchored at the origin of the body's coordinates. The faces of the body stay exact.

    Parameters
    ----------
    body : shape, str or Path
        One closed solid: a build123d, CadQuery or TopoDS shape, the path of a STEP file, or ``fields.box``, ``fields.sphere`` or
        ``fields.cylinder`` with a height.
    surface : str, Field or callable
        Name of a surface (see ``tpmscad surfaces``), or a field in the body's coordinates that is negative where solid. A field
        takes `tol`, `skin`, `open_faces`, `loose` and `progress` only.
    cell : float or (3,) floats, optional
        Edge length of the cell, or one for each axis, model units. Required for a surface unless `pore_size` is given.
    thickness : float, optional
        Wall thickness along the normal, model units. Give exactly one of `thickness`, `offset`,
        `volume_fraction` and `porosity`.
    offset : float or (float, float), optional
        Signed normal distances of the two sides of the wall, the lower first; one distance for ``kind="skeletal"``. Model units.
    volume_fraction : float, optional
        Solid fraction of the whole cell, between 0 and 1, from which the distances follow.
    porosity : float, optional
        Void fraction of the whole cell, 1 - volume fraction.
    pore_size : float, optional
        Diameter of the largest sphere in the void of the endless lattice, model units; instead of `cell`, which follows from it.
        Of a sheet the larger of the two channels counts; a note of the certificate states both.
    kind : {"sheet", "skeletal"}, optional
        Between two offset surfaces, or on one side of one.
    side : {"-", "+"}, optional
        Solid side of a skeletal lattice: "-" is where the nodal value is negative.
    reference : {"minimal", "nodal"}, optional
        The exact minimal surface (the default if the catalogue has it), or the trigonometric surface of its name.
    phase : (3,) floats, optional
        Shift of the lattice, in cells; none by default.
    rotation : (3,) floats, optional
        Rotation of the lattice about the origin: degrees about x, then about its own y, then about its own z.
    skin : float, optional
        Thickness of a solid wall kept along the body's boundary and joined to the lattice, model units.
    open_faces : iterable, optional
        Plane faces of the body that get no skin, so that powder or fluid can pass: build123d, CadQuery or TopoDS faces of that
        very shape, their numbers in its order, or ">Z" and the like for the faces at one end of an axis; a single one may stand
        alone.
    loose : {"drop", "keep"}, optional
        Whether pieces below 1 % of the largest one's volume are left out or kept. The certificate counts those left out.
    tol : float, optional
        Greatest orthogonal deviation from the surface or the field, model units; by default a thousandth of the cell.
        Required for a field.
    progress : callable or bool, optional
        Called with the name of a stage and the fraction of it that is done. By default work of more than two seconds shows a bar
        in a terminal or a notebook; False shows nothing.

    Returns
    -------
    Model
        The solid and its certificate; `certificate.met` is False if the result misses the request.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    LevelSetError
        If a field cannot be made a solid in the body's box.
    KernelError
        If all methods of trimming fail.

    Examples
    --------
    >>> model = tpmscad.infill("bracket.step", "gyroid", cell=8, thickness=0.8, skin=1.5)  # doctest: +SKIP
    >>> model.export_step("filled.step")  # doctest: +SKIP
    """
    stages = StageTimer(progress)
    given: dict[str, Any] = {
        "cell": cell,
        "thickness": thickness,
        "offset": offset,
        "volume_fraction": volume_fraction,
        "porosity": porosity,
        "pore_size": pore_size,
        "kind": kind,
        "side": side,
        "reference": reference,
        "phase": phase,
    }
    with stages("read"):
        read = read_body(body)
        openings = resolve_open_faces(read, resolve_face_selectors(read, open_faces))
        if openings and skin is None:
            raise InvalidRequest("open_faces are left out of a skin: give skin=, its thickness")
    if isinstance(surface, str):
        given["phase"] = (0.0, 0.0, 0.0) if phase is None else phase
        request = resolve_lattice_request(surface, tol=tol, **given)
        _check_wall_thickness(request)
        turn = rotation_matrix(rotation)
        block, name = build_lattice_block(request, turn, read, stages), f"{request.surface} infill"
        distance = lattice_distance(request, None, turn)
    else:
        _reject_lattice_options(given | {"rotation": rotation})
        block, name = build_field_block(surface, read, tol, stages), "field infill"
        distance = field_distance(surface)
    with stages("trim"):
        if skin is not None:
            result = fill_within_skin(block, read, check_finite("skin", skin), openings)
        else:
            result = intersect_body_with_lattice(block, read)
            if not result.built.n_solids:
                raise InvalidRequest(f"no lattice lies in {read.name}: shift it by phase, or make the cell smaller")
        result, dropped = _drop_loose_solids(result, loose)
    with stages("check"):
        notes = (*read.notes, *result.notes, *dropped.notes)
        certificate = certify_cut_solids(
            block, result.built, checks=result.checks, notes=notes, dropped=dropped.volumes
        )
    return Model(
        name,
        block.patches if result.brep is None else result.brep,
        certificate.with_seconds(stages.seconds),
        result.built,
        trimmed_by=result.method,
        outer_faces="body",
        distance_to_reference=distance,
    )


def _drop_loose_solids(result: BooleanResult, loose: str) -> tuple[BooleanResult, DroppedPieces]:
    """The result without its loose pieces, and what was left out."""
    if result.brep is None:
        solids, dropped = drop_loose_solids(result.solids, loose)
        return replace(result, built=OcctSolids(solids)), dropped
    brep, built, dropped = drop_loose_pieces(result.brep, result.built, loose)
    return replace(result, brep=brep, built=built), dropped


def _check_wall_thickness(request: LatticeRequest) -> None:
    """InvalidRequest if the wall of a sheet is too thin for the kernel to trim."""
    if request.kind == "sheet" and np.ptp(request.offset) < MIN_WALL_THICKNESS:
        raise InvalidRequest(
            f"a wall of {np.ptp(request.offset):g} is thinner than {MIN_WALL_THICKNESS:g}, "
            "a hundred times the kernel's tolerance"
        )


def _reject_lattice_options(given: Mapping[str, Any]) -> None:
    """InvalidRequest for keywords of a lattice together with a field, which defines the whole shape."""
    extra = [name for name, value in given.items() if not _equals(value, INFILL_DEFAULTS[name])]
    if extra:
        raise InvalidRequest(
            f"a field is taken as it is: leave {', '.join(extra)} out, and scale or turn the field itself"
        )


def _equals(value: Any, default: Any) -> bool:
    """Whether a keyword has its default value; sequences may be of any type."""
    return np.array_equal(value, default) if isinstance(default, tuple) else value == default
