"""The request for a lattice: its keywords, and their validation into one frozen value.

`LatticeOptions` and `InfillOptions` are the keywords of `tpmscad.lattice` and `tpmscad.infill` as typed dictionaries, for the
functions that pass them on. `resolve_lattice_request` validates them once; in a `LatticeRequest` every value is finite, in range
and consistent with the others, and a thickness or a volume fraction has become a pair of normal offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter, signature
from typing import Any, TypedDict, TypeVar, Unpack

import numpy as np
from scipy.spatial.transform import Rotation

from tpmscad import surfaces
from tpmscad._typing import Array, ProgressOption
from tpmscad.errors import InvalidRequest
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.sources import lattice_source
from tpmscad.requests.keyword_checks import (
    check_cell_counts,
    check_positive,
    check_positive_triple,
    check_triple,
)
from tpmscad.requests.pore_request import solve_cell
from tpmscad.requests.wall_request import resolve_wall

MIN_TOL = 2e-7
"""Model units: twice the distance of 1e-7 below which the kernel merges points."""

MIN_TOL_CELLS = 1e-7
"""In cells: the deviation that patches of degree 18 reach before round-off spoils the smoothness of their joints."""

DEFAULT_TOL_CELLS = 1e-3
"""In cells, of the smallest cell edge: the tolerance if none is given."""

KINDS = ("sheet", "skeletal")
SIDES = ("-", "+")
REFERENCES = ("minimal", "nodal")
BOUNDARIES = ("box", "natural")

EXACT_ROTATION_TOL = 1e-15
"""A rotation matrix within this distance of one with entries -1, 0 and 1 becomes that matrix."""


class WallOptions(TypedDict, total=False):
    """The keywords that `lattice`, `infill` and `fluid_domains` share."""

    offset: float | Sequence[float] | None
    volume_fraction: float | None
    porosity: float | None
    pore_size: float | None
    reference: str | None
    phase: Sequence[float] | None
    tol: float | None
    progress: ProgressOption


class LatticeOptions(WallOptions, total=False):
    """The keywords of `lattice`."""

    cell: float | Sequence[float] | None
    cells: int | Sequence[int]
    thickness: float | Callable[[Array], Array] | None
    kind: str
    side: str
    boundary: str
    loose: str
    map: Map | Callable[[Array], Array] | None


class InfillOptions(WallOptions, total=False):
    """The keywords of `infill`; a field takes `tol`, `skin`, `open_faces` and `progress` only."""

    cell: float | Sequence[float] | None
    thickness: float | None
    kind: str
    side: str
    rotation: Sequence[float]
    skin: float | None
    open_faces: Iterable[Any]
    loose: str


LATTICE_DEFAULTS: Mapping[str, Any] = {
    "cell": None,
    "cells": (1, 1, 1),
    "thickness": None,
    "offset": None,
    "volume_fraction": None,
    "porosity": None,
    "pore_size": None,
    "kind": "sheet",
    "side": "-",
    "reference": None,
    "boundary": "box",
    "phase": None,
    "loose": "drop",
    "map": None,
    "tol": None,
    "progress": None,
}
"""Defaults of the keywords of `lattice`."""

INFILL_DEFAULTS: Mapping[str, Any] = {
    "cell": None,
    "thickness": None,
    "offset": None,
    "volume_fraction": None,
    "porosity": None,
    "pore_size": None,
    "kind": "sheet",
    "side": "-",
    "reference": None,
    "phase": None,
    "rotation": (0.0, 0.0, 0.0),
    "skin": None,
    "open_faces": (),
    "loose": "drop",
    "tol": None,
    "progress": None,
}
"""Defaults of the keywords of `infill`."""

F = TypeVar("F", bound=Callable[..., Any])


def with_keywords_of(reference: Callable[..., Any]) -> Callable[[F], F]:
    """Decorator that shows the keywords of `reference` in the signature of a function that takes them as `**options`.

    `inspect.signature`, `help` and the completion of interactive shells read the signature; type checkers read the annotation
    `**options: Unpack[...]`. The keywords of the function itself follow those of `reference`.
    """

    def decorate(function: F) -> F:
        parameters = list(signature(function).parameters.values())
        keywords = [p for p in signature(reference).parameters.values() if p.kind is Parameter.KEYWORD_ONLY]
        leading = [p for p in parameters if p.kind not in (Parameter.KEYWORD_ONLY, Parameter.VAR_KEYWORD)]
        own = [p for p in parameters if p.kind is Parameter.KEYWORD_ONLY]
        shown = signature(function).replace(parameters=[*leading, *keywords, *own])
        function.__signature__ = shown  # type: ignore[attr-defined]
        return function

    return decorate


@dataclass(frozen=True, slots=True)
class LatticeRequest:
    """A valid request for a lattice, in model units.

    `cell` holds the three edges, `cells` the counts, `offset` the normal distances of the two walls (sheet) or of the one surface
    twice (skeletal), `levels` the nodal levels of the two walls if they are no offsets of one surface, `notes` what the
    certificate says of the wall, `phase` the shift in cells, `tol` the greatest deviation. `thickness` is that of a graded wall,
    a function of points of the model; the offsets are then multiples of it.
    """

    surface: str
    cell: tuple[float, float, float]
    cells: tuple[int, int, int]
    offset: tuple[float, float]
    kind: str
    side: str
    reference: str
    boundary: str
    phase: tuple[float, float, float]
    tol: float
    levels: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    thickness: Callable[[Array], Array] | None = None

    @property
    def layer_offsets(self) -> tuple[float | None, float | None]:
        """Normal distances of the lower and the upper bounding surface; None where the solid has no wall on that side.

        The lower surface faces decreasing nodal values: it bounds a skeletal solid on the "+" side.
        """
        if self.kind == "sheet":
            return self.offset
        return (self.offset[0], None) if self.side == "+" else (None, self.offset[0])


def resolve_lattice_request(surface: str, **options: Unpack[LatticeOptions]) -> LatticeRequest:
    """The valid request of `surface` and the keywords of `lattice`; InvalidRequest names the value, the limit and the remedy."""
    given: dict[str, Any] = {**LATTICE_DEFAULTS, **options}
    info = surfaces.find_surface(surface)
    name = info.name
    if given["reference"] is None:
        given["reference"] = info.references[0] if info.references else REFERENCES[0]
    for keyword, choices in (
        ("kind", KINDS),
        ("side", SIDES),
        ("reference", REFERENCES),
        ("boundary", BOUNDARIES),
    ):
        if given[keyword] not in choices:
            raise InvalidRequest(
                f"{keyword} {given[keyword]!r} is unknown; choose one of {', '.join(map(repr, choices))}"
            )
    kind, side, reference, boundary = (given[keyword] for keyword in ("kind", "side", "reference", "boundary"))
    surfaces.check_reference(info, reference)
    if kind == "sheet" and side == "+":
        raise InvalidRequest(
            "side='+' says which side of one surface is solid, but a sheet is the wall between two: leave `side` out, or give "
            "kind='skeletal'"
        )
    if kind == "skeletal" and boundary == "natural":
        raise InvalidRequest(
            "a skeletal solid has no natural boundary: nothing bridges one surface; use boundary='box'"
        )
    pore_notes: tuple[str, ...] = ()
    if given["pore_size"] is not None:
        given["cell"], pore_notes = solve_cell(name, given)
    elif given["cell"] is None:
        raise InvalidRequest(f"a lattice of the {name} needs cell=, the edge length of its cell, or pore_size=")
    edges = check_positive_triple("cell", given["cell"])
    counts = check_cell_counts(given["cells"])
    phase = _resolve_phase(info, given)
    has_mapping = given["map"] is not None or len(set(edges)) > 1
    if info.primitives == "level set":
        _check_level_set_request(info.title, boundary, given["map"])
    elif has_mapping and not lattice_source(name, reference).can_be_mapped:
        raise InvalidRequest(
            f"a map or unequal cell edges {list(edges)} bend the mirror planes of the {info.title}, between which its patches "
            "are made: give one cell edge and no map, or make a solid of the mapped field with tpmscad.solidify"
        )
    tol = DEFAULT_TOL_CELLS * min(edges) if given["tol"] is None else check_positive("tol", given["tol"])
    least = max(MIN_TOL, MIN_TOL_CELLS * min(edges))
    if tol < least:
        raise InvalidRequest(
            f"tol {tol:g} is below {least:g}, the least that float64 and the kernel's 1e-7 allow at cell {min(edges):g}; "
            "ask for more, or scale the model up"
        )
    wall = resolve_wall(name, given, edges[0], has_mapping)
    if not has_mapping:
        for distance in wall.offset:
            surfaces.check_offset(name, reference, distance, edges[0])
    return LatticeRequest(
        name,
        edges,
        counts,
        wall.offset,
        kind,
        side,
        reference,
        boundary,
        phase,
        tol,
        wall.levels,
        (*wall.notes, *pore_notes),
        wall.thickness,
    )


def _resolve_phase(info: surfaces.SurfaceRecord, given: Mapping[str, Any]) -> tuple[float, float, float]:
    """The phase asked for; by default the one that makes one piece in a box, and none for whole patches or under a map."""
    if given["phase"] is not None:
        return check_triple("phase", given["phase"])
    if given["boundary"] == "natural" or given["map"] is not None:
        return 0.0, 0.0, 0.0
    return info.one_piece.phase_of(given["kind"], given["side"])


def _check_level_set_request(title: str, boundary: str, map: Any) -> None:
    """InvalidRequest for what a lattice of fitted level-set patches cannot have."""
    if map is not None:
        raise InvalidRequest(
            f"the patches of the {title} are fitted to one period and copied, which a map does not allow: "
            "make a solid of the mapped field with tpmscad.solidify"
        )
    if boundary == "natural":
        raise InvalidRequest(
            f"the patches of the {title} do not end at a boundary of whole cells, so it has no natural one: "
            "use boundary='box'"
        )


def lattice_size(surface: str, options: Mapping[str, Any]) -> tuple[float, float, float]:
    """Edge lengths of the box of `cells` x `cell` that the lattice of these keywords of `lattice` fills."""
    cell = options.get("cell")
    if cell is None:  # it follows from the pore size
        cell = resolve_lattice_request(surface, **options).cell
    counts = np.broadcast_to(np.asarray(options.get("cells", 1), float), 3)
    x, y, z = (np.broadcast_to(np.asarray(cell, float), 3) * counts).tolist()
    return x, y, z


def rotation_matrix(rotation: Sequence[float]) -> Array:
    """Matrix (3, 3) of intrinsic rotations about x, y and z, in degrees; quarter turns are exact."""
    matrix = Rotation.from_euler("XYZ", rotation, degrees=True).as_matrix()
    rounded = np.rint(matrix)
    return np.asarray(rounded if np.abs(matrix - rounded).max() < EXACT_ROTATION_TOL else matrix)
