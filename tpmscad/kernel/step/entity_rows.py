"""Entities of a file by their number, whose text must be as expected: the common part of what checks a file's text."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import KernelError
from tpmscad.kernel.step.entity_table import EntityTable

ROUND_OFF = 1e-12
"""Difference of directions, radii and lengths, relative to their size, that comes from another order of operations."""


def require(condition: Any, what: str) -> None:
    """KernelError that names what differs, unless the condition holds."""
    if not np.all(condition):
        raise KernelError("export_step", f"the text of the file is not what was meant: {what}")


class EntityRows:
    """The numbers of entities that are asked for by number and template, and which entities were."""

    def __init__(self, table: EntityTable) -> None:
        self.table = table
        self.keyword = table.keywords()
        self.known = np.zeros(len(table.number), bool)

    def rows(self, numbers: Array | IntArray, template: str) -> Array:
        """Numbers (n, m) in the entities of the given numbers, all of which must have the template."""
        at = self.table.positions(numbers)
        require(at >= 0, f"a reference leads nowhere instead of to {template}")
        wanted = [i for i, t in enumerate(self.table.templates) if t == template]
        require(np.isin(self.table.template[at], wanted), f"there is another entity in place of {template}")
        self.known[at] = True
        start = self.table.start[at]
        return self.table.values[start[:, None] + np.arange(template_size(template))]

    def with_keyword(self, keyword: str) -> IntArray:
        """Positions of the entities with a keyword."""
        return np.flatnonzero(np.isin(self.table.template, [i for i, k in enumerate(self.keyword) if k == keyword]))

    def points(self, numbers: Array) -> Array:
        """Coordinates of points (n, 3)."""
        return self.rows(numbers, "CARTESIAN_POINT('',(&,&,&))")

    def directions(self, numbers: Array) -> Array:
        """Components of directions (n, 3)."""
        return self.rows(numbers, "DIRECTION('',(&,&,&))")

    def frames(self, numbers: Array) -> Array:
        """Origin, axis and reference direction (n, 3, 3) of placements."""
        origin, axis, x = self.rows(numbers, "AXIS2_PLACEMENT_3D('',#,#,#)").T
        return np.stack([self.points(origin), self.directions(axis), self.directions(x)], axis=1)


def template_marks(template: str) -> str:
    """The marks of a template in order, strings left out."""
    return "".join(re.findall(r"[#@&]", re.sub(r"'(?:[^']|'')*'", "", template)))


def template_size(template: str) -> int:
    """Number of numbers in an entity with a template."""
    return len(template_marks(template))


def agree(read: Array, meant: Array) -> BoolArray:
    """Whether rows (n, m) agree to round-off: (n,)."""
    size = np.maximum(1.0, np.abs(meant).max(axis=1, initial=0.0))
    return np.asarray(np.abs(read - meant).max(axis=1, initial=0.0) <= ROUND_OFF * size, bool)
