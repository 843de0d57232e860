"""The certificate of a result: every figure measured on the complex and on the kernel's solid, then held against the request."""

from __future__ import annotations

from collections.abc import Mapping

from tpmscad.patches.certificate import Certificate, certificate_of
from tpmscad.patches.complex import PatchComplex
from tpmscad.patches.deviation import Deviation
from tpmscad.patches.joints import joints
from tpmscad.patches.maps import Map
from tpmscad.patches.measure import Moments
from tpmscad.patches.summary import summary
from tpmscad.request import LatticeRequest

GAP, TANGENT_JUMP_DEG, CURVATURE_JUMP = 1e-9, 1e-6, 1e-6
"""Joints of copied patches: gap in cells, tangent jump in degrees, curvature jump over the greatest curvature."""

MAPPED_TANGENT_JUMP_DEG, MAPPED_CURVATURE_JUMP = 1e-4, 1e-4
"""Joints of patches under a map, whose derivatives come from the user's function by differences."""

KERNEL_GAP = 1e-7
"""Model units: where the kernel takes two points for one."""


def lattice_certificate(
    request: LatticeRequest,
    bend: Map | None,
    complex: PatchComplex,
    deviation: Deviation,
    bounds: Mapping[str, float],
    moments: Moments,
    valid: bool,
    notes: tuple[str, ...] = (),
) -> Certificate:
    """Measure and compare; `moments` are those of the complex's faces, `valid` is the kernel's verdict on the built solid,
    `deviation` in model units, `notes` what else is to be told."""
    shape = summary(complex, moments)
    smooth = joints(complex, ("offset+", "offset-"))
    reference = f"{request.reference} {request.surface} surface"
    if bend is not None:
        reference += f" under {bend.name}"
    widest = float(complex.edges.deviation.max(initial=0.0))

    shortfalls = []
    if deviation.max > request.tol:
        shortfalls.append(f"deviation {deviation.max:.3g} exceeds tol {request.tol:g}")
    if not shape.closed:
        shortfalls.append("the faces do not close")
    if not valid:
        shortfalls.append("the kernel's check rejects the solid")
    gap, tangent, curvature = (
        (GAP * request.cell[0], TANGENT_JUMP_DEG, CURVATURE_JUMP)
        if bend is None
        else (KERNEL_GAP, MAPPED_TANGENT_JUMP_DEG, MAPPED_CURVATURE_JUMP)
    )
    for label, value, limit in (
        ("gap", smooth.gap, gap),
        ("tangent jump in degrees", smooth.tangent_jump_deg, tangent),
        ("relative curvature jump", smooth.curvature_jump, curvature),
    ):
        if value > limit:
            shortfalls.append(f"{label} {value:.3g} exceeds {limit:g}")

    return certificate_of(
        complex,
        shape,
        shortfalls,
        notes,
        tol=request.tol,
        max_deviation=deviation.max,
        rms_deviation=deviation.rms,
        reference=reference,
        gap=max(smooth.gap, widest),
        tangent_jump_deg=smooth.tangent_jump_deg,
        curvature_jump=smooth.curvature_jump,
        valid=valid,
        bounds=dict(bounds),
    )
