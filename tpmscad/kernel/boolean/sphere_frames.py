"""The frame of a sphere whose seam is crossed by as few other surfaces as possible.

A STEP file states no parameter curves, and the kernel's reader errs where edges of a spherical face begin and end on its seam: a
circle that crosses it twice was read on the wrong side, and the face rejected.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpmscad._typing import Array

SKEW, ACROSS = (0.6120, 0.2391, 0.7538), (0.7712, -0.4386, -0.4614)
"""Directions of the poles of spheres and of their seams unless others are better: no plane along axes or diagonals has them."""

CANDIDATES, SEAM_POINTS = 300, 65
"""Frames that are compared, and points of each seam."""

SEED = 3


def choose_sphere_frame(centre: Array, radius: float, distances: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Directions (3,) of the poles and of the middle of the seam.

    `distances` of points (n, 3) from the other surfaces, signed: (surfaces, n). The seam changes their signs as seldom as
    possible, and of such seams is the farthest from a surface.
    """
    rng = np.random.default_rng(SEED)
    axes, across = rng.normal(size=(2, CANDIDATES, 3))
    axes[0], across[0] = SKEW, ACROSS
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    across -= (across * axes).sum(axis=1, keepdims=True) * axes
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    t = np.linspace(0.0, np.pi, SEAM_POINTS)[:, None]
    seams = centre + radius * (np.cos(t) * axes[:, None] + np.sin(t) * across[:, None])
    found = distances(seams.reshape(-1, 3)).reshape(-1, CANDIDATES, SEAM_POINTS)
    crossings = np.count_nonzero((found[..., 1:] < 0) != (found[..., :-1] < 0), axis=(0, 2))
    # a surface that the seam crosses is near it in any case: of this one the distance of the poles counts
    clearance = np.abs(found[..., [0, -1]]).min(axis=(0, 2), initial=np.inf)
    uncrossed = np.logical_or((found < 0).all(axis=2), (found >= 0).all(axis=2))[..., None]
    clearance = np.minimum(clearance, np.where(uncrossed, np.abs(found), np.inf).min(axis=(0, 2), initial=np.inf))
    best = np.lexsort((-clearance, crossings))[0]
    return axes[best], across[best]
