"""Translated copies of a STEP file, exact to the last digit.

The writer rounds the points of a file to one decimal grid. Here a coordinate is an integer in units of that grid, so that a
translation by a multiple of the unit is exact, and a copy differs from its original in these coordinates, in its names and in its
time stamp, and in nothing else. `compare_with_original` reads both files again and says where that does not hold.

Copies that lie side by side share their cut faces: `join_at_cuts` gives the points in opposite cut faces of the originals the
same coordinates, so that adjacent copies agree there in every digit.
"""

from __future__ import annotations

import mmap
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from itertools import zip_longest
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import BoolArray, IntArray
from tpmscad.errors import InvalidRequest, KernelError, TrimmingError
from tpmscad.kernel.step.geometry_entities import COORDINATE_DIGITS
from tpmscad.kernel.step.part21 import format_string

POINT = re.compile(rb"#(\d+)=CARTESIAN_POINT\('[^']*',\(([^,)]+),([^,)]+),([^,)]+)\)\);")
CURVE_OR_VERTEX = re.compile(
    rb"=(?:VERTEX_POINT\('[^']*',(#\d+)\)|B_SPLINE_CURVE_WITH_KNOTS\('[^']*',\d+,\(([#\d,]+)\))"
)
ORIGIN = re.compile(rb"=ADVANCED_BREP_SHAPE_REPRESENTATION\('[^']*',\(#(\d+),")
FILE_NAME = re.compile(rb"FILE_NAME\('[^']*',\s*'[^']*',")

NEXT_POINT = b"));\n#%d=CARTESIAN_POINT('',("
"""The text between the coordinates of a point and those of the next."""

CUT_TOL_UNITS = 50
"""Units of the grid: a point this near to a plane of cut lies in it. Points of cut curves lie within 5 units of it."""

GREATEST_JOIN_UNITS = 6 * CUT_TOL_UNITS
"""Bound of the way of a point that joins the cuts of three axes: into the plane and to its counterpart, for each."""

EXACT = Decimal(0)
"""The tolerance of a comparison that allows no difference."""

GREATEST_UNITS = 2**62
"""Bound of coordinates in units, below the range of 64-bit integers."""


@dataclass(frozen=True, slots=True, eq=False)
class StepOriginal:
    """The text of a STEP file, cut open at the coordinates of its points.

    points (n, 3): coordinates in units of 10**-decimals. numbers (n,): of their entities. heads (n,): the text before each, None
    where `NEXT_POINT` stands between two points. tail: the text after the last. in_edges (n,): whether a vertex or the curve of
    an edge has the point. name: of the product and, numbered, of its solids.
    """

    points: IntArray
    decimals: int
    heads: tuple[bytes | None, ...]
    numbers: IntArray
    tail: bytes
    in_edges: BoolArray
    name: str

    def with_decimals(self, decimals: int) -> StepOriginal:
        """The same points on a finer grid."""
        factor = 10 ** (decimals - self.decimals)
        greatest = int(np.abs(self.points).max(initial=0))
        if greatest * factor >= GREATEST_UNITS:
            raise InvalidRequest(
                f"coordinates of {greatest / 10**self.decimals:g} mm do not fit the {decimals} decimals of a smaller slab beside "
                "this one: divide the lattice into slabs of more equal sizes"
            )
        return replace(self, points=self.points * factor, decimals=decimals)


def read_original(path: Path, name: str) -> StepOriginal:
    """The file of one product `name`, as `write_step` writes it; the origin of the product is none of the points."""
    numbers, coordinates, heads, end = array("q"), array("d"), [], 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        origin = _find_origin(text)
        for match in POINT.finditer(text):
            number, x, y, z = match.groups()
            if number == origin:
                continue
            head = text[end : match.start(2)]
            heads.append(None if head == NEXT_POINT % int(number) and numbers[-1] + 1 == int(number) else head)
            numbers.append(int(number))
            coordinates.extend((float(x), float(y), float(z)))
            end = match.end(4)
        tail = text[end:]
        used = array("q")
        for match in CURVE_OR_VERTEX.finditer(text):
            used.extend(map(int, (match[1] or match[2])[1:].split(b",#")))
    values = np.array(coordinates).reshape(-1, 3)
    decimals = COORDINATE_DIGITS - int(np.floor(np.log10(np.abs(values).max())))
    points = np.rint(values * 10.0**decimals).astype(np.int64)
    known = np.array(numbers)
    return StepOriginal(points, decimals, tuple(heads), known, tail, np.isin(known, np.array(used)), name)


