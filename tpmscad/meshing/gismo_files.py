"""Trivariate splines in the XML of G+Smo, the format in which libraries of isogeometric analysis exchange multipatch bodies.

A body is a `Geometry` of type TensorBSpline3: three knot vectors and the poles, u fastest. The `MultiPatch` lists the bodies,
their interfaces and the sides at the boundary. An interface names two bodies and their sides, the direction of the second that
each direction of the first runs along, and whether in the same sense. Sides are numbered 1 and 2 at the ends of u, 3 and 4 at
those of v, 5 and 6 at those of w.

All bodies are right-handed. Source: gsXmlUtils and gsBoundary of G+Smo (gismo.github.io); splinepy reads and writes the format.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tpmscad._typing import Array
from tpmscad.atomic_file import atomic_write
from tpmscad.lattices.spline_volumes import SideConnectivity, SplineVolumes
from tpmscad.splines.bspline_volume import BSplineVolume

FIRST_ID = 100
"""Number of the first body, as splinepy has it."""

GISMO_SIDES = (3, 2, 4, 1)
"""G+Smo's number of side 0 to 3 of a quadrilateral, counter-clockwise from v = v0."""

AXIS_ALONG, AXIS_ACROSS = (0, 1, 0, 1), (1, 0, 1, 0)
"""The direction (0: u, 1: v) along each side and across it."""

RUNS_UPWARDS, AT_HIGH_END = (True, True, False, False), (False, True, True, False)
"""Whether each side runs with its parameter, and whether it lies at the high end of the other."""

LOWER, UPPER = 5, 6
"""G+Smo's numbers of the sides w = w0 and w = w1."""


def write_gismo(volumes: SplineVolumes, path: Path) -> None:
    """Write the bodies with their interfaces, and their boundary in the groups "surface +", "surface -" and "gap" or "cap"."""
    root = ElementTree.Element("xml")
    shared = volumes.connect()
    n = len(volumes)
    multipatch = ElementTree.SubElement(root, "MultiPatch", parDim="3", id="0")
    ElementTree.SubElement(multipatch, "patches", type="id_range").text = f"{FIRST_ID} {FIRST_ID + n - 1}"
    ElementTree.SubElement(multipatch, "interfaces").text = "\n".join(
        " ".join(map(str, row)) for row in _list_interfaces(volumes, shared)
    )
    for name, rows in _list_boundaries(volumes, shared).items():
        group = ElementTree.SubElement(multipatch, "boundary", name=name)
        group.text = "\n".join(f"{FIRST_ID + body} {side}" for body, side in rows)
    for index in range(n):
        _add_geometry(root, volumes.body(index), FIRST_ID + index)
    ElementTree.indent(root)
    content = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    with atomic_write(path) as target:
        target.write_bytes(content)


def _list_interfaces(volumes: SplineVolumes, shared: SideConnectivity) -> Iterator[tuple[int, ...]]:
    """Rows of the interfaces: body, side, body, side, directions (3), senses (3)."""
    order = np.argsort(shared.side.ravel(), kind="stable")
    label = shared.side.ravel()[order]
    for i in np.flatnonzero(label[1:] == label[:-1]).tolist():
        (body, side), (other, end) = (divmod(int(order[j]), 4) for j in (i, i + 1))
        along, across, through = 0, 0, int(volumes.sense[body] == volumes.sense[other])
        same = shared.direction[body, side] == shared.direction[other, end]
        along = int(same == (RUNS_UPWARDS[side] == RUNS_UPWARDS[end]))
        across = int(AT_HIGH_END[side] != AT_HIGH_END[end])
        directions, senses = [0, 0, 2], [0, 0, through]
        directions[AXIS_ALONG[side]], senses[AXIS_ALONG[side]] = AXIS_ALONG[end], along
        directions[AXIS_ACROSS[side]], senses[AXIS_ACROSS[side]] = AXIS_ACROSS[end], across
        yield FIRST_ID + body, GISMO_SIDES[side], FIRST_ID + other, GISMO_SIDES[end], *directions, *senses


def _list_boundaries(volumes: SplineVolumes, shared: SideConnectivity) -> dict[str, list[tuple[int, int]]]:
    """Bodies and sides of each group at the boundary; in a body that was left-handed, w runs downwards."""
    upright = (volumes.sense > 0).tolist()
    groups = {
        "surface +": [(i, UPPER if up else LOWER) for i, up in enumerate(upright)],
        "surface -": [(i, LOWER if up else UPPER) for i, up in enumerate(upright)],
        volumes.border: [(int(i), GISMO_SIDES[side]) for i, side in np.argwhere(shared.is_open).tolist()],
    }
    return {name: rows for name, rows in groups.items() if rows}


def _add_geometry(root: ElementTree.Element, body: BSplineVolume, number: int) -> None:
    """Append a body."""
    geometry = ElementTree.SubElement(root, "Geometry", type="TensorBSpline3", id=str(number))
    basis = ElementTree.SubElement(geometry, "Basis", type="TensorBSplineBasis3")
    for axis, (knots, degree) in enumerate(zip(body.knots, body.degrees, strict=True)):
        along = ElementTree.SubElement(basis, "Basis", type="BSplineBasis", index=str(axis))
        ElementTree.SubElement(along, "KnotVector", degree=str(degree)).text = _format(knots)
    poles = body.poles.transpose(2, 1, 0, 3).reshape(-1, 3)
    coefficients = ElementTree.SubElement(geometry, "coefs", geoDim="3")
    coefficients.text = "\n".join(_format(pole) for pole in poles)


def _format(numbers: Array) -> str:
    """Numbers with all their digits."""
    return " ".join(map(repr, numbers.tolist()))
