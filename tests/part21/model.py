"""Instances as the rules see them: attributes by name, references followed, and who refers to what."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tests.part21.parser import Value
from tests.part21.parser import references as referred
from tests.part21.types_of_entities import Instances, attributes, types_of

LOGICAL = {".T.": True, ".F.": False, ".U.": None}


class Item:
    """An instance. item["items"] is its attribute: a number, string or list, None if unset, another item for a reference,
    True, False or None for a logical, (TYPE, value) where a select takes a value."""

    def __init__(self, model: Model, number: int) -> None:
        instance = model.instances[number]
        self.model, self.number, self.parts = model, number, tuple(p.lower() for p in instance.parts)
        self.types = types_of(*self.parts)
        self.values = {a.name: value for _, a, value in attributes(instance)}
        self.by_entity = {(entity, a.name): value for entity, a, value in attributes(instance)}

    def __repr__(self) -> str:
        return f"#{self.number} {'+'.join(self.parts)}"

    def __getitem__(self, name: str) -> Any:
        """The attribute; of several with one name, `entity.name` says which."""
        entity, _, attribute = name.rpartition(".")
        return self._plain(self.by_entity[entity, attribute] if entity else self.values[attribute])

    def _plain(self, value: Value) -> Any:
        match value.kind:
            case "ref":
                return self.model[int(value.value[1:])]
            case "list":
                return [self._plain(v) for v in value.value]
            case "typed":
                return value.value[0].lower(), self._plain(value.value[1])
            case "string":
                return value.value[1:-1].replace("''", "'")
            case "enum":
                return LOGICAL.get(value.value, value.value[1:-1].lower())
            case "real":
                return float(value.value)
            case "int":
                return int(value.value)
        return None

    def users(self, attribute: str = "") -> list[Item]:
        """The items that refer to this one, by the attribute `entity.name` if it is given: once for every time they do."""
        return [self.model[n] for n, by in self.model.uses.get(self.number, ()) if attribute in ("", by)]


class Model:
    """A file's instances, which must be right by their types."""

    def __init__(self, instances: Instances) -> None:
        self.instances = instances
        self.items: dict[int, Item] = {}
        self.uses: dict[int, list[tuple[int, str]]] = {}
        for number, instance in instances.items():
            for entity, attribute, value in attributes(instance):
                for r in referred(value):
                    self.uses.setdefault(r, []).append((number, f"{entity}.{attribute.name}"))
        self.by_type: dict[str, list[int]] = {}
        for number, instance in instances.items():
            for t in types_of(*(p.lower() for p in instance.parts)):
                self.by_type.setdefault(t, []).append(number)
        self._representations: dict[int, frozenset[int]] = {}

    def __getitem__(self, number: int) -> Item:
        if number not in self.items:
            self.items[number] = Item(self, number)
        return self.items[number]

    def all(self, entity: str) -> Iterator[Item]:
        """Every item of this type, subtypes included."""
        return (self[n] for n in self.by_type.get(entity, ()))

    def using_representations(self, item: Item) -> frozenset[int]:
        """The representations that hold an item, or an item or founded item that refers to it: ISO 10303-43."""
        if item.number not in self._representations:
            self._representations[item.number] = frozenset()  # for cycles, which other rules forbid
            found: set[int] = set()
            for user in item.users():
                if "representation" in user.types:
                    found.add(user.number)
                elif {"representation_item", "founded_item"} & user.types:
                    found |= self.using_representations(user)
            self._representations[item.number] = frozenset(found)
        return self._representations[item.number]
