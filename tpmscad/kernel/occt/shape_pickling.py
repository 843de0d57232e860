"""Shapes in pickles: several of them together in OCCT's binary format, so that what they share stays shared, to the last bit.

A result that holds shapes is taken apart into them and a function that puts it together again from shapes (`Dismantled`). Results
that share faces, such as the domains of one body, are pickled together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from OCP.BRep import BRep_Builder
from OCP.TopoDS import TopoDS_Compound, TopoDS_Iterator

from tpmscad.errors import KernelError
from tpmscad.kernel.occt.convert import as_face, as_solid, shape_from_bytes, shape_to_bytes

Assemble = Callable[[Sequence[Any], Sequence[Any]], Any]
"""Makes a result of its solids and its faces."""

Dismantled = tuple[tuple[Any, ...], tuple[Any, ...], Assemble]
"""The solids and the faces of a result, and the function that makes it of these; the function can be pickled."""


def pack_results(results: Sequence[Dismantled]) -> tuple[bytes, list[tuple[int, int, Assemble]]]:
    """The shapes of results as bytes, and for each result the numbers of its solids and faces and its function."""
    compound, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(compound)
    for solids, faces, _ in results:
        for shape in (*solids, *faces):
            builder.Add(compound, shape)
    return shape_to_bytes(compound), [(len(solids), len(faces), assemble) for solids, faces, assemble in results]


def unpack_results(content: bytes, parts: Sequence[tuple[int, int, Assemble]]) -> list[Any]:
    """The results of `pack_results`."""
    bundle, found = shape_from_bytes(content), []  # the iterator does not keep the bundle alive
    walk = TopoDS_Iterator(bundle)
    while walk.More():
        found.append(walk.Value())
        walk.Next()
    if len(found) != sum(solids + faces for solids, faces, _ in parts):
        raise KernelError("unpickle", f"the bytes hold {len(found)} shapes, not those that were stored")
    results, at = [], 0
    for solids, faces, assemble in parts:
        middle, end = at + solids, at + solids + faces
        results.append(assemble(tuple(map(as_solid, found[at:middle])), tuple(map(as_face, found[middle:end]))))
        at = end
    return results


def unpack_result(content: bytes, parts: Sequence[tuple[int, int, Assemble]]) -> Any:
    """The only result of `pack_results`."""
    return unpack_results(content, parts)[0]
