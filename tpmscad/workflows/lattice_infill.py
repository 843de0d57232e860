"""What comes of filling a body: a model of kernel solids, with the patches it is made of.

A body filled with a lattice: lattice and body, or a skin of the body with the lattice inside, as one certified solid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tpmscad import kernel
from tpmscad._typing import Array, Progress
from tpmscad.brep.solid_properties import SolidPiece, SolidProperties
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.kernel.boolean.boolean_operations import KernelSolids, betti_numbers
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces, subtract_voids
from tpmscad.kernel.boolean.inward_offset import offset_inward
from tpmscad.kernel.measure.cad_body import CadBody, read_body
from tpmscad.kernel.occt.bounding_boxes import bounding_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.stage_timer import StageTimer
from tpmscad.workflows.boolean_strategies import BooleanResult, intersect_body_with_lattice, subtract_lattice_from_body
from tpmscad.workflows.certificate import Certificate, build_certificate
from tpmscad.workflows.lattice_block import LatticeBlock, build_field_block, build_lattice_block
from tpmscad.workflows.lattice_request import check_finite, resolve_lattice_request
from tpmscad.workflows.lattice_solid import make_volume_check, write_checked_model
from tpmscad.workflows.model import Model

REREAD_VOLUME_RTOL_OF_BODIES = 1e-7
"""Relative: how far the volume of a file that was read back may be from what was written, faces of the body included."""


@dataclass(frozen=True, slots=True, eq=False)
class InfillModel(Model):
    """A body with a lattice in it.

    `trimmed_by` is "patches" or "kernel", the latter where the body has faces that are neither plane nor quadric. `patches`
    bound the solid where they were trimmed and there is no skin (`bounded`); else they are the lattice's, whole.
    """

    trimmed_by: str = "kernel"
    patches_bound_solid: bool = False
    """Whether `patches` bound the solid."""

    @property
    def wrapped(self) -> Any:
        """The TopoDS shape, by the name that build123d and CadQuery give it."""
        return self.built.shape

    def export_step(self, path: str | Path, *, instanced: bool = False, schema: str = "ap242") -> None:
        """Write the part as STEP, read it back and check it; KernelError if the file does not hold what was written."""
        if instanced:
            raise InvalidRequest(f"the {self.name} has no cell that repeats: leave instanced out")
        if self.patches_bound_solid:
            write_checked_model(self, path, instanced=False, schema=schema, stored_volume=REREAD_VOLUME_RTOL_OF_BODIES)
        else:
            write_checked_shape(self.built.shape, path, schema=schema, name=self.name, volume=self.certificate.volume)


def write_checked_shape(
    shape: Any, path: str | Path, *, schema: str, name: str, volume: float, names: Iterable[str] = ()
) -> None:
    """Write a kernel shape as STEP; the file is there whole and read back as what was written, or not at all."""
    verify = make_volume_check(volume, REREAD_VOLUME_RTOL_OF_BODIES)
    kernel.write_shape(shape, path, schema=schema, name=name, verify=verify, names=tuple(names))


def certify_kernel_solids(solids: tuple[Any, ...], block: LatticeBlock, notes: tuple[str, ...]) -> Certificate:
    """Measure kernel solids and hold them against the request; the block knows what was measured on the lattice's patches."""
    tol, deviation, smooth = block.tol, block.deviation, block.joints
    report = kernel.check_shape(make_compound(solids))
    shortfalls = list(block.shortfalls)
    for wrong, what in (
        (deviation.max > tol, f"deviation {deviation.max:.3g} exceeds tol {tol:g}"),
        (not report.closed, "the faces do not close"),
        (not report.valid, "the kernel's check rejects the solid"),
        (not report.outward, "a solid is inside out"),
        (
            report.max_tolerance > tol,
            f"the kernel's edges are open by up to {report.max_tolerance:.3g}, more than tol {tol:g}",
        ),
    ):
        if wrong:
            shortfalls.append(what)
    found = build_certificate(
        block.patches,
        SolidProperties(
            report.closed,
            report.volume,
            report.area,
            report.centroid,
            betti_numbers(solids),
            _pieces_of_solids(solids, report),
        ),
        shortfalls,
        (*block.notes, *notes),
        tol=tol,
        max_deviation=deviation.max,
        rms_deviation=deviation.rms,
        reference=block.reference,
        gap=max(smooth.gap, report.max_tolerance),
        tangent_jump_deg=smooth.tangent_jump_deg,
        curvature_jump=smooth.curvature_jump,
        valid=report.valid,
        bounds=dict(block.bounds),
        figures=dict(block.figures),
    )
    return replace(found, n_faces=report.faces)


