"""What is wrong with a file by its schema: first by its types, and if these are right by the rules."""

from __future__ import annotations

import part21_geometry_rules
import part21_product_rules
import part21_protocol_rules
import part21_shape_rules
from part21_model import Model
from part21_rules import RULES, broken
from part21_types import Instances, type_faults

RULE_BOOKS = (part21_geometry_rules, part21_shape_rules, part21_product_rules, part21_protocol_rules)
assert {r.holds.__module__ for r in RULES} == {book.__name__ for book in RULE_BOOKS}


def faults(instances: Instances, schema: str) -> list[str]:
    """Sentences, none for a conforming file; schema: ap242 or ap214."""
    return type_faults(instances) or broken(Model(instances), schema)
