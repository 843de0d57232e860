"""The cut: what a body and the matter in it have in common, or what the matter leaves of a body.

A body and matter are closed boundary representations, which are cut by each other on their own parameters
(`tpmscad.trimming`). Where that fails, the kernel's boolean of the two solids follows, as it does nowhere else. Whatever the
method, the volume of the result is compared with the fraction of an even sample of points in the body that lie in the matter,
which no boolean takes part in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from traceback import extract_tb
from typing import Any, Protocol, TypeVar

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import (
    EmptyInfill,
    InvalidRequest,
    KernelError,
    NothingLeft,
    NotQuadric,
    TpmscadError,
    TrimmingError,
)
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.body_brep import (
    FreeFormBody,
    brep_from_shape,
    has_tight_edges,
    read_free_form_body,
)
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, estimate_volume
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.results.certificate import Check, PatchMeasures
from tpmscad.solids.matter.reference_distance import DistanceFunction
from tpmscad.solids.volume_samples import compare_with_sample
from tpmscad.trimming.network_boolean import (
    DEFAULT_TOL,
    SHIFT_DIRECTION,
    SHIFT_TOLS,
    DividedNetwork,
    NetworkResult,
    Operation,
)

TRIMMED_PATCHES = "patches"
KERNEL_BOOLEAN = "kernel"

TRIMMED_NOTE = "trimmed on the patches' parameters"
"""The note of a certificate on the first method."""

CUT_REMEDY = "shift the lattice by `phase`, or change `cell` or `tol` a little"
"""What may be changed where a cut fails: the lattice meets the body in other places then."""

MAX_KERNEL_FACES = 20_000
"""Patches that the kernel's boolean is given; with 35,000 it took 14 GiB, and had not ended after four minutes."""

MAX_SHIFT_TOLS = 0.1
"""In tolerances: how far matter is moved where its surfaces touch what they are combined with."""

N = TypeVar("N", NetworkResult, DividedNetwork)

Finish = Callable[[Brep], Any]
"""Makes something, solids as a rule, of what a cut has left; after a TrimmingError the next placement of the matter is tried."""


class Domain(Protocol):
    """What matter is cut by: a body, or the cavity within its skin."""

    @property
    def name(self) -> str:
        """The name in messages."""

    @property
    def volume(self) -> float:
        """Volume in model units cubed."""

    def read(self, tol: float) -> FreeFormBody:
        """The boundary representation, to be cut by matter of a tolerance."""

    def sample(self) -> Array:
        """An even sample (n, 3) of points in it."""

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in it."""


class Matter(Protocol):
    """What fills a body: a lattice, or the solid of a field, larger than the body."""

    @property
    def name(self) -> str:
        """The name of what is filled with it."""

    @property
    def patches(self) -> Brep:
        """What was fitted, whole."""

    @property
    def closed(self) -> Brep:
        """Its solid in a box around the body."""

    @property
    def measures(self) -> PatchMeasures:
        """What was measured on them."""

    @property
    def distance(self) -> DistanceFunction:
        """Of points from the surface that it was made from."""

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) in the body lie in it."""

    def cut(self, domain: FreeFormBody, operation: Operation, finish: Finish) -> NetworkResult:
        """The intersection with a body, or the body without it, at the first placement at which `finish` succeeds."""

    def intersect_in_kernel(self, shape: Any) -> tuple[Any, ...]:
        """The kernel's solids that it has in common with a shape of the kernel."""

    def measure(self, solids: BrepSolids | OcctSolids, moved: float) -> PatchMeasures:
        """The measures of what a cut has left, after a translation by a length."""


@dataclass(frozen=True, slots=True, eq=False)
class MadeSolids:
    """Solids, largest first, the patches that bound them or that the kernel cut, and what was measured on these.

    contains: whether points (n, 3) lie in them, by what they were made from. label: puts labels on solids that the kernel made.
    valid: what is known of the kernel's check, if anything. is_cut: whether anything was cut by something else. before: the
    volume that the solids would have without what was kept while they were made.
    """

    built: BrepSolids | OcctSolids
    patches: Brep
    measures: PatchMeasures
    contains: Callable[[Array], BoolArray]
    notes: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    label: Callable[[tuple[Any, ...]], OcctSolids] = OcctSolids
    valid: bool | None = True
    is_cut: bool = True
    before: float = 0.0

    @property
    def trimmed_by(self) -> str | None:
        """TRIMMED_PATCHES, KERNEL_BOOLEAN, or None if nothing was cut."""
        if not self.is_cut:
            return None
        return TRIMMED_PATCHES if isinstance(self.built, BrepSolids) else KERNEL_BOOLEAN


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """What a cut on the patches' parameters has left: the solids, the matter's translation `shift` (3,), notes, and the check.

    volume: of the solids before they were finished, model units cubed. own_tags: of the faces of what was cut.
    """

    built: BrepSolids
    volume: float
    own_tags: frozenset[str]
    shift: Array
    notes: tuple[str, ...]
    check: Check

    @property
    def moved(self) -> float:
        """Length of the translation."""
        return float(np.linalg.norm(self.shift))


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


def try_placements(run: Callable[[Array], N], tol: float) -> N:
    """What a combination of surfaces gives at the first translation of the matter (3,), within its tolerance, that succeeds."""
    limit = MAX_SHIFT_TOLS * tol
    shifts = [shift for each in SHIFT_TOLS if (shift := each * DEFAULT_TOL * SHIFT_DIRECTION) @ shift <= limit**2]
    placements = tuple(Fallback(f"moved by {np.linalg.norm(shift):.2g}", partial(run, shift)) for shift in shifts)
    outcome = Fallbacks(placements, retry_on=(TrimmingError,), final=(NothingLeft,)).run()
    reason = str(outcome.failures[0]) if outcome.failures else ""
    return replace(outcome.value, report=replace(outcome.value.report, reason=reason))


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


