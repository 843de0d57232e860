"""A body filled with a lattice: lattice and body, or a skin of the body with the lattice inside, as one certified solid."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.kernel.body import Body, read_body
from tpmscad.kernel.boolean import Solids, betti_numbers
from tpmscad.kernel.hollow import hollowed, open_faces_of
from tpmscad.kernel.offset import shrunk
from tpmscad.model import Progress, Stages
from tpmscad.parts.block import Block, field_block, lattice_block
from tpmscad.parts.cutting import Cut, lattice_in, voids_in
from tpmscad.parts.part import Part, part_certificate
from tpmscad.patches.complex import Array
from tpmscad.request import finite, lattice_request

THINNEST = 1e-5
"""Model units: of walls of a hundred times the kernel's tolerance the trimmed edges are still told apart."""


def infill(
    body: Any,
    surface: str | Field | Callable[..., Any],
    *,
    cell: float | Sequence[float] | None = None,
    thickness: float | None = None,
    offset: float | Sequence[float] | None = None,
    volume_fraction: float | None = None,
    kind: str = "sheet",
    side: str = "-",
    reference: str | None = None,
    phase: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    skin: float | None = None,
    open_faces: Iterable[Any] = (),
    tol: float | None = None,
    progress: Progress | None = None,
) -> Part:
    """The body filled with a lattice of a minimal surface, or with the solid of a field, as a certified solid.

    body: a build123d or CadQuery shape, a TopoDS shape or the path of a STEP file, one closed solid; its own faces stay exact.
    surface: a name, with the keywords of `tpmscad.lattice`, or a field (f < 0 solid) in the body's coordinates, with tol alone.
    The lattice is anchored at the origin of the body's coordinates; rotation turns it there, in degrees about x, then its own
    y, then its own z. skin: thickness of a wall that is kept all around the body, joined to the lattice inside it. open_faces:
    plane faces of the body that stay without skin, so that powder gets out and fluid in: build123d, CadQuery or TopoDS faces of
    that very shape, or their numbers in its order.

    InvalidRequest names what can't be had and what would do; a result that misses the request has certificate.met False.
    """
    stages = Stages(progress)
    lattice: dict[str, Any] = {
        "cell": cell,
        "thickness": thickness,
        "offset": offset,
        "volume_fraction": volume_fraction,
        "kind": kind,
        "side": side,
        "reference": reference,
        "phase": phase,
    }
    with stages("read"):
        read = read_body(body)
    if isinstance(surface, str):
        if cell is None:
            raise InvalidRequest(f"a lattice of the {surface} needs cell=, the edge length of its cell")
        request = lattice_request(surface, cells=1, boundary="box", tol=tol, mapped=False, **lattice)
        if np.ptp(request.offset) < THINNEST and request.kind == "sheet":
            raise InvalidRequest(
                f"a wall of {np.ptp(request.offset):g} is thinner than {THINNEST:g}, a hundred times the kernel's tolerance"
            )
        block, name = lattice_block(request, lattice_turn(rotation), read, stages), f"{request.surface} infill"
    else:
        _nothing_else(lattice | {"rotation": rotation})
        block, name = field_block(surface, read, tol, stages), "field infill"
    with stages("trim"):
        openings = open_faces_of(read, open_faces)
        if skin is None:
            if openings:
                raise InvalidRequest("open_faces are left out of a skin: give skin=, its thickness")
            cut = lattice_in(block, read)
            if not cut.solids:
                raise InvalidRequest(f"no lattice lies in {read.name}: shift it by phase, or make the cell smaller")
        else:
            cut = within_skin(block, read, skin, openings)
    with stages("check"):
        certificate = part_certificate(cut.solids, block, cut.notes)
    patches = block.patches if cut.complex is None else cut.complex
    return Part(
        name,
        patches,
        replace(certificate, seconds=dict(stages.seconds)),
        cut.built,
        trimmed_by=cut.by,
        bounded=cut.complex is not None,
    )


def within_skin(block: Block, body: Body, skin: float, open_faces: Sequence[Any] = ()) -> Cut:
    """The body but for the voids that the lattice leaves in it deeper than the skin.

    They become shells inside one solid, or reach the outside through the open faces.
    """
    skin = finite("skin", skin)
    voids = voids_in(block, shrunk(body, skin, open_faces))
    if not voids.solids:
        raise InvalidRequest(f"the lattice leaves no void within a skin of {skin:g}: the body would stay as it is")
    solids = hollowed(body, voids.solids, open_faces)
    return Cut(Solids(solids), None, voids.by, (*voids.notes, *_closed_off(solids)))


def _closed_off(solids: Sequence[Any]) -> tuple[str, ...]:
    closed = betti_numbers(solids)[2]
    if not closed:
        return ()
    count = "a channel" if closed == 1 else f"{closed} channels that do not meet"
    return (
        f"the skin closes off {count}: each is bounded by a shell of its own inside the solid; "
        "name open_faces, or bore through the skin, to let powder or fluid out",
    )


def _nothing_else(given: dict[str, Any]) -> None:
    """A field says all that a lattice's keywords would."""
    defaults = signature(infill).parameters
    extra = [name for name, value in given.items() if value is not defaults[name].default]
    if extra:
        raise InvalidRequest(
            f"a field is taken as it is: leave {', '.join(extra)} out, and scale or turn the field itself"
        )


def lattice_turn(rotation: Sequence[float]) -> Array:
    """The matrix of rotations about x, then its own y, then its own z, in degrees; quarter turns come out exact."""
    try:
        angles = np.asarray(rotation, float)
    except (TypeError, ValueError):
        angles = np.full(3, np.nan)
    if angles.shape != (3,) or not np.isfinite(angles).all():
        raise InvalidRequest(f"rotation {rotation!r} takes three finite angles in degrees, about x, y and z")
    turn = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
    quarter = np.rint(turn)
    return np.asarray(quarter if np.abs(turn - quarter).max() < 1e-15 else turn)