def _find_origin(text: bytes | mmap.mmap) -> bytes:
    """The number of the point in the origin of the product, which placements refer to."""
    found = ORIGIN.search(text)
    placement = found and re.search(rb"#" + found[1] + rb"=AXIS2_PLACEMENT_3D\('[^']*',#(\d+),", text)
    if placement is None:
        raise KernelError("translate STEP", "the file has no product with an origin")
    return bytes(placement[1])


def join_at_cuts(originals: Sequence[StepOriginal], sizes: Sequence[Sequence[int]]) -> list[StepOriginal]:
    """The originals, between the planes 0 and `sizes` (units) of every axis, with equal points in opposite cut faces.

    The points in the low face of the first original that fits are the model: those of the others follow it. TrimmingError if an
    edge in a cut face has no counterpart.
    """
    points = [original.points.copy() for original in originals]
    for axis in range(3):
        across = [i for i in range(3) if i != axis]
        for target, original, size in zip(points, originals, sizes, strict=True):
            model = next(m for m, s in enumerate(sizes) if all(s[i] == size[i] for i in across))
            low = _in_plane(points[model], axis, 0)
            points[model][low, axis] = 0
            for plane in (0, size[axis]):
                _follow_model(
                    points[model][low],
                    originals[model].in_edges[low],
                    target,
                    original.in_edges,
                    axis,
                    plane,
                )
    return [replace(original, points=p) for original, p in zip(originals, points, strict=True)]


def _in_plane(points: IntArray, axis: int, plane: int) -> IntArray:
    """Indices of the points in the plane of cut."""
    return np.flatnonzero(np.abs(points[:, axis] - plane) <= CUT_TOL_UNITS)


def _follow_model(
    model: IntArray, model_in_edges: BoolArray, points: IntArray, in_edges: BoolArray, axis: int, plane: int
) -> None:
    """Give the points in one cut face, in place, the coordinates of the nearest of the model, moved to the plane."""
    own = _in_plane(points, axis, plane)
    points[own, axis] = plane
    moved = model.copy()
    moved[:, axis] = plane
    if not len(own) or not len(moved):
        lonely = int(in_edges[own].sum() + model_in_edges.sum())
    else:
        distance, nearest = cKDTree(moved).query(points[own])
        back, _ = cKDTree(points[own]).query(moved)
        near = distance <= CUT_TOL_UNITS
        lonely = int((in_edges[own] & ~near).sum() + (model_in_edges & (back > CUT_TOL_UNITS)).sum())
        points[own[near]] = moved[nearest[near]]
    if lonely:
        raise TrimmingError(
            f"{lonely} points of the cut across the {'xyz'[axis]} axis differ between opposite faces of a slab: "
            "the slabs would not meet; take slabs of other heights"
        )


def write_copy(
    original: StepOriginal, path: Path, shift: Sequence[int], *, name: str, time_stamp: str, file_name: str
) -> None:
    """Write the original moved by `shift` (units), under another name."""
    x, y, z = (_format_units(original.points[:, i] + shift[i], original.decimals) for i in range(3))
    old, new = _quoted_prefix(original.name), _quoted_prefix(name)
    header = f"FILE_NAME({format_string(file_name)},\n{format_string(time_stamp)},".encode()
    with path.open("wb") as file:
        for head, number, a, b, c in zip(original.heads, original.numbers.tolist(), x, y, z, strict=True):
            if head is None:
                file.write(b"));\n#%d=CARTESIAN_POINT('',(%b,%b,%b" % (number, a, b, c))
            else:
                renamed = FILE_NAME.sub(lambda _: header, head.replace(old, new), count=1)
                file.write(b"%b%b,%b,%b" % (renamed, a, b, c))
        file.write(original.tail.replace(old, new))


