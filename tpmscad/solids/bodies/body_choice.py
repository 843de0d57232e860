"""What a body is, asked once: a solid of the kernel, or the solid of a field as patches; and which of its faces get no skin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from tpmscad._typing import BoxCorners
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_body import CadBody, read_bodies
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces
from tpmscad.requests.face_selection import resolve_face_selectors
from tpmscad.solids.bodies.fitted_body import FittedBody, fit_field_body, resolve_field
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.stage_timer import StageTimer

Body = KernelBody | FittedBody


def find_bodies(
    source: Any, box: BoxCorners | None, solid: int | str | None, tol: float, stages: StageTimer, *, is_default: bool
) -> tuple[Body, ...]:
    """The bodies of a CAD file or shape, or that of a mesh or field, fitted within `tol` in a box.

    is_default: see `fit_field_body`. InvalidRequest for a box together with a CAD body, or a number together with a field.
    """
    with stages("read"):
        field = resolve_field(source)
        if field is None:
            if box is not None:
                raise InvalidRequest(
                    "`box` holds the solid of a field or mesh; a CAD body has bounds of its own: leave it out"
                )
            return tuple(map(KernelBody, read_bodies(source, solid)))
    if solid is not None:
        raise InvalidRequest(
            f"solid={solid!r} chooses among the solids of a CAD file; a field or mesh is one body: leave it out"
        )
    found = fit_field_body(field, box, tol, stages, is_default=is_default)
    return (KernelBody(found) if isinstance(found, CadBody) else found,)


def find_body(
    source: Any, box: BoxCorners | None, solid: int | str | None, tol: float, stages: StageTimer, *, is_default: bool
) -> Body:
    """The single body of what `find_bodies` takes."""
    bodies = find_bodies(source, box, solid, tol, stages, is_default=is_default)
    if len(bodies) > 1:
        raise InvalidRequest(
            f"{len(bodies)} solids were chosen, where one body is filled at a time: choose one by its number"
        )
    return bodies[0]


def leave_open(body: Body, faces: Iterable[Any], skin: float | None, stages: StageTimer) -> Body:
    """The body with open faces, given by selectors; InvalidRequest without a skin, or if a body of patches has none to name."""
    if isinstance(body, FittedBody):
        if list(faces):
            raise InvalidRequest(
                f"open_faces are plane faces of a CAD body; {body.name} has none: leave open_faces out, and bore through the skin"
            )
        return body
    with stages("read"):
        opened = resolve_open_faces(body.cad, resolve_face_selectors(body.cad, faces))
    if opened and skin is None:
        raise InvalidRequest("open_faces are faces without a skin, and there is none: give skin=, its thickness")
    return replace(body, open_faces=opened)
