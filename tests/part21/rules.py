"""The register of the schemas' rules, each a function of an item (WHERE, UNIQUE, INVERSE) or of the whole file (global rules)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from tests.part21.model import Item, Model

BOTH = ("ap242", "ap214")


@dataclass(frozen=True)
class Rule:
    """`holds` gets an item of the entity, or the model where there is none; `schemas` are those that have the rule."""

    entity: str | None
    label: str
    holds: Callable[[Any], bool]
    schemas: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.entity}.{self.label}" if self.entity else self.label


RULES: list[Rule] = []


def rule(entity: str, label: str, *schemas: str) -> Callable[[Callable[[Item], bool]], Callable[[Item], bool]]:
    """Register what must hold of every item of an entity."""

    def register(holds: Callable[[Item], bool]) -> Callable[[Item], bool]:
        RULES.append(Rule(entity, label, holds, schemas or BOTH))
        return holds

    return register


def global_rule(label: str, *schemas: str) -> Callable[[Callable[[Model], bool]], Callable[[Model], bool]]:
    """Register what must hold of a file."""

    def register(holds: Callable[[Model], bool]) -> Callable[[Model], bool]:
        RULES.append(Rule(None, label, holds, schemas or BOTH))
        return holds

    return register


def one_of(item: Item, *types: str) -> bool:
    """Whether exactly one of these is a type of the item, as the schemas' rules ask time and again."""
    return len(item.types & set(types)) == 1


def broken(model: Model, schema: str) -> list[str]:
    """The rules of the schema that a file breaks, with the first item of each that does."""
    found = []
    for r in RULES:
        if schema in r.schemas:
            subjects: Iterable[Any] = model.all(r.entity) if r.entity else [model]
            wrong = next((s for s in subjects if not r.holds(s)), None)
            if wrong is not None:
                found.append(f"{r.name}: {wrong if r.entity else 'the file'}")
    return found
