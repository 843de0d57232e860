"""Booleans of a lattice and a CAD body, by the most exact method that succeeds.

The first method trims the patches on their own parameter domains (`tpmscad.trimming`). Where it fails, the kernel's boolean
of the two solids follows. Whatever the method, the volume of the result is compared with the fraction of an even sample of
points in the body that lie in the lattice, which no boolean takes part in.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from traceback import extract_tb
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, reverse_faces, spline_faces
from tpmscad.errors import InvalidRequest, KernelError, NothingLeft, NotQuadric, TpmscadError, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.body_brep import (
    FreeFormBody,
    brep_from_shape,
    has_tight_edges,
    read_free_form_body,
)
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, estimate_volume, intersect_solids
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.shape_sampling import sample_solid
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.results.certificate import Certificate, Check, certify_built_solids, certify_kernel_solids
from tpmscad.solids.lattice_block import LatticeBlock
from tpmscad.solids.patch_measures import move_patch_measures
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.network_boolean import Operation, combine_networks

TRIMMED_PATCHES = "patches"
KERNEL_BOOLEAN = "kernel"

TRIMMED_NOTE = "trimmed on the patches' parameters"
"""The note of a certificate on the first method."""

N_SAMPLE_LINES = 512
POINTS_PER_LINE = 4
"""Size of the sample: a missing piece of a tenth of the volume shows."""

MAX_STANDARD_ERRORS = 5.0
"""Standard errors of an independent random sample by which the volume may differ from the sample's."""

NODES_PER_DIRECTION = 5
"""Nodes of every patch along u and v for the classification of points."""

SEARCH_RADIUS_PATCHES = 2.0
"""In sizes of the largest patch: the distance around the points within which nodes are searched first."""


@dataclass(frozen=True, slots=True, eq=False)
class BooleanResult:
    """The solids that are left, largest first; `brep` bounds them if the patches were trimmed.

    `method` is TRIMMED_PATCHES or KERNEL_BOOLEAN. `checks` of the certificate are those that the boolean itself gives rise to.
    `shifts` (k, 3): the translations of the lattice's patches in the solids, one or several.
    """

    built: Any
    brep: Brep | None
    method: str
    notes: tuple[str, ...]
    checks: tuple[Check, ...] = ()
    shifts: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 0.0),)

    @property
    def moved(self) -> float:
        """Length of the longest translation."""
        return float(np.linalg.norm(self.shifts, axis=1).max())

    @property
    def solids(self) -> tuple[Any, ...]:
        """The kernel's solids, largest first."""
        return self.built.solids


def certify_cut_solids(
    block: LatticeBlock,
    built: BrepSolids | OcctSolids,
    *,
    moved: float = 0.0,
    checks: tuple[Check, ...] = (),
    notes: tuple[str, ...] = (),
    dropped: tuple[float, ...] = (),
) -> Certificate:
    """The certificate of what a boolean left of the lattice `block`: of trimmed patches, or of solids that the kernel cut.

    moved: the length (model units) by which the lattice was translated before it was cut.
    Trimmed patches that the kernel's check rejects end in an error, so that those which get here are valid.
    """
    measures = move_patch_measures(block.measures, moved)
    if isinstance(built, OcctSolids):
        return certify_kernel_solids(built.solids, block.patches, measures, checks=checks, notes=notes, dropped=dropped)
    return certify_built_solids(built, measures, valid=True, checks=checks, notes=notes, dropped=dropped)


def intersect_body_with_lattice(block: LatticeBlock, body: CadBody) -> BooleanResult:
    """The solids that lattice and body have in common, by the first method that succeeds; none if they do not meet."""
    outcome = BOOLEAN_METHODS.run(block, body)
    result = outcome.value
    if not outcome.failures:
        return result
    first, *others = result.notes
    return replace(result, notes=(f"{first}: {outcome.reasons}", *others))


