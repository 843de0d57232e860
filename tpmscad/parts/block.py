"""The lattice around a body as a closed block, a little larger than the body: what the kernel's boolean takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tpmscad import kernel
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.kernel.body import Body, bounds_of
from tpmscad.kernel.body import moved as moved_shape
from tpmscad.model import Stages
from tpmscad.parts.cover import cover, moved
from tpmscad.patches.complex import Array, PatchComplex
from tpmscad.patches.deviation import Deviation
from tpmscad.patches.joints import Joints, joints
from tpmscad.request import LatticeRequest
from tpmscad.solids import solidify
from tpmscad.trimming import box, trim
from tpmscad.workflows import CUT

FIELD_MARGIN = 0.0137
"""Of the body's extent: how far a field's block reaches beyond the body's box."""

SMOOTH = ("offset+", "offset-")


@dataclass(frozen=True, eq=False)
class Block:
    """The patches that cover a body, in its coordinates and open, and what its certificate will say of them.

    `closed` are those patches cut flat outside the body, `shape` the kernel's solid of them; both made when asked for.
    """

    patches: PatchComplex
    close: Callable[[], PatchComplex]
    tol: float
    deviation: Deviation
    reference: str
    joints: Joints
    bounds: Mapping[str, float]
    figures: Mapping[str, float]
    shortfalls: tuple[str, ...]
    notes: tuple[str, ...]

    @cached_property
    def closed(self) -> PatchComplex:
        return self.close()

    @cached_property
    def built(self) -> kernel.Built:
        return kernel.build(self.closed)

    @property
    def shape(self) -> Any:
        return self.built.shape


def lattice_block(request: LatticeRequest, turn: Array, body: Body, stages: Stages) -> Block:
    """The lattice of a minimal surface around the body; `turn` takes lattice coordinates to the body's."""
    low, high = bounds_of(moved_shape(body.shape, turn.T, np.zeros(3)))
    if (high - low < np.array(request.cell)).all():
        raise InvalidRequest(
            f"{body.name} spans {' x '.join(f'{v:.4g}' for v in high - low)}, less than a cell of "
            f"{' x '.join(f'{v:.4g}' for v in request.cell)}: make the cell smaller"
        )
    with stages("fit") as done:
        around = cover(request, low, high, done)
    with stages("assemble"):
        patches = moved(around.patches, turn, np.zeros(3))
        smooth = joints(patches, SMOOTH)

    def close() -> PatchComplex:
        closed = trim(around.patches, box(around.low, around.high), CUT * max(request.cell)).complex
        return moved(closed, turn, np.zeros(3))

    reference = f"{request.reference} {request.surface} surface"
    return Block(patches, close, request.tol, around.deviation, reference, smooth, around.bounds, {}, (), ())


def field_block(field: Field | Callable[..., Any], body: Body, tol: float | None, stages: Stages) -> Block:
    """The solid of a field in the body's box and a margin around it."""
    if tol is None:
        raise InvalidRequest("the solid of a field needs tol=, its greatest deviation from the field")
    low, high = bounds_of(body.shape)
    margin = FIELD_MARGIN * float((high - low).max())
    model = solidify(field, (low - margin, high + margin), tol=tol, progress=stages.progress)
    stages.seconds.update(model.certificate.seconds)
    found = model.certificate
    return Block(
        model.patches,
        lambda: model.patches,
        tol,
        Deviation(found.max_deviation, found.rms_deviation, found.max_deviation, found.max_deviation),
        found.reference,
        Joints(found.gap, found.tangent_jump_deg, found.curvature_jump, 0),
        found.bounds,
        {name: value for name, value in found.figures.items() if "volume" not in name},  # that is the block's own
        found.shortfalls,
        found.notes,
    )
