"""Patches of the nodal level sets f = 0, parametrised over the patches of the minimal surfaces.

The point at (u, v) is the intersection of the level set with the minimal surface's normal at (u, v), at most 1.2e-2 of the cell
away. The map is smooth and commutes with every common symmetry, so that both surfaces have the same neighbours, rotoinversions
and transitions. Its derivatives and those of the unit normal follow from the chain rule with exact derivatives of f up to order
three.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.surfaces import minimal_patch
from tpmscad.surfaces.differential_geometry import dot
from tpmscad.surfaces.plane_waves import level_set_waves

NEWTON_STEPS = 5
"""Newton steps, which reach round-off; their number is fixed, so that no point depends on the other points of the call."""

SECOND_DERIVATIVE_INDICES = {3: (1, 1), 4: (1, 2), 5: (2, 2)}
"""First derivatives that make up the second derivative at each position of a jet."""


def mid_and_normal(name: str, u: Array, v: Array) -> tuple[Array, Array]:
    """Surface and unit normal with their derivatives by (u, v): (6, ..., 3) each, value, u, v, uu, uv, vv."""
    carrier, along = minimal_patch.mid_and_normal(name, u, v)
    height = _solve_height(name, carrier[0], along[0])
    waves = level_set_waves(name, "nodal")
    k = 2 * np.pi * waves.wave_vectors
    foot = carrier + height[..., None] * along  # at constant height; the derivatives of the height are added below
    wave = waves.amplitudes * np.exp(1j * (foot[0] @ k.T))
    slope = -wave.imag @ k
    steepness = dot(slope, along[0])

    # f = 0 along the surface, differentiated once and twice, gives the derivatives of the height.
    mid = foot.copy()
    rise = {}
    for a in (1, 2):
        rise[a] = -(dot(slope, foot[a]) / steepness)[..., None]
        mid[a] += rise[a] * along[0]
    k_mid = mid @ k.T  # (6, ..., W); rows 1 and 2 are final, the others follow
    for ab, (a, b) in SECOND_DERIVATIVE_INDICES.items():
        mid[ab] += rise[a] * along[b] + rise[b] * along[a]
        bend = -(k_mid[a] * k_mid[b] * wave.real).sum(axis=-1)
        mid[ab] -= ((dot(slope, mid[ab]) + bend) / steepness)[..., None] * along[0]

    gradient = -((mid @ k.T) * wave.real) @ k  # Hessian times the surface's derivatives
    gradient[0] = slope
    for ab, (a, b) in SECOND_DERIVATIVE_INDICES.items():
        gradient[ab] += (k_mid[a] * k_mid[b] * wave.imag) @ k  # third derivatives of f
    return mid, _normalise_jet(gradient)


def _solve_height(name: str, points: Array, directions: Array) -> Array:
    """Signed distance from points along directions to f = 0 by Newton's method: (...)."""
    waves = level_set_waves(name, "nodal")
    k = 2 * np.pi * waves.wave_vectors
    amplitude = waves.amplitudes
    phase, rate = points @ k.T, directions @ k.T
    height = np.zeros(points.shape[:-1])
    for _ in range(NEWTON_STEPS):
        wave = amplitude * np.exp(1j * (phase + height[..., None] * rate))
        step = -wave.real.sum(axis=-1) / (rate * wave.imag).sum(axis=-1)
        height = height - step
    return height


def _normalise_jet(g: Array) -> Array:
    """Jet of g / |g| from the jet of g."""
    length = np.linalg.norm(g[0], axis=-1, keepdims=True)
    n = np.empty_like(g)
    n[0] = g[0] / length
    grows = {}
    for a in (1, 2):
        grows[a] = dot(n[0], g[a])[..., None]
        n[a] = (g[a] - grows[a] * n[0]) / length
    for ab, (a, b) in SECOND_DERIVATIVE_INDICES.items():
        both = (dot(n[b], g[a]) + dot(n[0], g[ab]))[..., None]
        n[ab] = (g[ab] - both * n[0] - grows[a] * n[b] - grows[b] * n[a]) / length
    return n