def _quoted_prefix(name: str) -> bytes:
    """How the quoted name of a product begins, and those of its solids, which are numbered."""
    return format_string(name)[:-1].encode()


def _format_units(units: IntArray, decimals: int) -> list[bytes]:
    """Decimal text of integers in units of 10**-decimals."""
    distinct, index = np.unique(units, return_inverse=True)
    scale = 10**decimals
    texts = []
    for value in distinct.tolist():
        whole, fraction = divmod(abs(value), scale)
        texts.append(f"{'-' if value < 0 else ''}{whole}.{fraction:0{decimals}d}".rstrip("0").encode())
    return [texts[i] for i in index.ravel().tolist()]


def compare_with_original(
    path: Path, original: Path, shift: Sequence[Decimal], *, name: str, original_name: str, tol: Decimal = EXACT
) -> None:
    """Read a copy and its original line by line; KernelError unless the copy is the original, moved by `shift` and renamed.

    The texts of the coordinates are compared as decimal numbers, without rounding; they may differ by `tol`.
    """
    old, new = _quoted_prefix(original_name), _quoted_prefix(name)
    origin = b"#%b=" % _find_origin(original.read_bytes())
    known: set[tuple[bytes, bytes]] = set()  # ends of lines that were compared, as coordinates recur
    n_moved, in_data = 0, False
    with original.open("rb") as lines, path.open("rb") as copied_lines:
        for number, (line, copied) in enumerate(zip_longest(lines, copied_lines, fillvalue=b""), 1):
            in_data = in_data or line == b"DATA;\n"
            if not in_data:  # the header holds the name of the file and the time stamp
                continue
            if b"=CARTESIAN_POINT(" in line and not line.startswith(origin):
                before, _, last = line.rpartition(b",")
                copied_before, _, copied_last = copied.rpartition(b",")
                same = before == copied_before and (last, copied_last) in known
                if not same:
                    same = _is_moved(line, copied, shift, tol)
                    if same and before == copied_before:
                        known.add((last, copied_last))
                n_moved += 1
            else:
                same = line == copied or line.replace(old, new) == copied
            if not same:
                raise KernelError("translate STEP", f"line {number} of {path.name} is not that of its original, moved")
    if not n_moved:
        raise KernelError("translate STEP", f"{path.name} holds no points")


def _is_moved(line: bytes, copied: bytes, shift: Sequence[Decimal], tol: Decimal) -> bool:
    """Whether the line of a point in a copy is that of the original, moved by `shift` to within `tol`."""
    try:
        (head, x, y, z, end), (other_head, *others, other_end) = _cut_point(line), _cut_point(copied)
        moved = [Decimal(t.decode()) - Decimal(s.decode()) for s, t in zip((x, y, z), others, strict=True)]
    except (ValueError, InvalidOperation):
        return False
    near = all(abs(found - by) <= tol for found, by in zip(moved, shift, strict=True))
    return near and head == other_head and end == other_end


def _cut_point(line: bytes) -> tuple[bytes, bytes, bytes, bytes, bytes]:
    """The text before the coordinates of a point, each of them, and the text after them; ValueError for another line."""
    first, y, last = line.rsplit(b",", 2)
    head, _, x = first.rpartition(b"(")
    z, bracket, end = last.partition(b")")
    return head, x, y, z, bracket + end


def units_of(length: float, decimals: int) -> int:
    """The length as the nearest integer in units of 10**-decimals."""
    return int((Decimal(length) * 10**decimals).to_integral_value())


def decimal_of(units: int, decimals: int) -> Decimal:
    """The exact decimal number of an integer in units of 10**-decimals."""
    return Decimal(units).scaleb(-decimals)
