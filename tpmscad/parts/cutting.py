"""Lattice and body cut to each other: on the patches' own parameters where the body is of planes and quadrics, or by the kernel.

Whichever way, the result is held against an even sample of points of the body's box, told in or out by neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import qmc

from tpmscad import kernel
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel import boolean
from tpmscad.kernel.body import Body, bounds_of
from tpmscad.kernel.boolean import Solids
from tpmscad.kernel.distance import body_field
from tpmscad.kernel.tool import body_complex
from tpmscad.parts.block import Block
from tpmscad.patches import measure
from tpmscad.patches.complex import Array, PatchComplex
from tpmscad.splines.bspline import Surface
from tpmscad.trimming import TrimmingError, trim

PATCHES, KERNEL = "patches", "kernel"

POINTS = 1024
"""Of the sample: a piece left out, or a void filled, of a tenth of the volume shows."""

ERRORS = 5.0
"""Standard errors of a plain random sample by which a volume may miss the sample's."""

NODES = 5
"""Nodes along u and v of every patch that tell on which side of the lattice a point is."""


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """What is left: solids, largest first; `complex` bounds them where the patches were trimmed. `by` is PATCHES or KERNEL."""

    built: Any
    complex: PatchComplex | None
    by: str
    notes: tuple[str, ...]

    @property
    def solids(self) -> tuple[Any, ...]:
        return self.built.solids


def lattice_in(block: Block, body: Body) -> Cut:
    """The solids of lattice and body; none where they do not meet."""
    try:
        found = trimmed(block.patches, block, body, sign=1)
    except (InvalidRequest, TrimmingError, KernelError) as refusal:
        solids = boolean.common(block.shape, body.shape)
        cut = Cut(Solids(solids), None, KERNEL, (_by_kernel(refusal),))
        _check(sum(map(boolean.rough_volume, solids)), block, body, sign=1)
        return cut
    return found


def voids_in(block: Block, body: Body) -> Cut:
    """The solids of the body without the lattice."""
    try:
        return trimmed(flipped(block.patches), block, body, sign=-1)
    except (InvalidRequest, TrimmingError, KernelError) as refusal:
        solids = boolean.difference(body.shape, block.shape)
        _check(sum(map(boolean.rough_volume, solids)), block, body, sign=-1)
        return Cut(Solids(solids), None, KERNEL, (_by_kernel(refusal),))


def trimmed(patches: PatchComplex, block: Block, body: Body, sign: int) -> Cut:
    """The patches trimmed by the body as a complex; TrimmingError, InvalidRequest or KernelError where that can't be done.

    sign: +1 for the lattice, -1 for what it leaves.
    """
    cut = trim(patches, body_complex(body.shape))
    if not len(cut.complex.faces):
        _check(0.0, block, body, sign)
        return Cut(Solids(()), None, PATCHES, ())
    built = kernel.build(cut.complex)
    if not kernel.is_valid(built.shape):
        raise TrimmingError("the kernel's check rejects the trimmed lattice")
    _check(float(measure.volume(built.nesting.moments)[0]), block, body, sign)
    notes = ["trimmed on the patches' parameters"]
    if cut.report.shifted:
        notes.append(f"the lattice was moved by {cut.report.shifted:.2g}: {cut.report.reason}")
    return Cut(built, cut.complex, PATCHES, tuple(notes))


def flipped(patches: PatchComplex) -> PatchComplex:
    """The patches that bound what the lattice leaves: the other side of every one is out."""
    return replace(patches, faces=replace(patches.faces, sense=-patches.faces.sense))


def _by_kernel(refusal: Exception) -> str:
    return f"trimmed by the kernel's boolean: {refusal}"


def _check(volume: float, block: Block, body: Body, sign: int) -> None:
    """KernelError if a volume can't be right, by an even sample."""
    low, high = bounds_of(body.shape)
    points = low + (high - low) * qmc.Sobol(3, seed=np.random.default_rng(1)).random(POINTS)
    box = float(np.prod(high - low))
    within = points[body_field(body.shape)(points) < 0]
    share = np.count_nonzero(sign * sides_of(block.patches, within) < 0) / POINTS
    error = ERRORS * np.sqrt(max(share * (1 - share), 1 / POINTS) / POINTS) * box
    if abs(volume - share * box) > error:
        raise KernelError(
            "trim",
            f"the trimmed solid has volume {volume:.6g}, a sample of {POINTS} points says {share * box:.4g} +- {error:.2g}",
        )


def sides_of(patches: PatchComplex, points: Array) -> Array:
    """Below 0 for points (n, 3) in the lattice, by the nearest node of its patches: distances along the outward normal (n,)."""
    faces = patches.faces
    at, outward = [], []
    for index in np.unique(faces.carrier).tolist():
        carrier = patches.carriers[index]
        if not isinstance(carrier, Surface):
            continue
        u, v = (g.ravel() for g in np.meshgrid(*(np.linspace(*d, NODES) for d in carrier.domain), indexing="ij"))
        own = np.flatnonzero(faces.carrier == index)
        rotation = faces.rotation[own]
        way = faces.sense[own] * np.sign(np.linalg.det(rotation))
        at.append((np.einsum("fij,nj->fni", rotation, carrier(u, v)) + faces.translation[own, None]).reshape(-1, 3))
        normal = np.einsum("fij,nj->fni", rotation, carrier.normal(u, v)) * way[:, None, None]
        outward.append(normal.reshape(-1, 3))
    nodes, normals = np.concatenate(at), np.concatenate(outward)
    nearest = cKDTree(nodes).query(points)[1]
    return np.einsum("ni,ni->n", points - nodes[nearest], normals[nearest])
