"""Whether instances have the attributes that the schema declares: number, order, types, sizes, what may be unset or derived."""

from __future__ import annotations

from functools import cache

from tests.part21.parser import Instance, Value
from tests.part21.schema import (
    ABSTRACT,
    DEFINED,
    ENTITIES,
    ENUMERATIONS,
    POSITIVE,
    SELECTS,
    Aggregate,
    Attribute,
    ancestors,
    members,
)

KINDS = {"REAL": "real", "INTEGER": "int", "STRING": "string"}
Instances = dict[int, Instance]


@cache
def types_of(*parts: str) -> frozenset[str]:
    """Every entity type that an instance of these partial entities has, in lower case."""
    return frozenset(t for p in parts for t in ancestors(p))


@cache
def layout(name: str) -> tuple[tuple[str, Attribute], ...]:
    """The attributes of a simple instance in Part 21's order, each with the entity that declares it."""
    return tuple((entity, a) for entity in ancestors(name) for a in ENTITIES[entity].own)


def attributes(instance: Instance) -> list[tuple[str, Attribute, Value]]:
    """Every attribute of an instance whose number of values is right: declared by, what it is, its value."""
    if len(instance.parts) == 1:
        ((name, values),) = instance.parts.items()
        wanted = layout(name.lower())
    else:
        wanted = tuple((p.lower(), a) for p in instance.parts for a in ENTITIES[p.lower()].own)
        values = [v for own in instance.parts.values() for v in own]
    return [(entity, a, v) for (entity, a), v in zip(wanted, values, strict=True)]


def type_faults(instances: Instances) -> list[str]:
    """What is wrong with the instances by the declarations; empty for a conforming file."""
    found = []
    for number, instance in instances.items():
        name = "+".join(instance.parts)
        unknown = [p for p in instance.parts if p.lower() not in ENTITIES]
        if unknown:
            found.append(f"#{number} {', '.join(unknown)} is not in the table")
            continue
        wrong = _shape_fault(instance)
        if wrong:
            found.append(f"#{number} {name} {wrong}")
            continue
        derived = {d for t in types_of(*map(str.lower, instance.parts)) for d in ENTITIES[t].derived}
        for entity, attribute, value in attributes(instance):
            if attribute.name in derived:
                right = value.kind == "derived"
            elif value.kind == "unset":
                right = attribute.optional
            else:
                right = fits(attribute.type, value, instances)
            if not right:
                found.append(f"#{number} {name}: {entity}.{attribute.name} can't be {_shown(value)}")
    return found


def _shape_fault(instance: Instance) -> str | None:
    """What is wrong with the instance before its values are looked at."""
    parts = [p.lower() for p in instance.parts]
    if len(parts) == 1:
        wanted, given = len(layout(parts[0])), len(instance.parts[parts[0].upper()])
        if parts[0] in ABSTRACT:
            return "is abstract"
        return None if wanted == given else f"has {given} attributes, not {wanted}"
    lacking = types_of(*parts) - set(parts)
    if lacking:
        return f"lacks {', '.join(sorted(lacking))}"
    for part in parts:
        wanted, given = len(ENTITIES[part].own), len(instance.parts[part.upper()])
        if wanted != given:
            return f"has {given} attributes in {part}, not {wanted}"
    return None


def fits(wanted: Aggregate | str, value: Value, instances: Instances) -> bool:
    """Whether a value is of a type."""
    if isinstance(wanted, Aggregate):
        if value.kind != "list" or not wanted.low <= len(value.value) <= (wanted.high or len(value.value)):
            return False
        distinct = len({repr(v) for v in value.value}) if wanted.distinct else len(value.value)
        return distinct == len(value.value) and all(fits(wanted.of, v, instances) for v in value.value)
    if wanted in DEFINED:
        return value.kind == KINDS[DEFINED[wanted]] and (wanted not in POSITIVE or float(value.value) > 0.0)
    if wanted in KINDS:
        return value.kind == KINDS[wanted]
    if wanted in ENUMERATIONS:
        return value.kind == "enum" and value.value[1:-1].lower() in ENUMERATIONS[wanted].lower().split()
    if value.kind == "typed":
        name = value.value[0].lower()
        return (
            wanted in SELECTS and name in members(wanted) and name in DEFINED and fits(name, value.value[1], instances)
        )
    number = int(value.value[1:]) if value.kind == "ref" else 0
    if number not in instances or any(p.lower() not in ENTITIES for p in instances[number].parts):
        return False
    possible = members(wanted) if wanted in SELECTS else {wanted}
    return not possible.isdisjoint(types_of(*map(str.lower, instances[number].parts)))


def _shown(value: Value) -> str:
    return str(value.value) if value.kind != "list" else f"a list of {len(value.value)}"
