"""Shapes in pickles: several of them together in OCCT's binary format, so that what they share stays shared, to the last bit.

A result that holds shapes is taken apart into them and a function that puts it together again from shapes (`Dismantled`). Results
that share faces, such as the domains of one body, are pickled together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from OCP.TopoDS import TopoDS_Iterator

from tpmscad.errors import KernelError
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import shape_from_bytes, shape_to_bytes

Assemble = Callable[[Sequence[Any]], Any]
"""Makes a result of its shapes."""

Dismantled = tuple[tuple[Any, ...], Assemble]
"""The solids or the faces of a result, and the function that makes it of these; the function can be pickled."""


def pack_results(results: Sequence[Dismantled]) -> tuple[bytes, list[tuple[int, Assemble]]]:
    """The shapes of results as bytes, and for each result the number of its shapes and its function."""
    compound = make_compound(shape for shapes, _ in results for shape in shapes)
    return shape_to_bytes(compound), [(len(shapes), assemble) for shapes, assemble in results]


def unpack_results(content: bytes, parts: Sequence[tuple[int, Assemble]]) -> list[Any]:
    """The results of `pack_results`."""
    bundle, found = shape_from_bytes(content), []  # the iterator does not keep the bundle alive
    walk = TopoDS_Iterator(bundle)
    while walk.More():
        found.append(walk.Value())
        walk.Next()
    if len(found) != sum(count for count, _ in parts):
        raise KernelError("unpickle", f"the bytes hold {len(found)} shapes, not those that were stored")
    results, at = [], 0
    for count, assemble in parts:
        results.append(assemble(found[at : at + count]))
        at += count
    return results


def unpack_result(content: bytes, parts: Sequence[tuple[int, Assemble]]) -> Any:
    """The only result of `pack_results`."""
    return unpack_results(content, parts)[0]
