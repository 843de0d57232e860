"""The placements of an assembly, read from a file's text and held against those that were meant.

Every usage of a part says twice what is placed where: by product definitions, and by representations with a transformation. Both
must agree. The representations form a tree; its leaf is the part, its root the whole, and the transformations along the way
give the place of each copy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array
from tpmscad.kernel.step.cell_assembly import compose_levels
from tpmscad.kernel.step.entity_table import EntityRows, agree, require
from tpmscad.rigid_motion import Motion

_RELATION = (
    "(REPRESENTATION_RELATIONSHIP('','',#,#)REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#)"
    "SHAPE_REPRESENTATION_RELATIONSHIP())"
)


def check_placements(entities: EntityRows, levels: Sequence[Motion]) -> None:
    """KernelError unless the file places its part as the levels of an assembly say, innermost first, and nothing else."""
    read, meant = _read_placements(entities), compose_levels(levels)
    require(len(read) == len(meant), f"{len(read)} placements in place of {len(meant)}")
    require(agree(read.translation, meant.translation), "the place of a copy")
    require(agree(read.rotation.reshape(-1, 9), meant.rotation.reshape(-1, 9)), "the rotation of a copy")


def _read_placements(entities: EntityRows) -> Motion:
    """The places of all copies of the part, in the order of the file, the inner ones fastest."""
    table = entities.table
    used = table.number[entities.with_keyword("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION")]
    relation, usage_shape = entities.rows(used, "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#,#)").T
    part, whole, motion = entities.rows(relation, _RELATION).T
    origin, frame = entities.rows(motion, "ITEM_DEFINED_TRANSFORMATION('','',#,#)").T
    still = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    require(entities.frames(origin) == still, "the origin of a part")
    _check_usages(entities, usage_shape, part, whole)
    placed = _as_motions(entities.frames(frame))
    require(len(np.setdiff1d(part, whole)) == 1 and len(np.setdiff1d(whole, part)) == 1, "the tree of the assembly")
    (node,) = np.setdiff1d(part, whole)
    levels: list[Motion] = []
    for _ in np.unique(whole):
        own = part == node
        require(len(np.unique(whole[own])) == 1, "the tree of the assembly")
        levels.append(placed[own])
        node = whole[own][0]
    require(sum(map(len, levels)) == len(part), "the tree of the assembly")
    return compose_levels(levels)


def _check_usages(entities: EntityRows, usage_shape: Array, part: Array, whole: Array) -> None:
    """The product definitions of each usage are those of the representations that it relates."""
    table = entities.table
    shown = table.number[entities.with_keyword("SHAPE_DEFINITION_REPRESENTATION")]
    shape, representation = entities.rows(shown, "SHAPE_DEFINITION_REPRESENTATION(#,#)").T
    definition = entities.rows(shape, "PRODUCT_DEFINITION_SHAPE('','',#)")[:, 0]
    of_representation = dict(zip(representation.tolist(), definition.tolist(), strict=True))
    usage = entities.rows(usage_shape, "PRODUCT_DEFINITION_SHAPE('Placement','Placement of an item',#)")[:, 0]
    at = table.positions(usage)
    every = entities.with_keyword("NEXT_ASSEMBLY_USAGE_OCCURRENCE")
    require(np.array_equal(np.sort(at), np.sort(every)), "the usages of a part")
    relating, related = table.values[table.start[at][:, None] + np.arange(2)].T
    require(relating == [of_representation.get(n) for n in whole.tolist()], "the assembly of a usage")
    require(related == [of_representation.get(n) for n in part.tolist()], "the part of a usage")


def _as_motions(frames: Array) -> Motion:
    """Placements by origin, axis and reference direction (n, 3, 3)."""
    origin, z, x = np.moveaxis(frames, 1, 0)
    return Motion(np.stack([x, np.cross(z, x), z], axis=-1), origin)
