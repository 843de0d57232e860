"""Passive regions: CAD bodies that the solid of a field contains, such as bosses and flanges, or that stay empty, such as bores.

The faces of these bodies are exact in the result. A body is united with the solid, or subtracted from it, on the parameters of
patches, planes and quadrics (`trimming.network_boolean`), without being moved. Where it is flush with a side of the box, or that
fails otherwise, the kernel does it, and makes one face of those in one plane. Either way the volume is compared with even samples
of points in the bodies, which no boolean takes part in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, KernelError, NothingLeft, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.cad_body import BodyFile, CadBody, read_bodies, read_body
from tpmscad.kernel.body_import.solid_choice import ALL
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, estimate_volume, intersect_solids, merge_faces
from tpmscad.kernel.boolean.cut_faces import label_cut_solids
from tpmscad.kernel.boolean.kept_solids import Hole, find_holes, grow_beyond
from tpmscad.kernel.boolean.solid_trees import SolidSet, combine_sets, list_solids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.results.certificate import Check
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import (
    Domain,
    MadeSolids,
    build_valid_solids,
    numerical_failures,
    read_trimming_body,
    require_few_faces,
)
from tpmscad.solids.matter.crossing_fields import Remake
from tpmscad.solids.matter.patch_measures import move_patch_measures
from tpmscad.solids.volume_samples import estimate_fraction, sample_body
from tpmscad.trimming.network_boolean import Operation, combine_networks

VOLUME_RTOL = 1e-5
"""Of the volume: what its quadrature by the kernel may be off by, beside the error of the samples."""

KEPT_VOLUME_RTOL = 1e-4
"""Difference between the volumes of a body and of a loose piece at which they are the same."""

BOSSES = "bosses"
"""The word for the surroundings of round holes."""

Solids = BrepSolids | OcctSolids


@dataclass(frozen=True, eq=False)
class PassiveRegions:
    """Bodies that a solid contains (`kept`), and bodies that stay empty (`cleared`), those after those. They may overlap.

    within: bodies of which a filled body contains the part that lies in it; their faces cross those of the body.
    """

    kept: tuple[CadBody, ...] = ()
    cleared: tuple[CadBody, ...] = ()
    within: tuple[CadBody, ...] = ()

    @classmethod
    def read(cls, keep: Any = None, clear: Any = None) -> PassiveRegions:
        """All solids of shapes or CAD files, of which each may be None; errors as `read_bodies`."""
        if _split_bosses(keep)[0]:
            raise InvalidRequest(
                'keep=("bosses", width) is for the round holes of a CAD body: give the bosses as solids'
            )
        return cls(_read_all(keep, "kept"), _read_all(clear, "cleared"))

    @classmethod
    def read_for(
        cls, body: CadBody, is_exact: bool, keep: Any = None, clear: Any = None, skin: float | None = None
    ) -> PassiveRegions:
        """The same for a body that is filled, with the surroundings of its holes if ("bosses", width) are kept.

        Surroundings no wider than a `skin` lie in it, and need nothing. A body that is kept and shares faces with the filled one,
        which is_exact, is grown beyond them, so that it lies `within`.
        """
        cleared = _read_all(clear, "cleared")
        bosses, others = _split_bosses(keep)
        holes = [hole for one in bosses for hole in _find_bosses(body, is_exact, one) if skin is None or one[1] > skin]
        kept = _read_all(others, "kept")
        holes = [replace(hole, role=f"kept {number}") for number, hole in enumerate(holes, len(kept) + 1)]
        grown = {i: grow_beyond(each.shape, body.shape) for i, each in enumerate(kept)} if is_exact else {}
        within = [replace(kept[i], shape=solid) for i, solid in grown.items() if solid is not None]
        apart = [each for i, each in enumerate(kept) if grown.get(i) is None]
        return cls(tuple(apart), cleared, (*within, *holes))

    def cut_within(self, body: CadBody) -> PassiveRegions:
        """The regions with the parts of what is kept `within` the body among what is kept."""
        parts = [
            replace(read_body(solid), name=each.name, role=each.role)
            for each in self.within
            for solid in intersect_solids(each.shape, body.shape)
        ]
        return PassiveRegions((*self.kept, *parts), self.cleared)

    @property
    def bodies(self) -> tuple[CadBody, ...]:
        """All bodies."""
        return self.kept + self.cleared

    @property
    def steps(self) -> tuple[tuple[Operation, CadBody], ...]:
        """How each body is combined with the solid, one after the other."""
        return (*(("union", body) for body in self.kept), *(("difference", body) for body in self.cleared))

    @cached_property
    def breps(self) -> tuple[tuple[Operation, Brep], ...]:
        """The same with the boundary representations, read once for all placements."""
        return tuple((operation, _read_brep(body)) for operation, body in self.steps)

    @cached_property
    def solid_breps(self) -> tuple[Brep, ...]:
        """The boundary representations of what is kept, bodies that touch being one."""
        kept = self.kept + self.within
        if len(kept) > 1:
            kept = _read_all(merge_faces(combine_sets(-1, [SolidSet(body.shape) for body in kept]).shape), "kept")
        return tuple(map(_read_brep, kept))

    def describe(self) -> tuple[str, ...]:
        """What is contained or stays empty, with its volume."""
        return tuple(
            f"{body.name} {'is contained' if operation == 'union' else 'stays empty'}, {body.volume:.6g} mm3"
            for operation, body in self.steps
        )

    def hold(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in one of the bodies that are kept."""
        return np.any([contains_points(body.shape, points) for body in self.kept], axis=0)

    def require_inside(self, body: Domain, what: str = "") -> None:
        """InvalidRequest if a body that is kept reaches beyond the filled one, of which a message says `what` it has."""
        for kept in self.kept:
            if not body.contains(sample_body(kept)).all():
                raise InvalidRequest(
                    f"{kept.name} reaches beyond {body.name}{what}: unite both in the CAD system first, and keep it then"
                )

    def touch(self, brep: Brep) -> bool:
        """Whether faces of a body lie in those of a solid, so that no placement of what fills it lets both be combined."""
        try:
            self.finish(brep)
        except NothingLeft:
            return False
        except (TrimmingError, InvalidRequest):
            return True
        return False

    def combine(self, made: MadeSolids, remake: Remake | None = None) -> MadeSolids:
        """The union of solids with the bodies that are kept, without those that are cleared.

        remake: makes the solids again, moved a little, where faces of a body touch theirs without crossing. KernelError if a body
        can neither be united nor subtracted.
        """
        outcome = METHODS.run(self, made, remake)
        built, moved = outcome.value
        reasons = f": {outcome.reasons}" if outcome.failures else ""
        measures = move_patch_measures(made.measures, moved) if moved else made.measures
        combined = replace(
            made,
            built=built,
            patches=built.brep if isinstance(built, BrepSolids) else made.patches,
            measures=measures,
            label=partial(self._label, made),
            valid=True,
            is_cut=True,
        )
        return self.check(combined, _measure_volume(made.built), made.contains, f"{outcome.name}{reasons}")

    def check(self, made: MadeSolids, before: float, contains: Callable[[Array], BoolArray], how: str) -> MadeSolids:
        """Solids with notes on the bodies, and the check of their volume, `before` without them, by even samples of points.

        contains: whether points (n, 3) lay in the solids before, by what they were made from.
        """
        expected, allowed, notes = before, 0.0, []
        for number, (operation, body) in enumerate(self.steps):
            kept = operation == "union"
            points = sample_body(body)
            inside = contains(points)
            for earlier, other in self.steps[:number]:
                within = contains_points(other.shape, points)
                inside = inside | within if earlier == "union" else inside & ~within
            fraction, error = estimate_fraction(inside)
            expected += ((1.0 - fraction) if kept else -fraction) * body.volume
            allowed += error * body.volume
            what = f"{'contained' if kept else 'empty'}, {100.0 * fraction:.3g} % of it was solid before"
            notes += [f"{body.name} is {what}; {how}", *body.notes]
        found = _measure_volume(made.built)
        check = Check(
            "volume with the passive regions",
            abs(found - expected),
            allowed + VOLUME_RTOL * expected,
            f"the volume with the passive regions is {found:.6g}, but {expected:.6g} +- {allowed:.2g} by a sample of points",
        )
        return replace(made, notes=(*made.notes, *notes), checks=(*made.checks, check))

    def finish(self, brep: Brep) -> BrepSolids:
        """The valid solids of a boundary representation with what is kept, without what is cleared, by cuts of their faces."""
        for operation, own in self.breps:
            brep = _combine(brep, own, operation)
        return build_valid_solids(brep)

    def carve(self, voids: Brep) -> BrepSolids:
        """Voids without what is kept; NothingLeft if that holds them."""
        return build_valid_solids(reduce(lambda brep, own: _combine(brep, own, "difference"), self.solid_breps, voids))

    def finish_one_by_one(self, built: Solids) -> Solids:
        """The same as `finish`, each body by the kernel where the cut fails; faces in one plane are then made one."""
        for operation, body in self.steps:
            built = ONE_BODY.run(built, body, operation).value
        return built

    def _label(self, made: MadeSolids, solids: tuple[Any, ...]) -> OcctSolids:
        """Solids that the kernel made, with the labels of the bodies' faces, and elsewhere those of what was made before."""
        found = made.label(solids)
        labels = found.labels
        for body in self.bodies:
            own = label_cut_solids(solids, made.patches, body).labels
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