def _pieces_of_solids(solids: tuple[Any, ...], report: kernel.ShapeReport) -> tuple[SolidPiece, ...]:
    """Each solid's volume and middle; of an only one the centroid, which costs nothing."""
    if len(solids) == 1:
        return (SolidPiece(report.volume, report.centroid),)
    middles = [np.mean(bounding_box(solid), axis=0).tolist() for solid in solids]
    return tuple(SolidPiece(volume, (x, y, z)) for volume, (x, y, z) in zip(report.volumes, middles, strict=True))


MIN_WALL_THICKNESS = 1e-5
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
) -> InfillModel:
    """The body filled with a lattice of a minimal surface, or with the solid of a field, as a certified solid.

    body: a build123d or CadQuery shape, a TopoDS shape or the path of a STEP file, one closed solid; its own faces stay exact.
    surface: a name, with the keywords of `tpmscad.lattice`, or a field (f < 0 solid) in the body's coordinates, with tol alone.
    The lattice is anchored at the origin of the body's coordinates; rotation turns it there, in degrees about x, then its own
    y, then its own z. skin: thickness of a wall that is kept all around the body, joined to the lattice inside it. open_faces:
    plane faces of the body that stay without skin, so that powder gets out and fluid in: build123d, CadQuery or TopoDS faces of
    that very shape, or their numbers in its order.

    InvalidRequest names what can't be had and what would do; a result that misses the request has certificate.met False.
    """
    stages = StageTimer(progress)
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
        request = resolve_lattice_request(surface, cells=1, boundary="box", tol=tol, mapped=False, **lattice)
        if np.ptp(request.offset) < MIN_WALL_THICKNESS and request.kind == "sheet":
            raise InvalidRequest(
                f"a wall of {np.ptp(request.offset):g} is thinner than {MIN_WALL_THICKNESS:g}, "
                "a hundred times the kernel's tolerance"
            )
        block, name = build_lattice_block(request, rotation_matrix(rotation), read, stages), f"{request.surface} infill"
    else:
        _reject_lattice_options(lattice | {"rotation": rotation})
        block, name = build_field_block(surface, read, tol, stages), "field infill"
    with stages("trim"):
        openings = resolve_open_faces(read, open_faces)
        if skin is None:
            if openings:
                raise InvalidRequest("open_faces are left out of a skin: give skin=, its thickness")
            cut = intersect_body_with_lattice(block, read)
            if not cut.solids:
                raise InvalidRequest(f"no lattice lies in {read.name}: shift it by phase, or make the cell smaller")
        else:
            cut = fill_within_skin(block, read, skin, openings)
    with stages("check"):
        certificate = certify_kernel_solids(cut.solids, block, cut.notes)
    patches = block.patches if cut.brep is None else cut.brep
    return InfillModel(
        name,
        patches,
        replace(certificate, seconds=dict(stages.seconds)),
        cut.built,
        trimmed_by=cut.by,
        patches_bound_solid=cut.brep is not None,
    )


def fill_within_skin(block: LatticeBlock, body: CadBody, skin: float, open_faces: Sequence[Any] = ()) -> BooleanResult:
    """The body but for the voids that the lattice leaves in it deeper than the skin.

    They become shells inside one solid, or reach the outside through the open faces.
    """
    skin = check_finite("skin", skin)
    voids = subtract_lattice_from_body(block, offset_inward(body, skin, open_faces))
    if not voids.solids:
        raise InvalidRequest(f"the lattice leaves no void within a skin of {skin:g}: the body would stay as it is")
    solids = subtract_voids(body, voids.solids, open_faces)
    return BooleanResult(KernelSolids(solids), None, voids.by, (*voids.notes, *_note_closed_channels(solids)))


def _note_closed_channels(solids: Sequence[Any]) -> tuple[str, ...]:
    closed = betti_numbers(solids)[2]
    if not closed:
        return ()
    count = "a channel" if closed == 1 else f"{closed} channels that do not meet"
    return (
        f"the skin closes off {count}: each is bounded by a shell of its own inside the solid; "
        "name open_faces, or bore through the skin, to let powder or fluid out",
    )


def _reject_lattice_options(given: dict[str, Any]) -> None:
    """A field says all that a lattice's keywords would."""
    defaults = signature(infill).parameters
    extra = [name for name, value in given.items() if value is not defaults[name].default]
    if extra:
        raise InvalidRequest(
            f"a field is taken as it is: leave {', '.join(extra)} out, and scale or turn the field itself"
        )


def rotation_matrix(rotation: Sequence[float]) -> Array:
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
