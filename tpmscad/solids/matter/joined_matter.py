"""Matter with solids that a body keeps: both are united before the body cuts them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, translate_brep
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.body_brep import FreeFormBody
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.results.certificate import PatchMeasures
from tpmscad.solids.cut import Finish, Matter, read_trimming_body, try_placements
from tpmscad.solids.matter.reference_distance import DistanceFunction
from tpmscad.trimming.network_boolean import DividedNetwork, NetworkResult, Operation, combine_networks, divide_network


@dataclass(frozen=True, eq=False)
class JoinedMatter:
    """Matter, and solids whose part in the body is kept; their faces cross those of the body, and are not moved."""

    matter: Matter
    kept: Sequence[CadBody]

    @property
    def name(self) -> str:
        """That of the matter."""
        return self.matter.name

    @property
    def patches(self) -> Brep:
        """Those of the matter."""
        return self.matter.patches

    @property
    def closed(self) -> Brep:
        """The union where it stands."""
        return self._unite(np.zeros(3))

    @cached_property
    def kept_breps(self) -> list[Brep]:
        """The boundary representations of what is kept, read once for all placements."""
        return [read_trimming_body(body).brep for body in self.kept]

    @property
    def measures(self) -> PatchMeasures:
        """Those of the matter: the others are exact."""
        return self.matter.measures

    @property
    def distance(self) -> DistanceFunction:
        """Of points from the surface of the matter."""
        return self.matter.distance

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in the matter or in what is kept."""
        inside = np.array(self.matter.contains(points))
        for body in self.kept:
            inside[~inside] = contains_points(body.shape, points[~inside])
        return inside

    def cut(self, domain: FreeFormBody, operation: Operation, finish: Finish) -> NetworkResult:
        """A body cut by the union of both, the matter moved where that is needed."""

        def cut_at(shift: Array) -> NetworkResult:
            found = combine_networks(domain.brep, self._unite(shift), operation, may_move=False, build=finish)
            return replace(found, report=replace(found.report, shift=shift))

        return try_placements(cut_at, self.measures.tol)

    def divide(self, domain: Brep, build: Callable[[DividedNetwork], Any]) -> DividedNetwork:
        """A body divided by the union of both into what lies in it and what does not."""

        def divide_at(shift: Array) -> DividedNetwork:
            found = divide_network(domain, self._unite(shift), build=build, may_move=False)
            return replace(found, report=replace(found.report, shift=shift))

        return try_placements(divide_at, self.measures.tol)

    def _unite(self, shift: Array) -> Brep:
        """The union with the matter translated by a vector."""
        closed = self.matter.closed
        return reduce(
            lambda brep, own: combine_networks(brep, own, "union", may_move=False).brep,
            self.kept_breps,
            translate_brep(closed, shift) if shift.any() else closed,
        )

    def intersect_in_kernel(self, shape: Any) -> tuple[Any, ...]:
        """InvalidRequest: what is kept is united with the result then."""
        raise InvalidRequest("solids that are kept are joined with the lattice on the parameters of its patches only")

    def measure(self, solids: BrepSolids | OcctSolids, moved: float) -> PatchMeasures:
        """As of the matter."""
        return self.matter.measure(solids, moved)
