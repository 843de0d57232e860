"""What comes of filling a body: a model of kernel solids, with the patches it is made of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import kernel
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.boolean import betti_numbers
from tpmscad.kernel.build import compound
from tpmscad.kernel.check import bounding_box
from tpmscad.model import Model
from tpmscad.parts.block import Block
from tpmscad.patches.certificate import Certificate, certificate_of
from tpmscad.patches.summary import Piece, Summary
from tpmscad.workflows import export_model, verified

STORED_VOLUME = 1e-7
"""Relative: how far the volume of a file that was read back may be from what was written, faces of the body included."""


@dataclass(frozen=True, slots=True, eq=False)
class Part(Model):
    """A body with a lattice in it.

    `trimmed_by` is "patches" or "kernel", the latter where the body has faces that are neither plane nor quadric. `patches`
    bound the solid where they were trimmed and there is no skin (`bounded`); else they are the lattice's, whole.
    """

    trimmed_by: str = "kernel"
    bounded: bool = False
    """Whether `patches` bound the solid."""

    @property
    def wrapped(self) -> Any:
        """The TopoDS shape, by the name that build123d and CadQuery give it."""
        return self.built.shape

    def export_step(self, path: str | Path, *, instanced: bool = False, schema: str = "ap242") -> None:
        """Write the part as STEP, read it back and check it; KernelError if the file does not hold what was written."""
        if instanced:
            raise InvalidRequest(f"the {self.name} has no cell that repeats: leave instanced out")
        if self.bounded:
            export_model(self, path, instanced=False, schema=schema, stored_volume=STORED_VOLUME)
        else:
            write_checked(self.built.shape, path, schema=schema, name=self.name, volume=self.certificate.volume)


def write_checked(
    shape: Any, path: str | Path, *, schema: str, name: str, volume: float, names: Iterable[str] = ()
) -> None:
    """Write a kernel shape as STEP; the file is there whole and read back as what was written, or not at all."""
    verify = verified(volume, STORED_VOLUME)
    kernel.write_shape(shape, path, schema=schema, name=name, verify=verify, names=tuple(names))


def part_certificate(solids: tuple[Any, ...], block: Block, notes: tuple[str, ...]) -> Certificate:
    """Measure kernel solids and hold them against the request; the block knows what was measured on the lattice's patches."""
    tol, deviation, smooth = block.tol, block.deviation, block.joints
    report = kernel.check_shape(compound(solids))
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
    found = certificate_of(
        block.patches,
        Summary(
            report.closed, report.volume, report.area, report.centroid, betti_numbers(solids), _pieces(solids, report)
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


def _pieces(solids: tuple[Any, ...], report: kernel.ShapeReport) -> tuple[Piece, ...]:
    """Each solid's volume and middle; of an only one the centroid, which costs nothing."""
    if len(solids) == 1:
        return (Piece(report.volume, report.centroid),)
    middles = [np.mean(bounding_box(solid), axis=0).tolist() for solid in solids]
    return tuple(Piece(volume, (x, y, z)) for volume, (x, y, z) in zip(report.volumes, middles, strict=True))
