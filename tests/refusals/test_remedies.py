"""Remedies that messages name: each was followed on the very request that was refused, and leads to a result that is met."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import product
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields, maps
from tpmscad.errors import InvalidRequest, LevelSetError, TpmscadError

pytestmark = pytest.mark.kernel

Request = Callable[[], Any]
Remedy = Callable[[re.Match[str]], Any]

NUMBER = r"([\d.]+(?:e-?\d+)?)"


def box(size: float = 8.0) -> bd.Part:
    return bd.Box(size, size, size)


def infill(body: Any = None, **options: Any) -> tpmscad.Model:
    given = {"surface": "schwarz_p", "cell": 6, "thickness": 0.8, "tol": 0.1, "progress": False} | options
    return tpmscad.infill(
        box() if body is None else body, given.pop("surface"), **{k: v for k, v in given.items() if v is not None}
    )


def lattice(surface: str = "gyroid", **options: Any) -> tpmscad.Model:
    given = {"cell": 10, "thickness": 1, "tol": 0.1, "progress": False} | options
    return tpmscad.lattice(surface, **{k: v for k, v in given.items() if v is not None})


def fill_cylinder(limit: Callable[[fields.Field], fields.Field]) -> tpmscad.Model:
    fraction = limit(fields.expression("0.2 + 0.12 * sqrt(X^2 + Y^2)"))
    gyroid = fields.tpms("gyroid", 4)
    levels = fields.graded_threshold(gyroid, fraction, (0.19, 0.51), "sheet")
    assert isinstance(levels, tuple)
    return tpmscad.infill(
        fields.cylinder((0, 0, 1), 2.5, height=2), fields.sheet(gyroid, *levels), tol=0.1, progress=False
    )


def solidify(field: fields.Field, tol: float = 0.02) -> tpmscad.Model:
    return tpmscad.solidify(field, ((-4, -4, -4), (4, 4, 4)), tol=tol, progress=False)


def two_boxes() -> bd.Compound:
    return bd.Compound([bd.Solid.make_box(8, 8, 8), bd.Pos(10, 0, 0) * bd.Solid.make_box(8, 8, 8)])


def wedge() -> maps.SplineMap:
    """A cube of edge 8 that widens upwards by a tenth."""
    corners = np.stack(np.meshgrid([0.0, 8.0], [0.0, 8.0], [0.0, 8.0], indexing="ij"), axis=-1)
    corners[:, :, 1, :2] *= 1.1
    return maps.trivariate(corners, knots=[(0, 0, 8, 8)] * 3, degrees=(1, 1, 1))


def thin_sheet() -> fields.Field:
    return fields.sheet(fields.tpms("P", 8.0), -0.03, 0.03)


REMEDIES: dict[str, tuple[Request, str, Remedy]] = {
    "open faces without a skin": (
        lambda: infill(open_faces=">Z"),
        "give skin=",
        lambda _: infill(open_faces=">Z", skin=1),
    ),
    "an unknown selector": (
        lambda: infill(open_faces="top", skin=1),
        r"`>Z`, `<Z`",
        lambda _: infill(open_faces=">Z", skin=1),
    ),
    "a curved open face": (
        lambda: infill(bd.Cylinder(4, 6), open_faces=0, skin=1),
        "keep the skin on it, and drill through it afterwards",
        lambda _: infill(bd.Cylinder(4, 6), skin=1).solid - bd.Rot(0, 90, 0) * bd.Pos(0, 0, 3) * bd.Cylinder(1, 4),
    ),
    "all faces open": (
        lambda: infill(open_faces="|X,|Y,|Z", skin=1),
        "leave skin and open_faces out",
        lambda _: infill(),
    ),
    "a skin that is too thick": (
        lambda: infill(skin=7),
        f"nowhere deeper than {NUMBER}: make it thinner",
        lambda found: infill(skin=0.4 * float(found[1])),
    ),
    "a field with a cell": (
        lambda: infill(surface=fields.sphere((0, 0, 0), 4), cell=6, thickness=None),
        "leave cell out",
        lambda _: infill(surface=fields.sphere((0, 0, 0), 4), cell=None, thickness=None),
    ),
    "a field without tol": (
        lambda: infill(surface=fields.sphere((0, 0, 0), 4), cell=None, thickness=None, tol=None),
        "needs tol=",
        lambda _: infill(surface=fields.sphere((0, 0, 0), 4), cell=None, thickness=None),
    ),
    "too many cells": (lambda: infill(cell=0.05, thickness=0.01), "enlarge the cell", lambda _: infill()),
    "several solids": (
        lambda: infill(two_boxes()),
        r'solid="(largest)"',
        lambda found: infill(two_boxes(), solid=found[1]),
    ),
    "a thickness of a skeletal solid": (
        lambda: lattice(kind="skeletal"),
        "give offset=",
        lambda _: lattice(kind="skeletal", thickness=None, offset=-0.5),
    ),
    "two sizes of a wall": (
        lambda: lattice(porosity=0.8),
        "give exactly one of",
        lambda _: lattice(thickness=None, porosity=0.8),
    ),
    "a fraction of unequal cells": (
        lambda: lattice(cell=(10, 12, 10), thickness=None, volume_fraction=0.2),
        "give `thickness`",
        lambda _: lattice(cell=(10, 12, 10)),
    ),
    "a cell and a size of pores": (
        lambda: lattice(pore_size=4),
        "give `cell` or pore_size, not both",
        lambda _: lattice(cell=None, pore_size=4),
    ),
    "no cell and no size of pores": (lambda: lattice(cell=None), "needs cell=", lambda _: lattice()),
    "pores within a wall that closes them": (
        lambda: lattice(cell=None, pore_size=4, thickness=None, offset=(-40, 40)),
        "thin the wall",
        lambda _: lattice(cell=None, pore_size=4, thickness=None, offset=(-0.4, 0.4)),
    ),
    "the side of a sheet": (
        lambda: lattice(side="+"),
        "kind='skeletal'",
        lambda _: lattice(side="+", kind="skeletal", thickness=None, offset=0.5),
    ),
    "the natural boundary of a skeletal solid": (
        lambda: lattice(kind="skeletal", thickness=None, offset=0.5, boundary="natural"),
        "use boundary='box'",
        lambda _: lattice(kind="skeletal", thickness=None, offset=0.5, boundary="box"),
    ),
    "a tolerance below rounding": (
        lambda: lattice(tol=1e-9),
        f"below {NUMBER}, the least",
        lambda found: lattice(tol=1.01 * float(found[1])),
    ),
    "a wall beyond the least radius of curvature": (
        lambda: lattice(thickness=4),
        f"thickness below {NUMBER}",
        lambda found: lattice(thickness=0.9 * float(found[1])),
    ),
    "unequal cells of a surface whose mirrors they bend": (
        lambda: lattice("neovius", cell=(8, 8, 9.6)),
        "whose periods may be unequal",
        lambda _: solidify(fields.sheet(fields.tpms("neovius", (8, 8, 9.6)), -0.6, 0.6), tol=0.14),
    ),
    "a map of a surface of fitted patches": (
        lambda: lattice("fischer_koch_s", map=maps.stretching((1, 1, 1.2))),
        "whose `domain` takes a spline map of tpmscad.maps",
        lambda _: tpmscad.solidify(
            fields.sheet(fields.tpms("fischer_koch_s", 8), -0.4, 0.4), wedge(), tol=0.25, progress=False
        ),
    ),
    "an octahedron of absolute values": (
        lambda: solidify(fields.expression("abs(X) + abs(Y) + abs(Z) - 2")),
        r"a crease of \d+ degrees there, .*: combine fields by fields.union, fields.intersection",
        lambda _: solidify(fields.intersection(*(fields.linear(s, -2.0) for s in product((-1, 1), repeat=3))), 0.1),
    ),
    "a fraction that leaves its span in the body": (
        lambda: fill_cylinder(lambda fraction: fraction + 0.1),
        r"the volume fraction takes the value 0\.\d+ at \(.*widen the span, or limit the fraction, by fields.clip.*lies in",
        lambda _: fill_cylinder(lambda fraction: fields.clip(fraction + 0.1, 0.19, 0.51)),
    ),
    "a wall too thin for the tolerance": (
        lambda: solidify(thin_sheet(), tol=0.1),
        f"use one below {NUMBER}",
        lambda found: solidify(thin_sheet(), tol=0.9 * float(found[1])),
    ),
}


@pytest.mark.parametrize("name", REMEDIES)
def test_the_remedy_of_a_refusal_leads_to_a_result(name: str) -> None:
    request, words, remedy = REMEDIES[name]
    with pytest.raises(TpmscadError) as caught:
        request()
    assert isinstance(caught.value, InvalidRequest | LevelSetError)
    found = re.search(words, str(caught.value))
    assert found, str(caught.value)
    result = remedy(found)
    assert result.is_valid if isinstance(result, bd.Shape) else result.certificate.met
