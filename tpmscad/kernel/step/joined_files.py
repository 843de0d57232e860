"""STEP files of single products joined as one assembly, which stores each part once and places it as often as asked.

The text of a part stays as it is but for its entity numbers, to which a number is added. What was joined is read back by the
scanner of `entity_table`, which shares nothing with this: each number of each part must be that of the part's own file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.errors import KernelError
from tpmscad.file_suffixes import STEP_SUFFIXES
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.step.entity_table import EntityTable, read_entity_table, require, template_marks
from tpmscad.kernel.step.part21 import DataSection, find_schema, write_exchange_structure
from tpmscad.kernel.step.product_entities import (
    BREP_REPRESENTATION,
    FileContext,
    MassProperties,
    ProductEntities,
    write_assembly,
    write_file_context,
    write_validation_properties,
)

CHUNK_BYTES = 1 << 24
"""Bytes of text that are renumbered at a time."""

_PRODUCT = re.compile(
    rb"#(?P<definition_shape>\d+)=PRODUCT_DEFINITION_SHAPE\('','',#(?P<definition>\d+)\);\n"
    rb"#(?P<context>\d+)=\(GEOMETRIC_REPRESENTATION_CONTEXT(?:.*\n)+?"
    rb"#(?P<representation>\d+)=" + BREP_REPRESENTATION.encode() + rb"\('(?:[^']|'')*',\(#(?P<origin>\d+)"
)
_LAST = re.compile(rb"\n#(\d+)=[^\n]*\nENDSEC;\nEND-ISO-10303-21;\n\Z")


@dataclass(frozen=True, slots=True)
class PartFile:
    """A checked STEP file of one product, numbered from 1; count: its entities."""

    path: Path
    product: ProductEntities
    count: int
    mass: MassProperties


@dataclass(frozen=True, slots=True)
class PlacedProduct:
    """A product of the file, its mass properties, the name of this copy, and where it lies."""

    product: ProductEntities
    mass: MassProperties
    label: str
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)


def find_part(path: Path, mass: MassProperties) -> PartFile:
    """The only product of a file that this package wrote from arrays or from solids; KernelError if there is another layout."""
    text = path.read_bytes()
    found, last = list(_PRODUCT.finditer(text)), _LAST.search(text)
    if len(found) != 1 or last is None:
        raise KernelError("join STEP files", f"{path.name} holds {len(found)} products where one was meant")
    numbers = {name: int(number) for name, number in found[0].groupdict().items()}
    return PartFile(path, ProductEntities(**numbers), int(last[1]), mass)


AssemblyWriter = Callable[[DataSection, FileContext, Sequence[ProductEntities]], Any]
"""Writes the assemblies, given the data section, what all entities refer to, and the product of each part."""


def write_joined_step(
    path: str | os.PathLike[str],
    parts: Sequence[PartFile],
    write_assemblies: AssemblyWriter,
    *,
    schema: str,
    verify: Callable[[Path, EntityTable], None],
) -> None:
    """Write the parts as one file with what `write_assemblies` adds; `verify` is called before it appears."""
    target, protocol = validate_output_path(path, STEP_SUFFIXES), find_schema(schema)
    offsets = np.concatenate([[0], np.cumsum([part.count for part in parts])])
    section = DataSection(int(offsets[-1]))
    setting = write_file_context(section, protocol, CONFUSION_TOLERANCE)
    products = [_renumber_product(p.product, int(k)) for p, k in zip(parts, offsets, strict=False)]
    write_assemblies(section, setting, products)
    text = (
        chunk for part, offset in zip(parts, offsets.tolist(), strict=False) for chunk in renumber(part.path, offset)
    )
    with atomic_write(target) as aside:
        stamp = datetime.now(UTC).isoformat(timespec="seconds")
        write_exchange_structure(aside, section, schema=protocol, name=target.name, time_stamp=stamp, before=text)
        table = read_entity_table(aside)
        for part, offset in zip(parts, offsets.tolist(), strict=False):
            check_joined(table, part, offset)
        verify(aside, table)


def _renumber_product(product: ProductEntities, offset: int) -> ProductEntities:
    return ProductEntities(
        product.definition + offset,
        product.definition_shape + offset,
        product.representation + offset,
        product.context + offset,
        product.origin + offset,
    )


def renumber(path: Path, offset: int) -> Iterator[str]:
    """The text of the entities of a file with `offset` added to each entity number, in pieces of whole lines."""
    with path.open("rb") as file:
        rest = file.read(CHUNK_BYTES)
        rest = rest[rest.index(b"\nDATA;\n") + 7 :]
        while True:
            more = file.read(CHUNK_BYTES)
            cut = rest.rfind(b"ENDSEC;\n") if not more else rest.rfind(b";\n") + 2
            text = np.frombuffer(rest[:cut], np.uint8)
            references = int(np.count_nonzero(text == ord("#")))
            out = np.empty(len(text) + references * len(str(offset)) + references, np.uint8)
            yield out[: _add_to_references(text, offset, out)].tobytes().decode("ascii")
            if not more:
                return
            rest = rest[cut:] + more


@njit_cached
def _add_to_references(text: Any, offset: int, out: Any) -> int:
    """Copy text with `offset` added to each number after '#' outside strings; the length of the copy."""
    at, n, size, quoted = 0, 0, len(text), False
    digits = np.empty(20, np.uint8)
    while at < size:
        c = text[at]
        out[n] = c
        n += 1
        at += 1
        if c == 39:
            quoted = not quoted
        elif c == 35 and not quoted:
            value = offset
            number = 0
            while at < size and 48 <= text[at] <= 57:
                number = 10 * number + (text[at] - 48)
                at += 1
            value += number
            k = 0
            while value > 0:
                digits[k] = 48 + value % 10
                value //= 10
                k += 1
            while k > 0:
                k -= 1
                out[n] = digits[k]
                n += 1
    return n


def check_joined(table: EntityTable, part: PartFile, offset: int) -> None:
    """KernelError unless the entities of a file, numbered from `offset` on, are those of a part's own file."""
    own = read_entity_table(part.path)
    at = table.positions(own.number + offset)
    require(at >= 0, f"an entity of {part.path.name} is missing")
    joined_template = np.array([hash(t) for t in table.templates])[table.template[at]]
    require(joined_template == np.array([hash(t) for t in own.templates])[own.template], "an entity of a part")
    length = np.diff(own.start)
    first = np.repeat(table.start[at] - own.start[:-1], length)
    difference = table.values[first + np.arange(len(first))] - own.values
    refers = [np.array([mark == "#" for mark in template_marks(t)], bool) for t in own.templates]
    sizes = np.array([len(r) for r in refers])
    start = np.concatenate([[0], np.cumsum(sizes)])
    column = np.arange(len(first)) - np.repeat(own.start[:-1], length)
    is_reference = np.concatenate([np.zeros(0, bool), *refers])[np.repeat(start[own.template], length) + column]
    require(difference == offset * is_reference, f"a number of {part.path.name}")


