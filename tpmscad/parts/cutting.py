"""Lattice and body cut to each other: on the patches' own parameters where the body is of planes and quadrics; else the kernel
splits the patches near the body's faces, and if that fails too, it is the kernel's plain boolean.

Whichever way, the result is held against an even sample of points of the body's box, told in or out by neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tpmscad import kernel
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel import boolean
from tpmscad.kernel.body import Body
from tpmscad.kernel.boolean import Solids
from tpmscad.kernel.build import compound
from tpmscad.kernel.crossing import crossed
from tpmscad.kernel.lines import points_within
from tpmscad.kernel.tool.complex import body_complex
from tpmscad.parts.block import Block
from tpmscad.patches import measure
from tpmscad.patches.complex import Array, PatchComplex
from tpmscad.patches.selection import flipped, spline_faces
from tpmscad.splines.bspline import Surface
from tpmscad.trimming import TrimmingError, trim

PATCHES, KERNEL = "patches", "kernel"

LINES, POINTS = 512, 4
"""Lines through the body's box and points on each: a piece left out, or a void filled, of a tenth of the volume shows."""

ERRORS = 5.0
"""Standard errors of a plain random sample by which a volume may miss the sample's."""

NODES = 5
"""Nodes along u and v of every patch that tell on which side of the lattice a point is."""

REACH = 2.0
"""Patches at most this many times a patch's size away from the points are looked at first."""


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
    return _cut(block.patches, body, lambda: boolean.common(block.shape, body.shape))


def voids_in(block: Block, body: Body) -> Cut:
    """The solids of the body without the lattice."""
    return _cut(flipped(block.patches), body, lambda: boolean.difference(body.shape, block.shape))


def _cut(patches: PatchComplex, body: Body, plainly: Callable[[], tuple[Any, ...]]) -> Cut:
    """What the patches bound in the body: trimmed on their parameters; or the kernel splits those near its faces; or plainly."""
    try:
        return trimmed(patches, body)
    except (InvalidRequest, TrimmingError, KernelError) as error:
        refusal = error
    try:
        cut = split(patches, body, refusal)
    except KernelError as error:
        cut = Cut(Solids(plainly()), None, KERNEL, (f"trimmed by the kernel's boolean: {refusal}; {error}",))
        _check(sum(map(boolean.rough_volume, cut.solids)), patches, body)
    return cut


def trimmed(patches: PatchComplex, body: Body) -> Cut:
    """The patches trimmed by the body as a complex; TrimmingError, InvalidRequest or KernelError where that can't be done."""
    tool = body_complex(body.shape)
    for apart in (False, True):
        cut = trim(patches, tool, apart=apart)
        if not len(cut.complex.faces):
            _check(0.0, patches, body)
            return Cut(Solids(()), None, PATCHES, ())
        built = kernel.build(cut.complex)
        if kernel.is_valid(built.shape):
            break
    else:
        raise TrimmingError("the kernel's check rejects the trimmed lattice")
    _check(float(measure.volume(built.nesting.moments)[0]), patches, body)
    notes = ["trimmed on the patches' parameters"]
    if cut.report.shifted:
        notes.append(f"the lattice was moved by {cut.report.shifted:.2g}: {cut.report.reason}")
    return Cut(built, cut.complex, PATCHES, tuple(notes))


def split(patches: PatchComplex, body: Body, refusal: Exception) -> Cut:
    """What the kernel makes of the patches near the body's faces, with all others whole; KernelError where that fails."""
    found = crossed(patches, body.shape, lambda points: sides_of(patches, points))
    if not kernel.is_valid(compound(found.solids)):
        raise KernelError("trim", "the kernel's check rejects what it split itself")
    _check(found.volume, patches, body)
    return Cut(
        Solids(found.solids),
        None,
        KERNEL,
        (f"the {found.patches} patches near the body's faces were split by the kernel: {refusal}",),
    )


def _check(volume: float, patches: PatchComplex, body: Body) -> None:
    """KernelError if a volume can't be right, by an even sample of the body."""
    within = points_within(body.shape, LINES, POINTS)
    share = float((sides_of(patches, within) < 0).mean())
    error = ERRORS * np.sqrt(max(share * (1 - share), 1 / len(within)) / len(within))
    if abs(volume / body.volume - share) > error:
        raise KernelError(
            "trim",
            f"the trimmed solid fills {volume / body.volume:.3g} of {body.name}, but {share:.3g} +- {error:.2g} of a sample",
        )


def sides_of(patches: PatchComplex, points: Array) -> Array:
    """Below 0 for points (n, 3) in the lattice, by the nearest node of its patches: distances along the outward normal (n,)."""
    sizes = [np.ptp(c.poles, axis=(0, 1)).max() for c in patches.carriers if isinstance(c, Surface)]
    for reach in (REACH * max(sizes), np.inf):
        nodes, normals = _nodes(patches, points.min(axis=0) - reach, points.max(axis=0) + reach)
        if len(nodes):
            distance, nearest = cKDTree(nodes).query(points)
            if distance.max() <= reach - max(sizes):  # no patch that was left out is nearer
                break
    return np.einsum("ni,ni->n", points - nodes[nearest], normals[nearest])


def _nodes(patches: PatchComplex, low: Array, high: Array) -> tuple[Array, Array]:
    """Nodes, and normals out of the lattice, of the patches whose middles lie in a box: (n, 3), (n, 3)."""
    faces = patches.faces
    at, outward = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for own, carrier in spline_faces(patches):
        u, v = (g.ravel() for g in np.meshgrid(*(np.linspace(*d, NODES) for d in carrier.domain), indexing="ij"))
        net = carrier(u, v)
        middle = np.einsum("fij,j->fi", faces.rotation[own], net.mean(axis=0)) + faces.translation[own]
        own = own[((middle >= low) & (middle <= high)).all(axis=1)]
        rotation = faces.rotation[own]
        way = faces.sense[own] * np.sign(np.linalg.det(rotation))
        at.append((np.einsum("fij,nj->fni", rotation, net) + faces.translation[own, None]).reshape(-1, 3))
        normal = np.einsum("fij,nj->fni", rotation, carrier.normal(u, v)) * way[:, None, None]
        outward.append(normal.reshape(-1, 3))
    return np.concatenate(at), np.concatenate(outward)
