"""Coordinates of a periodic field whose cells change their size from place to place: phases, and plain modulation.

The phases are known as grating phases in spatially variant lattices (M. F. Martinez et al., ACES Journal, 2022).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.fft import dctn, idctn

from tpmscad import fields

Frequency = Callable[[np.ndarray], np.ndarray]
"""Cells per length at points (n, 3)."""


def solve_phases(frequency: Frequency, box: tuple, spacing: float) -> list[fields.Field]:
    """Phases along x, y and z with mean zero, whose differences are the closest to those requested on a grid round the box.

    The normal equations of path graphs are diagonal in the discrete cosine transform.
    """
    low, high = np.array(box)
    count = np.ceil((high - low) / spacing).astype(int) + 3
    origin = (low + high) / 2 - spacing * (count - 1) / 2
    grid = [o + spacing * np.arange(n) for o, n in zip(origin, count, strict=True)]
    x, y, z = (4 * np.sin(np.pi * np.arange(n) / (2 * n)) ** 2 for n in count)
    laplacian = x[:, None, None] + y[:, None] + z
    laplacian[0, 0, 0] = 1.0  # the mean is free
    phases = []
    for axis in range(3):
        middles = [(t[1:] + t[:-1]) / 2 if k == axis else t for k, t in enumerate(grid)]
        points = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
        steps = spacing * frequency(points.reshape(-1, 3)).reshape(points.shape[:3])
        right = -np.diff(steps, axis=axis, prepend=0.0, append=0.0)
        phases.append(fields.sampled(idctn(dctn(right) / laplacian), spacing, tuple(origin)))
    return phases


def follow(phi: fields.Field, phases: list[fields.Field]) -> fields.Field:
    """The field of period 1 at the phases."""
    return fields.warp(
        phi,
        lambda p: np.stack([phase(p) for phase in phases], axis=-1),
        lambda p: np.stack([phase.gradient(p) for phase in phases], axis=-2),
    )


def modulate(frequency: Frequency, box: tuple, origin: np.ndarray) -> list[fields.Field]:
    """The coordinates k(x) x from an origin."""
    return [
        fields.from_function(lambda p, axis=axis: frequency(p) * (p[:, axis] - origin[axis]), domain=box)
        for axis in range(3)
    ]