def trim_on_parameters(block: LatticeBlock, body: CadBody, operation: Operation = "intersection") -> BooleanResult:
    """Patches and body cut by each other on their parameter domains, the lattice moved within its tolerance where that is needed.

    InvalidRequest or TrimmingError if that is impossible, KernelError if the volume of the result is wrong.
    """
    read = read_trimming_body(body, block.measures.tol)
    with numerical_failures():
        result = _combine_by_networks(block, read, operation)
    volume = 0.0 if result.brep is None else float(result.built.nesting.volume.sum())
    _check_volume_by_sampling(volume, _orient(block.patches, operation), body)
    return result


def _orient(patches: Brep, operation: Operation) -> Brep:
    """The patches of what an operation leaves of a body."""
    return patches if operation == "intersection" else reverse_faces(patches)


def read_trimming_body(body: CadBody, tol: float | None = None) -> FreeFormBody:
    """The body as `trimming` takes it, with free-form faces if it has some; NotQuadric if that is impossible.

    tol: the tolerance of what it is cut with, of which its edges may be off its faces by a hundredth.
    """
    with suppress(NotQuadric):
        brep = brep_from_shape(body.shape, body.face_labels)
        if has_tight_edges(brep):
            return FreeFormBody(brep, {})
    with numerical_failures():
        return read_free_form_body(body.shape, body.face_labels, body.accuracy, tol)


@contextmanager
def numerical_failures() -> Iterator[None]:
    """Exceptions of the kernel and of singular systems as a TrimmingError that names the step, so that the next method follows.

    OCCT's exceptions have no common base class. The exception stays the cause.
    """
    try:
        yield
    except TpmscadError:
        raise
    except Exception as error:
        step = next(
            (f.name for f in reversed(extract_tb(error.__traceback__)) if "tpmscad" in f.filename), "the kernel"
        )
        raise TrimmingError(f"the cut met a singular case ({type(error).__name__} in {step})") from error


def _combine_by_networks(block: LatticeBlock, read: FreeFormBody, operation: Operation) -> BooleanResult:
    """The faces of the body and the patches, cut by each other as two networks."""
    try:
        cut = combine_networks(
            read.brep, block.patches, operation, build=build_valid_solids, max_shift=block.max_shift, is_cover=True
        )
    except NothingLeft:
        return BooleanResult(OcctSolids(()), None, TRIMMED_PATCHES, ())
    notes = TRIMMED_NOTE, *cut.report.notes, *read.notes
    return BooleanResult(cut.built, cut.brep, TRIMMED_PATCHES, notes, shifts=(tuple(cut.report.shift.tolist()),))


def build_valid_solids(brep: Brep) -> BrepSolids:
    """The solids that patches bound; TrimmingError if they do not close or the kernel rejects a face of them.

    Where a wall grazes an edge of the body, an infinitesimal shell may come out inside out; another placement has none.
    """
    try:
        built = build_solids(brep)
    except KernelError as error:
        raise TrimmingError(f"the trimmed lattice makes no solid: {error}") from error
    if not is_brep_valid(brep, built.known_faces):
        raise TrimmingError("the kernel's check rejects the trimmed lattice")
    return built


CUT_REMEDY = "shift the lattice by `phase`, or change `cell` or `tol` a little"
"""What may be changed where a cut fails: the lattice meets the body in other places then."""

MAX_KERNEL_FACES = 20_000
"""Patches that the kernel's boolean is given; with 35,000 it took 14 GiB, and had not ended after four minutes."""


def intersect_in_kernel(block: LatticeBlock, body: CadBody) -> BooleanResult:
    """The kernel's boolean of the two solids; KernelError if that fails, or makes what the kernel's own check rejects."""
    if len(block.patches.faces) > MAX_KERNEL_FACES:
        raise InvalidRequest(
            f"the lattice has {len(block.patches.faces)} patches, more than the {MAX_KERNEL_FACES} that its boolean is given"
        )
    built = OcctSolids(intersect_solids(block.shape, body.shape))
    if built.solids and not is_valid(make_compound(built.solids)):
        raise KernelError("trim", "the kernel's check rejects what its own boolean made")
    _check_volume_by_sampling(sum(map(estimate_volume, built.solids)), block.patches, body)
    return BooleanResult(built, None, KERNEL_BOOLEAN, ("trimmed by the kernel's boolean",))


