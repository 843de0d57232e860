"""The isometries of a periodic field: rigid motions that leave its values unchanged, one for each class modulo its periods.

Candidates are the signed permutations of the axes that keep the period box, each followed by translations by fractions of the
periods. They contain every isometry of the cubic, tetragonal and orthorhombic space groups in the settings of the catalogue.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.rigid_motion import Motion

TRANSLATION_FRACTIONS = 4
"""Translations are multiples of a quarter of each period."""

N_PROBES = 24
PROBE_SEED = 11
VALUE_TOL = 1e-11
"""Points at which a candidate is tried, and the difference of values, relative to the greatest, that round-off may cause."""


def find_isometries(field: Field) -> Motion:
    """The isometries (G,) of a periodic field modulo its periods, the identity first; translations lie in one period.

    They keep the sign of the field, so that solid is mapped to solid. InvalidRequest if the field has no periods.
    """
    periods = field.periods()
    if periods is None or min(periods) <= 0:
        raise InvalidRequest("a field without periods along all three axes has no lattice of copies")
    period = np.array(periods)
    probes = period * np.random.default_rng(PROBE_SEED).random((N_PROBES, 3))
    values = field(probes)
    tolerance = VALUE_TOL * float(np.abs(values).max())
    shifts = np.array(list(product(range(TRANSLATION_FRACTIONS), repeat=3))) / TRANSLATION_FRACTIONS * period
    rotations, translations = [], []
    for rotation in _signed_permutations():
        if not np.allclose(np.abs(rotation) @ period, period):
            continue
        images = probes @ rotation.T
        for shift in shifts:
            if np.abs(field(images[:2] + shift) - values[:2]).max() > tolerance:
                continue
            if np.abs(field(images + shift) - values).max() <= tolerance:
                rotations.append(rotation)
                translations.append(shift)
    return Motion(np.array(rotations), np.array(translations))


def _signed_permutations() -> list[np.ndarray]:
    """The 48 matrices (3, 3) that permute the axes and reverse some, the identity first."""
    matrices = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            matrices.append(matrix)
    return matrices
