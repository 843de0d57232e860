"""What is wrong with a file by its schema: first by its types, and if these are right by the rules."""

from __future__ import annotations

from tests.part21 import geometry_rules, product_rules, protocol_rules, shape_rules
from tests.part21.model import Model
from tests.part21.rules import RULES, broken
from tests.part21.types_of_entities import Instances, type_faults

RULE_BOOKS = (geometry_rules, shape_rules, product_rules, protocol_rules)
assert {r.holds.__module__ for r in RULES} == {book.__name__ for book in RULE_BOOKS}


def faults(instances: Instances, schema: str) -> list[str]:
    """Sentences, none for a conforming file; schema: ap242 or ap214."""
    return type_faults(instances) or broken(Model(instances), schema)