NO_REGIONS = PassiveRegions()


def divide_kept(keep: Any, bodies: Sequence[KernelBody]) -> list[list[Any]]:
    """What each of several bodies keeps of what is given: solids that lie in it, and surroundings of its round holes.

    InvalidRequest for a solid that lies in none of the bodies, and for the surroundings of holes that none of them has.
    """
    bosses, others = _split_bosses(keep)
    divided: list[list[Any]] = [[] for _ in bodies]
    for kept in _read_all(others, "kept"):
        points = sample_body(kept)
        holding = [own for own, body in zip(divided, bodies, strict=True) if body.contains(points).all()]
        if not holding:
            raise InvalidRequest(
                f"{kept.name} lies in none of the {len(bodies)} solids as a whole: divide it where they end, and keep its parts"
            )
        for own in holding:
            own.append(kept)
    for one in bosses:
        refusals = []
        for own, body in zip(divided, bodies, strict=True):
            try:
                _choose_holes(body.cad, True, one)
            except InvalidRequest as refusal:
                refusals.append(refusal)
            else:
                own.append(one)
        if len(refusals) == len(bodies):
            raise refusals[0]
    return divided


def _split_bosses(keep: Any) -> tuple[list[Sequence[Any]], list[Any]]:
    """The ("bosses", width) of what is kept, alone or in a list, and the shapes and files."""
    given = [] if keep is None else [keep] if _is_bosses(keep) or not isinstance(keep, list | tuple) else list(keep)
    return [one for one in given if _is_bosses(one)], [one for one in given if not _is_bosses(one)]


