"""Part 21 text: numbers, strings, numbered entities and the schemas (ISO 10303-21, clear text encoding)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tpmscad.errors import InvalidRequest

SOFTWARE = "tpmscad"
"""Originating system in the file header."""


@dataclass(frozen=True, slots=True)
class StepSchema:
    """An application protocol: FILE_SCHEMA, application context, protocol definition and year."""

    file_schema: str
    application: str
    protocol: str
    year: int


SCHEMAS = {
    "ap242": StepSchema(
        file_schema="AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }",
        application="managed model based 3d engineering",
        protocol="ap242_managed_model_based_3d_engineering",
        year=2014,
    ),
    "ap214": StepSchema(
        file_schema="AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }",
        application="core data for automotive mechanical design processes",
        protocol="automotive_design",
        year=2000,
    ),
}


def find_schema(name: str) -> StepSchema:
    """The schema of that name; InvalidRequest if there is none."""
    if name not in SCHEMAS:
        raise InvalidRequest(f"schema {name!r} is not known: use one of {', '.join(SCHEMAS)}")
    return SCHEMAS[name]


def format_real(value: float) -> str:
    """Shortest text that reads back as the same float; Part 21 requires a decimal point and a capital E."""
    return format_reals([float(value)])[0]


def format_reals(values: Sequence[float]) -> list[str]:
    """`format_real` of each value."""
    texts = [repr(v) for v in values]
    return [_with_point(t) if "e" in t else t for t in texts]


def _with_point(text: str) -> str:
    """Exponent notation with the decimal point and the capital E of Part 21."""
    mantissa, exponent = text.split("e")
    return f"{mantissa}{'' if '.' in mantissa else '.'}E{int(exponent)}"


def format_string(text: str) -> str:
    """Quoted string; characters other than printable ASCII are written as \\X2\\ hexadecimal UTF-16."""
    quoted = "".join(
        c if " " <= c <= "~" else f"\\X2\\{c.encode('utf-16-be').hex().upper()}\\X0\\"
        for c in text.replace("\\", "\\\\").replace("'", "''")
    )
    return f"'{quoted}'"


def format_references(ids: Iterable[int]) -> str:
    """List of references: (#1,#2,...)."""
    return "(" + ",".join([f"#{i}" for i in ids]) + ")"


class DataSection:
    """Growing data section: the text of its entities in pieces, numbered consecutively from `count` + 1."""

    def __init__(self, count: int = 0) -> None:
        self.blocks: list[str] = []
        self.count = count

    def add(self, body: str) -> int:
        """Add one entity, such as "DIRECTION('',(0.,0.,1.))", and return its number."""
        self.count += 1
        self.blocks.append(f"#{self.count}={body};\n")
        return self.count

    def extend(self, bodies: Sequence[str]) -> range:
        """Add many entities and return their numbers."""
        numbers = range(self.count + 1, self.count + 1 + len(bodies))
        self.blocks.append("".join([f"#{i}={b};\n" for i, b in zip(numbers, bodies, strict=True)]))
        self.count += len(bodies)
        return numbers

    def extend_text(self, pieces: Sequence[str], count: int) -> range:
        """Add the text of `count` entities that are numbered from the next number on, and return their numbers."""
        numbers = range(self.count + 1, self.count + 1 + count)
        self.blocks += pieces
        self.count += count
        return numbers


def write_exchange_structure(
    path: Path, section: DataSection, *, schema: StepSchema, name: str, time_stamp: str, before: Iterable[str] = ()
) -> None:
    """Write the whole file; `before` is the text of entities that precede those of the section.

    `time_stamp` (ISO 8601) is on a line of its own, the only one that differs between equal requests.
    """
    head = (
        "ISO-10303-21;\nHEADER;\n"
        "FILE_DESCRIPTION((''),'2;1');\n"
        f"FILE_NAME({format_string(name)},\n{format_string(time_stamp)},\n(''),(''),{format_string(SOFTWARE)},{format_string(SOFTWARE)},'');\n"
        f"FILE_SCHEMA(({format_string(schema.file_schema)}));\n"
        "ENDSEC;\nDATA;\n"
    )
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(head)
        file.writelines(before)
        file.writelines([*section.blocks, "ENDSEC;\nEND-ISO-10303-21;\n"])
