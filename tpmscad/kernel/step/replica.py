"""Surfaces stored once and copied by SURFACE_REPLICA, as in TPMS2STEP, section 3.6: smaller files, outside the standard.

A WHERE rule of advanced_face (wr1 in AP203, AP214 and AP242) admits elementary, swept and B-spline surfaces only. OCC, FreeCAD
and gmsh read replicas nevertheless, provided that no operator mirrors: OCC makes an invalid face of one. So each primitive has a
base surface for either handedness, and operators are proper.
"""

from __future__ import annotations

import numpy as np

from tpmscad.kernel.step.text import Entities, reals
from tpmscad.patches.complex import Array, Ints

MIRROR = np.diag([-1.0, 1.0, 1.0])


def bases(primitive: Ints, rotation: Array) -> tuple[Ints, Array, Array]:
    """The base of each placed primitive: its index (n,), and for each base the primitive (b,) and whether it is mirrored (b,)."""
    mirrored = np.linalg.det(rotation) < 0
    rows = np.column_stack([primitive, mirrored])
    distinct, index = np.unique(rows, axis=0, return_inverse=True)
    return index.ravel(), distinct[:, 0], distinct[:, 1].astype(bool)


def write_replicas(entities: Entities, base: Ints, rotation: Array, translation: Array) -> Ints:
    """SURFACE_REPLICA numbers of bases (entity numbers (n,)) moved by each motion; mirrored bases take what is left of it."""
    proper = np.where((np.linalg.det(rotation) < 0)[:, None, None], rotation @ MIRROR, rotation)
    axes = np.swapaxes(proper, 1, 2).reshape(-1, 3)  # the images of x, y, z, one after another
    x, y, z = (reals(axes[:, k].tolist()) for k in range(3))
    directions = entities.extend([f"DIRECTION('',({a},{b},{c}))" for a, b, c in zip(x, y, z, strict=True)])
    x, y, z = (reals(translation[:, k].tolist()) for k in range(3))
    origins = entities.extend([f"CARTESIAN_POINT('',({a},{b},{c}))" for a, b, c in zip(x, y, z, strict=True)])
    operators = entities.extend(
        [
            f"CARTESIAN_TRANSFORMATION_OPERATOR_3D('','',$,#{a},#{b},#{o},1.,#{c})"
            for a, b, c, o in zip(directions[0::3], directions[1::3], directions[2::3], origins, strict=True)
        ]
    )
    return np.array(
        entities.extend([f"SURFACE_REPLICA('',#{b},#{o})" for b, o in zip(base.tolist(), operators, strict=True)])
    )
