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
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, reverse_faces, spline_faces
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest, KernelError, TrimmingError
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.boolean import boolean_operations
from tpmscad.kernel.boolean.boolean_operations import KernelSolids
from tpmscad.kernel.boolean.local_intersection import intersect_locally
from tpmscad.kernel.measure.cad_body import CadBody
from tpmscad.kernel.measure.shape_sampling import sample_solid
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming import trim
from tpmscad.workflows.lattice_block import LatticeBlock

TRIMMED_PATCHES, KERNEL_BOOLEAN = "patches", "kernel"

N_SAMPLE_LINES, POINTS_PER_LINE = 512, 4
"""Lines through the body's box and points on each: a piece left out, or a void filled, of a tenth of the volume shows."""

MAX_STANDARD_ERRORS = 5.0
"""Standard errors of a plain random sample by which a volume may miss the sample's."""

NODES_PER_DIRECTION = 5
"""Nodes along u and v of every patch that tell on which side of the lattice a point is."""

SEARCH_RADIUS_PATCHES = 2.0
"""Patches at most this many times a patch's size away from the points are looked at first."""


@dataclass(frozen=True, slots=True, eq=False)
class BooleanResult:
    """What is left: solids, largest first; `complex` bounds them where the patches were trimmed. `by` is PATCHES or KERNEL."""

    built: Any
    brep: Brep | None
    by: str
    notes: tuple[str, ...]

    @property
    def solids(self) -> tuple[Any, ...]:
        return self.built.solids


def intersect_body_with_lattice(block: LatticeBlock, body: CadBody) -> BooleanResult:
    """The solids of lattice and body; none where they do not meet."""
    return _intersect_with_fallbacks(
        block.patches, body, lambda: boolean_operations.intersect_solids(block.shape, body.shape)
    )


def subtract_lattice_from_body(block: LatticeBlock, body: CadBody) -> BooleanResult:
    """The solids of the body without the lattice."""
    return _intersect_with_fallbacks(
        reverse_faces(block.patches), body, lambda: boolean_operations.subtract_solid(body.shape, block.shape)
    )


def _intersect_with_fallbacks(patches: Brep, body: CadBody, plainly: Callable[[], tuple[Any, ...]]) -> BooleanResult:
    """What the patches bound in the body: trimmed on their parameters; or the kernel splits those near its faces; or plainly."""
    try:
        return trim_on_parameters(patches, body)
    except (InvalidRequest, TrimmingError, KernelError) as error:
        refusal = error
    try:
        cut = split_near_body_faces(patches, body, refusal)
    except KernelError as error:
        cut = BooleanResult(
            KernelSolids(plainly()), None, KERNEL_BOOLEAN, (f"trimmed by the kernel's boolean: {refusal}; {error}",)
        )
        _check_volume_by_sampling(sum(map(boolean_operations.estimate_volume, cut.solids)), patches, body)
    return cut


def trim_on_parameters(patches: Brep, body: CadBody) -> BooleanResult:
    """The patches trimmed by the body as a complex; TrimmingError, InvalidRequest or KernelError where that can't be done."""
    tool = brep_from_shape(body.shape)
    for apart in (False, True):
        cut = trim(patches, tool, apart=apart)
        if not len(cut.brep.faces):
            _check_volume_by_sampling(0.0, patches, body)
            return BooleanResult(KernelSolids(()), None, TRIMMED_PATCHES, ())
        built = kernel.build_solids(cut.brep)
        if kernel.is_valid(built.shape):
            break
    else:
        raise TrimmingError("the kernel's check rejects the trimmed lattice")
    _check_volume_by_sampling(float(integral_properties.volume(built.nesting.moments)[0]), patches, body)
    notes = ["trimmed on the patches' parameters"]
    if cut.report.shifted:
        notes.append(f"the lattice was moved by {cut.report.shifted:.2g}: {cut.report.reason}")
    return BooleanResult(built, cut.brep, TRIMMED_PATCHES, tuple(notes))


def split_near_body_faces(patches: Brep, body: CadBody, refusal: Exception) -> BooleanResult:
    """What the kernel makes of the patches near the body's faces, with all others whole; KernelError where that fails."""
    found = intersect_locally(patches, body.shape, lambda points: signed_distances_to_nodes(patches, points))
    if not kernel.is_valid(make_compound(found.solids)):
        raise KernelError("trim", "the kernel's check rejects what it split itself")
    _check_volume_by_sampling(found.volume, patches, body)
    return BooleanResult(
        KernelSolids(found.solids),
        None,
        KERNEL_BOOLEAN,
        (f"the {found.candidate_count} patches near the body's faces were split by the kernel: {refusal}",),
    )


def _check_volume_by_sampling(volume: float, patches: Brep, body: CadBody) -> None:
    """KernelError if a volume can't be right, by an even sample of the body."""
    within = sample_solid(body.shape, N_SAMPLE_LINES, POINTS_PER_LINE)
    share = float((signed_distances_to_nodes(patches, within) < 0).mean())
    error = MAX_STANDARD_ERRORS * np.sqrt(max(share * (1 - share), 1 / len(within)) / len(within))
    if abs(volume / body.volume - share) > error:
        raise KernelError(
            "trim",
            f"the trimmed solid fills {volume / body.volume:.3g} of {body.name}, but {share:.3g} +- {error:.2g} of a sample",
        )


def signed_distances_to_nodes(patches: Brep, points: Array) -> Array:
    """Below 0 for points (n, 3) in the lattice, by the nearest node of its patches: distances along the outward normal (n,)."""
    sizes = [np.ptp(c.poles, axis=(0, 1)).max() for c in patches.carriers if isinstance(c, BSplineSurface)]
    for reach in (SEARCH_RADIUS_PATCHES * max(sizes), np.inf):
        nodes, normals = _oriented_nodes(patches, points.min(axis=0) - reach, points.max(axis=0) + reach)
        if len(nodes):
            distance, nearest = cKDTree(nodes).query(points)
            if distance.max() <= reach - max(sizes):  # no patch that was left out is nearer
                break
    return np.einsum("ni,ni->n", points - nodes[nearest], normals[nearest])


def _oriented_nodes(patches: Brep, low: Array, high: Array) -> tuple[Array, Array]:
    """Nodes, and normals out of the lattice, of the patches whose middles lie in a box: (n, 3), (n, 3)."""
    faces = patches.faces
    at, outward = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for own, carrier in spline_faces(patches):
        u, v = (
            g.ravel()
            for g in np.meshgrid(*(np.linspace(*d, NODES_PER_DIRECTION) for d in carrier.domain), indexing="ij")
        )
        net = carrier(u, v)
        middle = faces.motion[own].apply(net.mean(axis=0))
        own = own[((middle >= low) & (middle <= high)).all(axis=1)]
        motion = faces.motion[own]
        way = faces.sense[own] * motion.handedness
        at.append(motion[:, None].apply(net).reshape(-1, 3))
        normal = motion[:, None].apply_to_vectors(carrier.normal(u, v)) * way[:, None, None]
        outward.append(normal.reshape(-1, 3))
    return np.concatenate(at), np.concatenate(outward)
