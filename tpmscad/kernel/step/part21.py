"""Part 21 text: numbers, strings and numbered entities (ISO 10303-21, clear text encoding)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tpmscad.errors import InvalidRequest


def format_real(value: float) -> str:
    """The shortest text that reads back as this float; Part 21 wants a point, and a capital E."""
    return format_reals([float(value)])[0]


def format_reals(values: Sequence[float]) -> list[str]:
    texts = [repr(v) for v in values]
    return [_with_point(t) if "e" in t else t for t in texts]


def _with_point(text: str) -> str:
    mantissa, exponent = text.split("e")
    return f"{mantissa}{'' if '.' in mantissa else '.'}E{int(exponent)}"


def format_string(text: str) -> str:
    """The quoted string; characters outside of printable ASCII as \\X2\\ hexadecimal UTF-16, the standard's own way."""
    quoted = "".join(
        c if " " <= c <= "~" else f"\\X2\\{c.encode('utf-16-be').hex().upper()}\\X0\\"
        for c in text.replace("\\", "\\\\").replace("'", "''")
    )
    return f"'{quoted}'"


def format_references(ids: Iterable[int]) -> str:
    """(#1,#2,...)"""
    return "(" + ",".join([f"#{i}" for i in ids]) + ")"


class DataSection:
    """The data section as it grows: entities get consecutive numbers from 1."""

    def __init__(self) -> None:
        self._blocks: list[str] = []
        self.count = 0

    def add(self, body: str) -> int:
        """One entity, such as "DIRECTION('',(0.,0.,1.))"; its number."""
        self.count += 1
        self._blocks.append(f"#{self.count}={body};\n")
        return self.count

    def extend(self, bodies: Sequence[str]) -> range:
        """Many entities at once; their numbers."""
        numbers = range(self.count + 1, self.count + 1 + len(bodies))
        self._blocks.append("".join([f"#{i}={b};\n" for i, b in zip(numbers, bodies, strict=True)]))
        self.count += len(bodies)
        return numbers

    def text(self) -> str:
        return "".join(self._blocks)


SCHEMAS = {
    "ap242": "AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }",
    "ap214": "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }",
}


def format_exchange_structure(
    section: DataSection, *, schema: str, name: str, time_stamp: str, author: str, software: str
) -> str:
    """The whole file. `time_stamp` (ISO 8601) stands on a line of its own, the only one that differs between equal requests."""
    if schema not in SCHEMAS:
        raise InvalidRequest(f"schema {schema!r} is not known: use one of {', '.join(SCHEMAS)}")
    return (
        "ISO-10303-21;\nHEADER;\n"
        "FILE_DESCRIPTION((''),'2;1');\n"
        f"FILE_NAME({format_string(name)},\n{format_string(time_stamp)},\n({format_string(author)}),(''),{format_string(software)},{format_string(software)},'');\n"
        f"FILE_SCHEMA(({format_string(SCHEMAS[schema])}));\n"
        "ENDSEC;\nDATA;\n" + section.text() + "ENDSEC;\nEND-ISO-10303-21;\n"
    )