def write_group(
    section: DataSection, setting: FileContext, name: str, placed: Sequence[PlacedProduct]
) -> PlacedProduct:
    """Write an assembly of translated products with its validation properties."""
    shifts = np.array([each.shift for each in placed])
    turns = np.tile(np.eye(3), (len(placed), 1, 1))
    labels = [each.label for each in placed]
    product = write_assembly(section, setting, name, [each.product for each in placed], labels, turns, shifts)
    mass = add_masses([each.mass for each in placed], shifts)
    write_validation_properties(section, setting, product, mass)
    return PlacedProduct(product, mass, name)


def add_masses(masses: Sequence[MassProperties], shifts: Array) -> MassProperties:
    """Mass properties of several parts, each moved by its shift (n, 3)."""
    volumes = np.array([mass.volume for mass in masses])
    x, y, z = volumes @ (np.array([mass.centroid for mass in masses]) + shifts) / volumes.sum()
    area = float(sum(mass.area for mass in masses))
    return MassProperties(float(volumes.sum()), area, (float(x), float(y), float(z)))


def write_cells(
    section: DataSection, setting: FileContext, cell: PlacedProduct, positions: IntArray, edges: Array
) -> PlacedProduct:
    """Write an assembly of equal cells at integer positions (n, 3), in layers of rows; equal rows and layers are stored once."""
    rows: dict[tuple[int, ...], PlacedProduct] = {}
    layers: dict[tuple[Any, ...], PlacedProduct] = {}
    block: list[PlacedProduct] = []
    for k in np.unique(positions[:, 2]).tolist():
        own = positions[positions[:, 2] == k, :2]
        corner = own.min(axis=0)
        pattern = tuple((j, tuple(np.sort(own[own[:, 1] == j, 0] - corner[0]).tolist())) for j in np.unique(own[:, 1]))
        pattern = tuple((int(j - corner[1]), row[0], tuple(i - row[0] for i in row)) for j, row in pattern)
        for *_, row in pattern:
            if row not in rows:
                members = [
                    replace(cell, label=f"cell {n}", shift=(i * edges[0], 0.0, 0.0)) for n, i in enumerate(row, 1)
                ]
                rows[row] = write_group(section, setting, f"row {len(rows) + 1}", members)
        if pattern not in layers:
            members = [
                replace(rows[row], label=f"row {n}", shift=(i * edges[0], j * edges[1], 0.0))
                for n, (j, i, row) in enumerate(pattern, 1)
            ]
            layers[pattern] = write_group(section, setting, f"layer {len(layers) + 1}", members)
        shift = (corner[0] * edges[0], corner[1] * edges[1], k * edges[2])
        block.append(replace(layers[pattern], label=f"layer {len(block) + 1}", shift=shift))
    return write_group(section, setting, "whole cells", block)
