"""Passive regions: CAD bodies that the solid of a field contains, such as bosses and flanges, or that stay empty, such as bores.

The faces of these bodies are exact in the result. A body is united with the solid, or subtracted from it, on the parameters of
patches, planes and quadrics (`trimming.network_boolean`), without being moved. Where it is flush with a side of the box, or that
fails otherwise, the kernel does it, and makes one face of those in one plane. Either way the volume is compared with even samples
of points in the bodies, which no boolean takes part in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, KernelError, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.cad_body import BodyFile, CadBody, read_bodies
from tpmscad.kernel.body_import.solid_choice import ALL
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, estimate_volume, merge_faces
from tpmscad.kernel.boolean.cut_faces import label_cut_solids
from tpmscad.kernel.boolean.solid_trees import SolidSet, combine_sets, list_solids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.results.certificate import Check
from tpmscad.solids.boolean_strategies import (
    MAX_KERNEL_FACES,
    build_valid_solids,
    estimate_fraction,
    numerical_failures,
    read_trimming_body,
    sample_body,
)
from tpmscad.trimming.network_boolean import Operation, combine_networks

VOLUME_RTOL = 1e-5
"""Of the volume: what its quadrature by the kernel may be off by, beside the error of the samples."""

KEPT_VOLUME_RTOL = 1e-4
"""Difference between the volumes of a body and of a loose piece at which they are the same."""

Solids = BrepSolids | OcctSolids


@dataclass(frozen=True, slots=True, eq=False)
class PassiveRegions:
    """Bodies that a solid contains (`kept`), and bodies that stay empty (`cleared`), those after those."""

    kept: tuple[CadBody, ...] = ()
    cleared: tuple[CadBody, ...] = ()

    @classmethod
    def read(cls, keep: Any = None, clear: Any = None) -> PassiveRegions:
        """All solids of shapes or CAD files, of which each may be None; errors as `read_bodies`."""
        return cls(_read_all(keep), _read_all(clear))

    @property
    def bodies(self) -> tuple[CadBody, ...]:
        """All bodies."""
        return self.kept + self.cleared

    def describe(self) -> tuple[str, ...]:
        """What is contained or stays empty, with its volume."""
        return tuple(
            f"{body.name} {'is contained' if number < len(self.kept) else 'stays empty'}, {body.volume:.6g} mm3"
            for number, body in enumerate(self.bodies)
        )

    def combine(self, built: Solids, is_inside: Callable[[Array], BoolArray]) -> CombinedRegions:
        """The union of solids with the bodies that are kept, without those that are cleared.

        is_inside: whether points (n, 3) lie in the solids, by the field.
        KernelError if a body can neither be united nor subtracted.
        """
        expected, allowed, notes = _measure_volume(built), 0.0, []
        for number, body in enumerate(self.bodies):
            kept = number < len(self.kept)
            outcome = METHODS.run(built, body, "union" if kept else "difference")
            built = outcome.value
            points = sample_body(body)
            inside = is_inside(points)
            for other in self.kept[:number]:
                inside[~inside] = contains_points(other.shape, points[~inside])
            fraction, error = estimate_fraction(inside)
            expected += ((1.0 - fraction) if kept else -fraction) * body.volume
            allowed += error * body.volume
            what = f"{'contained' if kept else 'empty'}, {100.0 * fraction:.3g} % of it was solid before"
            reasons = f": {outcome.reasons}" if outcome.failures else ""
            notes += [f"{body.name} is {what}; {outcome.name}{reasons}", *body.notes]
        found = _measure_volume(built)
        check = Check(
            "volume with the passive regions",
            abs(found - expected),
            allowed + VOLUME_RTOL * expected,
            f"the volume with the passive regions is {found:.6g}, but {expected:.6g} +- {allowed:.2g} by a sample of points",
        )
        return CombinedRegions(built, tuple(notes), check)

    def label(self, solids: Sequence[Any], patches: Brep, box: OcctSolids) -> OcctSolids:
        """Solids that the kernel made, with the labels of the bodies' faces, and elsewhere those of `box`, of the same solids."""
        labels = box.labels
        for body in self.bodies:
            own = label_cut_solids(solids, [patches], body).labels
            labels = tuple(
                tuple(name if name in body.face_labels else old for name, old in zip(*pair, strict=True))
                for pair in zip(own, labels, strict=True)
            )
        return OcctSolids(tuple(solids), labels)

    def require_kept(self, dropped: Sequence[float]) -> None:
        """InvalidRequest if a body that is kept is among the loose pieces that were left out, by its volume."""
        for body in self.kept:
            if any(abs(volume - body.volume) < KEPT_VOLUME_RTOL * body.volume for volume in dropped):
                raise InvalidRequest(
                    f"{body.name} touches nothing of the solid and is a loose piece of {body.volume:.4g} mm3, which is left out: "
                    'check its place, or keep loose pieces (loose="keep")'
                )


@dataclass(frozen=True, slots=True, eq=False)
class CombinedRegions:
    """The solids of a field and of bodies, largest first; what is to be told of them, and the check of their volume."""

    built: Solids
    notes: tuple[str, ...]
    check: Check


NO_REGIONS = PassiveRegions()


def _read_all(source: Any) -> tuple[CadBody, ...]:
    if source is None:
        return ()
    return read_bodies(source, None if isinstance(source, CadBody | BodyFile) else ALL)


def _measure_volume(built: Solids) -> float:
    if isinstance(built, BrepSolids):
        return float(built.nesting.volume.sum())
    return sum(map(estimate_volume, built.solids))


def _combine_networks(built: Solids, body: CadBody, operation: Operation) -> Solids:
    """The union or difference by cuts of the patches of the solids and the faces of the body by each other."""
    if not isinstance(built, BrepSolids):
        raise TrimmingError("the kernel made the solid, which has no patches of its own")
    read = read_trimming_body(body)
    with numerical_failures():
        result = combine_networks(built.brep, read.brep, operation, build=build_valid_solids, may_move=False)
    combined: BrepSolids = result.built
    return combined


def _combine_in_kernel(built: Solids, body: CadBody, operation: Operation) -> Solids:
    """The union or difference by the kernel, faces in one plane made one; KernelError if its own check rejects that."""
    count = sum(len(faces_of(solid)) for solid in built.solids)
    if count > MAX_KERNEL_FACES:
        raise KernelError(
            "passive region", f"the solid has {count} faces, more than the {MAX_KERNEL_FACES} that its boolean is given"
        )
    both = SolidSet(built.shape), SolidSet(body.shape, complement=operation == "difference")
    solids = list_solids(merge_faces(combine_sets(-1 if operation == "union" else 1, both).shape))
    if not is_valid(make_compound(solids)):
        raise KernelError("passive region", "the kernel's check rejects what its own boolean made")
    return OcctSolids(solids)


METHODS: Fallbacks[[Solids, CadBody, Operation], Solids] = Fallbacks(
    (
        Fallback("on the parameters of the patches", _combine_networks, "a second for a few thousand patches"),
        Fallback("by the kernel's boolean", _combine_in_kernel, "10 ms for each patch"),
    ),
    remedy="move or resize the body a little, so that none of its faces touches the solid's, or change `tol`",
)
"""How a body is united with a solid, or subtracted from it."""