BOOLEAN_METHODS: Fallbacks[[LatticeBlock, CadBody], BooleanResult] = Fallbacks(
    (
        Fallback(
            "trimming on the patches' parameters",
            lambda block, body: trim_on_parameters(block, body),
            "a second for a few cells; several with free-form faces, which must meet within 1e-10",
        ),
        Fallback(
            "the kernel's boolean",
            lambda block, body: intersect_in_kernel(block, body),
            "ten times as long for a few cells, and more than in proportion for many",
        ),
    ),
    remedy=CUT_REMEDY,
)
"""How the part of a lattice inside a body is made."""


def _check_volume_by_sampling(volume: float, patches: Brep, body: CadBody) -> None:
    """KernelError if a volume contradicts an even sample of points in the body."""
    fraction, error = sample_lattice_fraction(patches, body)
    if abs(volume / body.volume - fraction) > error:
        raise KernelError(
            "trim",
            f"the trimmed solid fills {volume / body.volume:.3g} of {body.name}, "
            f"but {fraction:.3g} +- {error:.2g} of a sample",
        )


def sample_lattice_fraction(patches: Brep, body: CadBody) -> tuple[float, float]:
    """Fraction of an even sample of points in the body that lies in the lattice, and the error allowed for it."""
    points = sample_body(body)
    return estimate_fraction(signed_distances_to_nodes(patches, points) < 0)


def sample_body(body: CadBody) -> Array:
    """An even sample (n, 3) of points in a body."""
    return sample_solid(body.shape, N_SAMPLE_LINES, POINTS_PER_LINE)


def compare_with_sample(filled: float, inside: BoolArray, name: str) -> Check:
    """The check that the part of a body that is filled is that of a sample (n,) of points in the body."""
    fraction, error = estimate_fraction(inside)
    return Check(
        "volume",
        abs(filled - fraction),
        error,
        f"it fills {filled:.3g} of {name}, but {fraction:.3g} +- {error:.2g} of a sample",
    )


def estimate_fraction(inside: BoolArray) -> tuple[float, float]:
    """The fraction of a sample (n,) that is inside, and the error allowed for it."""
    fraction = float(inside.mean())
    variance = max(fraction * (1 - fraction), 1 / len(inside)) / len(inside)
    return fraction, MAX_STANDARD_ERRORS * float(np.sqrt(variance))


def signed_distances_to_nodes(patches: Brep, points: Array) -> Array:
    """Distances (n,) of points (n, 3) from the nearest node of the patches along its outward normal; negative in the lattice."""
    size = max(np.ptp(c.poles, axis=(0, 1)).max() for c in patches.carriers if isinstance(c, BSplineSurface))
    for radius in (SEARCH_RADIUS_PATCHES * size, np.inf):
        nodes, normals = _oriented_nodes(patches, points.min(axis=0) - radius, points.max(axis=0) + radius)
        if len(nodes):
            distance, nearest = cKDTree(nodes).query(points)
            if distance.max() <= radius - size:  # no patch outside the searched box is nearer
                break
    return np.einsum("ni,ni->n", points - nodes[nearest], normals[nearest])


def _oriented_nodes(patches: Brep, low: Array, high: Array) -> tuple[Array, Array]:
    """Nodes and outward normals (n, 3), (n, 3) of the patches whose centers lie in the box [low, high]."""
    faces = patches.faces
    nodes, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for own, carrier in spline_faces(patches):
        u, v = (
            g.ravel()
            for g in np.meshgrid(*(np.linspace(*d, NODES_PER_DIRECTION) for d in carrier.domain), indexing="ij")
        )
        points = carrier(u, v)
        center = faces.motion[own].apply(points.mean(axis=0))
        own = own[((center >= low) & (center <= high)).all(axis=1)]
        motion = faces.motion[own]
        orientation = faces.sense[own] * motion.handedness
        nodes.append(motion[:, None].apply(points).reshape(-1, 3))
        normal = motion[:, None].apply_to_vectors(carrier.normal(u, v)) * orientation[:, None, None]
        normals.append(normal.reshape(-1, 3))
    return np.concatenate(nodes), np.concatenate(normals)
