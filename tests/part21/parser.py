"""A parser of Part 21 files (ISO 10303-21, clear text encoding), independent of the writer: text to values, no schema needed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

TOKEN = re.compile(
    r"\s*(?:(?P<string>'(?:[^']|'')*')|(?P<enum>\.[A-Z_0-9]+\.)|(?P<ref>#\d+)"
    r"|(?P<real>[+-]?\d+\.\d*(?:E[+-]?\d+)?)|(?P<int>[+-]?\d+)|(?P<name>[A-Z][A-Z0-9_]*)|(?P<mark>[()=;,$*]))"
)
Token = tuple[str, str]


@dataclass(frozen=True)
class Value:
    """kind: string, enum, ref, real, int, unset ($), derived (*): the text as written; list: values; typed: (NAME, value)."""

    kind: str
    value: Any


@dataclass(frozen=True)
class Instance:
    """Partial entities by name, each with its values: one for a simple instance, several for a complex one."""

    parts: dict[str, list[Value]]


def parse(text: str) -> tuple[str, dict[int, Instance]]:
    """The header section's text and the instances of the data section."""
    assert text.startswith("ISO-10303-21;\nHEADER;\n")
    assert text.endswith("ENDSEC;\nEND-ISO-10303-21;\n")
    header, data = re.split(r"^DATA;\n", text, maxsplit=1, flags=re.MULTILINE)
    reader = _Reader(tokenise(data[: data.rindex("ENDSEC;")]))
    instances: dict[int, Instance] = {}
    while reader.at < len(reader.tokens):
        number, instance = reader.instance()
        assert number not in instances, f"#{number} twice"
        instances[number] = instance
    return header, instances


def header_instances(header: str) -> dict[int, Instance]:
    """The entities of the header section, numbered from 1 as they come."""
    reader = _Reader(tokenise(header[header.index("HEADER;") + len("HEADER;") : header.rindex("ENDSEC;")]))
    instances: dict[int, Instance] = {}
    while reader.at < len(reader.tokens):
        name = reader.take("name")
        instances[len(instances) + 1] = Instance({name: reader.arguments()})
        reader.take("mark", ";")
    return instances


def tokenise(text: str) -> list[Token]:
    tokens, at, end = [], 0, len(text.rstrip())
    while at < end:
        match = TOKEN.match(text, at)
        assert match, f"not Part 21: {text[at : at + 60]!r}"
        tokens.append((str(match.lastgroup), match.group(str(match.lastgroup))))
        at = match.end()
    return tokens


class _Reader:
    def __init__(self, tokens: list[Token]) -> None:
        self.tokens = tokens
        self.at = 0

    def take(self, kind: str, value: str | None = None) -> str:
        found = self.tokens[self.at]
        assert found[0] == kind, (found, kind)
        assert value is None or found[1] == value, (found, value)
        self.at += 1
        return found[1]

    def instance(self) -> tuple[int, Instance]:
        number = int(self.take("ref")[1:])
        self.take("mark", "=")
        parts: dict[str, list[Value]] = {}
        if self.tokens[self.at] == ("mark", "("):
            self.at += 1
            while self.tokens[self.at] != ("mark", ")"):
                name = self.take("name")
                assert name not in parts, f"#{number} has {name} twice"
                parts[name] = self.arguments()
            self.at += 1
            assert list(parts) == sorted(parts), "parts of a complex instance come in alphabetical order"
        else:
            name = self.take("name")
            parts[name] = self.arguments()
        self.take("mark", ";")
        return number, Instance(parts)

    def arguments(self) -> list[Value]:
        self.take("mark", "(")
        values: list[Value] = []
        while self.tokens[self.at] != ("mark", ")"):
            if values:
                self.take("mark", ",")
            values.append(self.argument())
        self.take("mark", ")")
        return values

    def argument(self) -> Value:
        kind, value = self.tokens[self.at]
        if (kind, value) == ("mark", "("):
            return Value("list", self.arguments())
        self.at += 1
        if kind == "name":
            (inner,) = self.arguments()
            return Value("typed", (value, inner))
        return Value({"$": "unset", "*": "derived"}.get(value, kind), value)


def of_kind(instances: dict[int, Instance], name: str) -> dict[int, list[Value]]:
    """The values of every instance with this partial entity, by number."""
    return {number: i.parts[name] for number, i in instances.items() if name in i.parts}


def numbers(value: Value) -> list[int]:
    """The instances that a list refers to."""
    return [int(v.value[1:]) for v in value.value]


def references(value: Value) -> list[int]:
    """The instances that a value refers to, however deep."""
    if value.kind == "ref":
        return [int(value.value[1:])]
    return [r for v in value.value for r in references(v)] if value.kind == "list" else []
