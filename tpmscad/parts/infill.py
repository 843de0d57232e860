"""A body filled with a lattice: lattice and body, or a skin of the body with the lattice inside, as one certified solid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.kernel import boolean
from tpmscad.kernel.body import Body, read_body
from tpmscad.kernel.offset import hollowed, shrunk
from tpmscad.model import Progress, Stages
from tpmscad.parts.block import Block, field_block, lattice_block
from tpmscad.parts.part import Part, Solids, part_certificate
from tpmscad.patches.complex import Array
from tpmscad.request import lattice_request


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
    reference: str = "minimal",
    phase: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    skin: float | None = None,
    tol: float | None = None,
    progress: Progress | None = None,
) -> Part:
    """The body filled with a lattice of a minimal surface, or with the solid of a field, as a certified solid.

    body: a build123d or CadQuery shape, a TopoDS shape or the path of a STEP file, one closed solid; its own faces stay exact.
    surface: a name, with the keywords of `tpmscad.lattice`, or a field (f < 0 solid) in the body's coordinates, with tol alone.
    The lattice is anchored at the origin of the body's coordinates; rotation turns it there, in degrees about x, then its own
    y, then its own z. skin: thickness of a wall that is kept all around the body, joined to the lattice inside it.

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
        block, name = lattice_block(request, lattice_turn(rotation), read, stages), f"{request.surface} infill"
    else:
        _nothing_else(lattice | {"rotation": rotation})
        block, name = field_block(surface, read, tol, stages), "field infill"
    with stages("trim"):
        solids, notes = filled(block, read, skin)
    with stages("check"):
        certificate = part_certificate(solids, block, notes)
    return Part(name, block.patches, replace(certificate, seconds=dict(stages.seconds)), Solids(solids))


def filled(block: Block, body: Body, skin: float | None) -> tuple[tuple[Any, ...], tuple[str, ...]]:
    """The solids of the filled body, largest first, and what is to be said of them."""
    if skin is None:
        return inside(block, body), ("trimmed by the kernel's boolean",)
    inner = shrunk(body, skin)
    voids = outside(block, inner)
    if not voids:
        raise InvalidRequest(f"the lattice leaves no void within the skin of {skin:g}: nothing is gained by it")
    return (hollowed(body, voids),), ("trimmed by the kernel's boolean", *_void_notes(voids, inner))


def inside(block: Block, body: Body) -> tuple[Any, ...]:
    """The solids of lattice and body; InvalidRequest where they do not meet."""
    solids = boolean.common(block.shape, body.shape)
    if not solids:
        raise InvalidRequest(f"no lattice lies in {body.name}: shift it by phase, or make the cell smaller")
    return solids


def outside(block: Block, body: Body) -> tuple[Any, ...]:
    """The solids of the body without the lattice."""
    return boolean.difference(body.shape, block.shape)


def _void_notes(voids: tuple[Any, ...], inner: Body) -> tuple[str, ...]:
    count = "a channel" if len(voids) == 1 else f"{len(voids)} channels that do not meet"
    return (
        f"the skin closes off {count}: each void is bounded by a shell of its own inside the solid; "
        "bore through the skin to let powder or fluid out",
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
    angles = np.asarray(rotation, float)
    if angles.shape != (3,) or not np.isfinite(angles).all():
        raise InvalidRequest(f"rotation {rotation!r} takes three finite angles in degrees, about x, y and z")
    turn = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
    quarter = np.rint(turn)
    return np.asarray(quarter if np.abs(turn - quarter).max() < 1e-15 else turn)
