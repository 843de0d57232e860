"""Scalar coordinates for one-dimensional weights: along a direction, a cylinder's radius, a sphere's radius.

(Porous blending, section 3.1.1, eqs 7, 10 and 12, for any direction, axis and centre.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

Vector = tuple[float, float, float]


class Coordinate(Protocol):
    """t(points (..., 3)) -> (...), in model units, and its gradient (..., 3)."""

    def __call__(self, points: Array) -> Array: ...

    def gradient(self, points: Array) -> Array: ...


@dataclass(frozen=True, slots=True)
class LinearCoordinate:
    """Distance along a direction (any length) from the origin."""

    direction: Vector = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _check_direction(self.direction, "direction")

    def __call__(self, points: Array) -> Array:
        return np.asarray(points, float) @ _normalised_direction(self.direction)

    def gradient(self, points: Array) -> Array:
        return np.broadcast_to(_normalised_direction(self.direction), np.shape(points))

    @property
    def axis(self) -> int | None:
        """0, 1, 2 for x, y, z run forwards; None for any other direction."""
        unit = _normalised_direction(self.direction)
        return int(np.argmax(unit)) if np.max(unit) == 1.0 else None


@dataclass(frozen=True, slots=True)
class CylinderRadius:
    """Distance from the axis through `origin` along `direction`."""

    origin: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _check_direction(self.direction, "direction")

    def __call__(self, points: Array) -> Array:
        return np.sqrt(np.sum(self._across(points) ** 2, axis=-1))

    def gradient(self, points: Array) -> Array:
        across = self._across(points)
        return across / np.maximum(np.sqrt(np.sum(across**2, axis=-1, keepdims=True)), np.finfo(float).tiny)

    def _across(self, points: Array) -> Array:
        offset = np.asarray(points, float) - np.array(self.origin)
        unit = _normalised_direction(self.direction)
        return offset - (offset @ unit)[..., None] * unit


@dataclass(frozen=True, slots=True)
class SphereRadius:
    """Distance from `centre`."""

    centre: Vector = (0.0, 0.0, 0.0)

    def __call__(self, points: Array) -> Array:
        return np.sqrt(np.sum((np.asarray(points, float) - np.array(self.centre)) ** 2, axis=-1))

    def gradient(self, points: Array) -> Array:
        offset = np.asarray(points, float) - np.array(self.centre)
        return offset / np.maximum(np.sqrt(np.sum(offset**2, axis=-1, keepdims=True)), np.finfo(float).tiny)


def _normalised_direction(direction: Vector) -> Array:
    vector = np.array(direction, float)
    return vector / np.sqrt(vector @ vector)


def _check_direction(direction: Vector, name: str) -> None:
    if not np.any(direction) or not np.all(np.isfinite(direction)):
        raise InvalidRequest(f"{name} {direction} has no length")