def _is_bosses(keep: Any) -> bool:
    return isinstance(keep, Sequence) and len(keep) > 0 and isinstance(keep[0], str) and keep[0] == BOSSES


def _find_bosses(body: CadBody, is_exact: bool, keep: Sequence[Any]) -> tuple[CadBody, ...]:
    """The surroundings of the holes of a body, of all or of one radius; InvalidRequest if it has none."""
    return tuple(
        replace(read_body(hole.grow(keep[1])), name=f"the hole of radius {hole.radius:g} with {keep[1]:g} around it")
        for hole in _choose_holes(body, is_exact, keep)
    )


def _choose_holes(body: CadBody, is_exact: bool, keep: Sequence[Any]) -> list[Hole]:
    """The holes of a body whose surroundings are kept; InvalidRequest if it has none, or if `keep` is malformed."""
    numbers = [value for value in keep[1:] if isinstance(value, int | float) and 0 < value < np.inf]
    if len(keep) not in (2, 3) or len(numbers) != len(keep) - 1:
        raise InvalidRequest(
            f'keep={tuple(keep)!r} must be ("bosses", width), or ("bosses", width, radius), with lengths above 0 in mm'
        )
    _, *radius = numbers
    holes = find_holes(body.shape) if is_exact else ()
    radii = sorted({round(hole.radius, 6) for hole in holes})
    chosen = [hole for hole in holes if not radius or abs(hole.radius - radius[0]) < 1e-6 * radius[0]]
    if not chosen:
        listed = (
            f"its round holes have radii of {', '.join(f'{r:g}' for r in radii)}" if radii else "it has no round holes"
        )
        raise InvalidRequest(f'keep=("bosses", {", ".join(f"{v:g}" for v in keep[1:])}): {body.name}: {listed}')
    return chosen