def read_trimming_body(body: CadBody, tol: float | None = None) -> FreeFormBody:
    """The boundary representation of a CAD body; with free-form faces if it has some; NotQuadric if that is impossible.

    tol: the tolerance of what it is cut with, of which its edges may be off its faces by a hundredth.
    """
    with suppress(NotQuadric):
        brep = brep_from_shape(body.shape, body.face_labels)
        if has_tight_edges(brep):
            return FreeFormBody(brep, {})
    with numerical_failures():
        return read_free_form_body(body.shape, body.face_labels, body.accuracy, tol)


def cut_on_parameters(
    domain: Domain, matter: Matter, operation: Operation = "intersection", finish: Finish = build_valid_solids
) -> Cut:
    """A body and matter cut by each other on their parameters, the matter moved within its tolerance where that is needed.

    NothingLeft if nothing is left; InvalidRequest or TrimmingError if the cut is impossible, KernelError if its volume is wrong.
    """
    read = domain.read(matter.measures.tol)
    points = domain.sample()
    inside = matter.contains(points) == (operation == "intersection")
    try:
        with numerical_failures():
            found = matter.cut(read, operation, lambda brep: _finish_checked(brep, finish, inside, domain))
    except NothingLeft:
        _require_volume(0.0, inside, domain)
        raise
    solids, volume, check = found.built
    notes = TRIMMED_NOTE, *found.report.notes, *read.notes
    return Cut(solids, volume, frozenset(read.brep.tags), found.report.shift, notes, check)


def _finish_checked(brep: Brep, finish: Finish, inside: BoolArray, domain: Domain) -> tuple[BrepSolids, float, Check]:
    """The solids of what a cut has left, and the volume before they were finished with its check."""
    built = build_valid_solids(brep)
    volume = float(built.nesting.volume.sum())
    check = _require_volume(volume, inside, domain)
    return built if finish is build_valid_solids else finish(brep), volume, check


def _require_volume(volume: float, inside: BoolArray, domain: Domain) -> Check:
    """The check of a volume against a sample (n,) of points in a body; KernelError if they contradict each other."""
    check = compare_with_sample(volume / domain.volume, inside, domain.name)
    if not check.passed:
        raise KernelError("trim", check.shortfall)
    return check


def intersect(body: Domain, matter: Matter, cad: CadBody | None) -> MadeSolids:
    """The solids that matter and a body have in common; EmptyInfill if there are none.

    cad: the kernel's solid of a CAD body, which the kernel's boolean takes where the cut fails.
    """
    methods = (BY_PARAMETERS,) if cad is None else (BY_PARAMETERS, BY_KERNEL)
    try:
        outcome = Fallbacks(methods, final=(NothingLeft,), remedy=CUT_REMEDY).run(body, matter, cad)
    except NothingLeft as error:
        raise EmptyInfill(f"no lattice lies in {body.name}: shift it by phase, or make the cell smaller") from error
    made = outcome.value
    if not outcome.failures:
        return made
    first, *others = made.notes
    return replace(made, notes=(f"{first}: {outcome.reasons}", *others))


def _lie_in_both(body: Domain, matter: Matter, points: Array) -> BoolArray:
    """Whether points (n, 3) lie in a body and in the matter."""
    return body.contains(points) & matter.contains(points)


def _intersect_on_parameters(body: Domain, matter: Matter, cad: CadBody | None) -> MadeSolids:
    cut = cut_on_parameters(body, matter)
    return MadeSolids(
        cut.built,
        cut.built.brep,
        matter.measure(cut.built, cut.moved),
        partial(_lie_in_both, body, matter),
        cut.notes,
        (cut.check,),
    )


def _intersect_in_kernel(body: Domain, matter: Matter, cad: CadBody | None) -> MadeSolids:
    """The kernel's boolean of the two solids; KernelError if that fails, or makes what the kernel's own check rejects."""
    assert cad is not None
    built = OcctSolids(matter.intersect_in_kernel(cad.shape))
    if not built.solids:
        raise NothingLeft("the kernel's boolean leaves nothing")
    if not is_valid(make_compound(built.solids)):
        raise KernelError("trim", "the kernel's check rejects what its own boolean made")
    check = _require_volume(sum(map(estimate_volume, built.solids)), matter.contains(body.sample()), body)
    return MadeSolids(
        built,
        matter.patches,
        matter.measure(built, 0.0),
        partial(_lie_in_both, body, matter),
        ("trimmed by the kernel's boolean",),
        (check,),
    )


BY_PARAMETERS: Fallback[[Domain, Matter, CadBody | None], MadeSolids] = Fallback(
    "trimming on the patches' parameters",
    _intersect_on_parameters,
    "a second for a few cells; several with free-form faces, which must meet within 1e-10",
)
BY_KERNEL: Fallback[[Domain, Matter, CadBody | None], MadeSolids] = Fallback(
    "the kernel's boolean",
    _intersect_in_kernel,
    "ten times as long for a few cells, and more than in proportion for many",
)


def require_few_faces(count: int) -> None:
    """InvalidRequest for more patches than the kernel's boolean is given."""
    if count > MAX_KERNEL_FACES:
        raise InvalidRequest(
            f"the lattice has {count} patches, more than the {MAX_KERNEL_FACES} that its boolean is given"
        )
