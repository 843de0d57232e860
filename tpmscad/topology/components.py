"""Connected components of the solid and cavities in it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Level, SampleConnectivity, Samples
from tpmscad.topology.voxels import CONNECTIVITY, Labels, as_sample_array

EXTERIOR = 1
"""Label of the components that reach the border of the array, where these count as one."""


def label_samples(inside: BoolArray, neighbours: int, exterior: bool = False) -> tuple[Labels, int]:
    """Labels (nx, ny, nz) of the components of samples that are inside, from 1 in the order of first samples, and their number.

    With `exterior`, all that reach the border of the array have the label EXTERIOR, and the others follow from 2; the number is
    then 1 even if there are none.
    """
    structure = ndimage.generate_binary_structure(3, 1 if neighbours == 6 else 3)
    labels, count = ndimage.label(inside, structure, np.int32)
    if not exterior:
        return labels, count
    reaches = np.zeros(count + 1, bool)
    for axis in range(3):
        reaches[np.take(labels, (0, -1), axis)] = True
    reaches[0] = False
    number = np.where(reaches, EXTERIOR, np.cumsum(~reaches)).astype(np.int32)
    number[0] = 0
    return number[labels], count + 1 - int(np.count_nonzero(reaches))


def find_deepest_samples(field: Array, labels: Labels, count: int, sign: int) -> IntArray:
    """First sample of each component from 1 to `count` with the least sign * f: flat indices (count,), -1 for none."""
    values, own = sign * field.reshape(-1), labels.reshape(-1)
    least = np.full(count + 1, np.inf)
    np.minimum.at(least, own, values)
    at = np.flatnonzero((values == least[own]) & (own > 0))[::-1]
    found = np.full(count + 1, -1, np.int64)
    found[own[at]] = at
    return found[1:]


@validate_call()
def count_components_and_cavities(
    values: Samples, level: Level = 0.0, convention: SampleConnectivity = "strict"
) -> tuple[int, int]:
    """Count the components and the cavities of the solid {f <= level}.

    Returns
    -------
    components, cavities : int
        The counts n0 and n2 of porous blending, Table 1; one of the components is the structure itself.

    Notes
    -----
    With the convention "strict", (1, 0) certifies that the trilinear interpolant has one component and no cavity.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> values = np.ones((5, 5, 5))
    >>> values[1, 1, 1] = values[3, 3, 3] = -1.0
    >>> topology.count_components_and_cavities(values)
    (2, 0)
    """
    field = as_sample_array(values)
    return label_phase(field, level, convention, True)[1], label_phase(field, level, convention, False)[1] - 1


def label_phase(field: Array, level: float, convention: str, solid: bool) -> tuple[Labels, int]:
    """`label_samples` of the solid, or of the void with the exterior, by the neighbours of a convention."""
    inside = field <= level if solid else field > level
    return label_samples(inside, CONNECTIVITY[convention][0 if solid else 1], exterior=not solid)