def _read_all(source: Any, role: str) -> tuple[CadBody, ...]:
    """All solids of a source, or of several, their faces labelled by a role, and by a number if there are several."""
    bodies: list[CadBody] = []
    for each in source if isinstance(source, list | tuple) else [] if source is None else [source]:
        bodies += read_bodies(each, None if isinstance(each, CadBody | BodyFile) else ALL, f"the {role} shape")
    if len(bodies) == 1:
        return (replace(bodies[0], role=role),)
    return tuple(replace(body, role=f"{role} {number}") for number, body in enumerate(bodies, 1))


def _measure_volume(built: Solids) -> float:
    if isinstance(built, BrepSolids):
        return float(built.nesting.volume.sum())
    return sum(map(estimate_volume, built.solids))


def _read_brep(body: CadBody) -> Brep:
    """The boundary representation of a CAD body."""
    with numerical_failures():
        return read_trimming_body(body).brep


def _combine(first: Brep, second: Brep, operation: Operation) -> Brep:
    """A union or difference by cuts of the faces by each other, neither being moved."""
    with numerical_failures():
        return combine_networks(first, second, operation, may_move=False).brep


def _require_patches(built: Solids) -> Brep:
    """The boundary representation of solids; TrimmingError of those that the kernel made."""
    if not isinstance(built, BrepSolids):
        raise TrimmingError("the kernel made the solid, which has no patches of its own")
    return built.brep


Finished = tuple[Solids, float]
"""Solids, and the length by which they were moved."""


def _finish_on_patches(regions: PassiveRegions, made: MadeSolids, remake: Remake | None) -> Finished:
    return regions.finish(_require_patches(made.built)), 0.0


def _finish_moved(regions: PassiveRegions, made: MadeSolids, remake: Remake | None) -> Finished:
    if remake is None:
        raise InvalidRequest("the solid is not moved")
    return remake(regions.finish)


def _finish_one_by_one(regions: PassiveRegions, made: MadeSolids, remake: Remake | None) -> Finished:
    return regions.finish_one_by_one(made.built), 0.0


def _combine_in_kernel(built: Solids, body: CadBody, operation: Operation) -> Solids:
    """The union or difference by the kernel, faces in one plane made one; KernelError if its own check rejects that."""
    require_few_faces(sum(len(faces_of(solid)) for solid in built.solids))
    both = SolidSet(built.shape), SolidSet(body.shape, complement=operation == "difference")
    solids = list_solids(merge_faces(combine_sets(-1 if operation == "union" else 1, both).shape))
    if not is_valid(make_compound(solids)):
        raise KernelError("passive region", "the kernel's check rejects what its own boolean made")
    return OcctSolids(solids)


def _combine_patches(built: Solids, body: CadBody, operation: Operation) -> Solids:
    """The union or difference by cuts of the faces by each other."""
    return build_valid_solids(_combine(_require_patches(built), _read_brep(body), operation))


ONE_BODY: Fallbacks[[Solids, CadBody, Operation], Solids] = Fallbacks(
    (Fallback("on the patches", _combine_patches), Fallback("by the kernel", _combine_in_kernel))
)
"""How one body is united with a solid, or subtracted from it."""

METHODS: Fallbacks[[PassiveRegions, MadeSolids, Remake | None], Finished] = Fallbacks(
    (
        Fallback("on the parameters of the patches", _finish_on_patches, "a second for a few thousand patches"),
        Fallback(
            "on their parameters, the solid moved within its tolerance", _finish_moved, "as much for each placement"
        ),
        Fallback("by the kernel's boolean", _finish_one_by_one, "10 ms for each patch"),
    ),
    remedy="move or resize the body a little, so that none of its faces touches the solid's, or change `tol`",
)
"""How bodies are united with a solid, and subtracted from it."""
