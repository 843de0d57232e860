"""The trigonometric level sets f = 0 of the same names, on the patches of the minimal surfaces.

The point at (u, v) is where the minimal surface's normal at (u, v) meets the level set, 1.2e-2 of the cell away at most. That
map is smooth and commutes with every common symmetry, so both surfaces have the same neighbours, rotoinversions and transitions.
Its derivatives, and those of the unit gradient, follow from the chain rule with exact derivatives of f up to the third.

f is stored as a sum of plane waves, f(X) = Re sum amplitude exp(2 pi i wave . X), X in cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.surfaces import minimal
from tpmscad.surfaces.jet import Array

NEWTON_STEPS = 8
"""Quadratic from 1.2e-2 of the cell: four steps reach round-off."""

ROUND_OFF = 4e-16
"""Of a cell: a Newton step below this changes nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """wave (W, 3) integers, amplitude (W,) complex."""

    wave: Array
    amplitude: Array


def _sines(waves: ArrayLike, factor: float) -> Waves:
    wave = np.asarray(waves, float)
    return Waves(wave, np.full(len(wave), -1j * factor))


WAVES: Mapping[str, Waves] = MappingProxyType(
    {
        # sin x cos y = (sin(x + y) + sin(x - y)) / 2, and cyclically
        "gyroid": _sines([[1, 1, 0], [1, -1, 0], [0, 1, 1], [0, 1, -1], [1, 0, 1], [-1, 0, 1]], 0.5),
        # sin x (sin y sin z + cos y cos z) + cos x (sin y cos z + cos y sin z)
        "diamond": _sines([[1, 1, -1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], 0.5),
        "schwarz_p": Waves(np.eye(3), np.ones(3, complex)),
    }
)


def level(name: str, points: Array) -> Array:
    """f at points (..., 3) in cells: (...)."""
    waves = WAVES[name]
    return (np.exp(2j * np.pi * (points @ waves.wave.T)) @ waves.amplitude).real


def gradient(name: str, points: Array) -> Array:
    """The gradient of f by points in cells: (..., 3)."""
    waves = WAVES[name]
    k = 2 * np.pi * waves.wave
    return ((1j * waves.amplitude * np.exp(1j * (points @ k.T))) @ k).real


def mid_and_normal(name: str, u: Array, v: Array) -> tuple[Array, Array]:
    """The surface and its unit normal, each with its derivatives by (u, v): (6, ..., 3), value, u, v, uu, uv, vv."""
    carrier, along = minimal.mid_and_normal(name, u, v)
    height = _height(name, carrier[0], along[0])
    k = 2 * np.pi * WAVES[name].wave
    foot = carrier + height[..., None] * along  # with the height held still; its derivatives are added below
    wave = WAVES[name].amplitude * np.exp(1j * (foot[0] @ k.T))
    slope = (1j * wave @ k).real
    steepness = _dot(slope, along[0])

    mid = foot.copy()
    rise = np.zeros((6, *height.shape))
    for a in (1, 2):
        rise[a] = -_dot(slope, foot[a]) / steepness
        mid[a] = foot[a] + rise[a][..., None] * along[0]
    k_mid = mid @ k.T  # wave times derivative, (6, ..., W)
    bent = {}  # derivatives of f's gradient along the surface, less the part that second derivatives of the surface bring
    for ab, (a, b) in SECOND.items():
        r = foot[ab] + rise[a][..., None] * along[b] + rise[b][..., None] * along[a]
        curl = -(k_mid[a] * k_mid[b] * wave).sum(axis=-1).real
        rise[ab] = -(_dot(slope, r) + curl) / steepness
        mid[ab] = r + rise[ab][..., None] * along[0]
        bent[ab] = (-1j * k_mid[a] * k_mid[b] * wave @ k).real

    k_mid = mid @ k.T
    turned = np.stack([slope, *(-(k_mid[a] * wave) @ k for a in range(1, 6))]).real
    for ab, extra in bent.items():
        turned[ab] += extra
    return mid, _unit(turned)


SECOND = {3: (1, 1), 4: (1, 2), 5: (2, 2)}
"""Which two first derivatives a second derivative's place in a jet stands for."""


def _height(name: str, points: Array, directions: Array) -> Array:
    """Signed distance from points along directions to f = 0: (...)."""
    height = np.zeros(points.shape[:-1])
    for _ in range(NEWTON_STEPS):
        at = points + height[..., None] * directions
        step = level(name, at) / _dot(gradient(name, at), directions)
        height = height - step
        if np.abs(step).max(initial=0.0) < ROUND_OFF:
            break
    return height


def _unit(g: Array) -> Array:
    """The jet of g / |g| from the jet of g."""
    length = np.linalg.norm(g[0], axis=-1, keepdims=True)
    n = np.empty_like(g)
    n[0] = g[0] / length
    grows = {}
    for a in (1, 2):
        grows[a] = _dot(n[0], g[a])[..., None]
        n[a] = (g[a] - grows[a] * n[0]) / length
    for ab, (a, b) in SECOND.items():
        both = (_dot(n[b], g[a]) + _dot(n[0], g[ab]))[..., None]
        n[ab] = (g[ab] - both * n[0] - grows[a] * n[b] - grows[b] * n[a]) / length
    return n


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)
