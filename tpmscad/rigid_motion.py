"""Rigid motions x -> R x + t with R orthogonal, mirrors included, one or many at a time.

A `Motion` is a batch of motions in the manner of NumPy: its leading axes broadcast against those of the points it moves, and
indexing with integers, masks, slices and None acts on these axes. With n motions and m points,

    motion.apply(points)              points (n, 3): each point by its own motion
    motion[:, None].apply(points)     points (m, 3): every point by every motion, (n, m, 3)
    motion[i].apply(points)           points (..., 3): all points by one motion
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.array_table import ArrayTable

TRANSLATION_TOL_FRACTION = 1e-10
"""Distance, in extents of the points, within which a motion found from them is a translation: above their round-off."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion(ArrayTable):
    """Motions x -> rotation x + translation: orthogonal rotation (..., 3, 3), translation (..., 3)."""

    rotation: Array
    translation: Array

    @classmethod
    def identity(cls, count: int) -> Motion:
        """`count` motions that leave every point where it is."""
        return cls.translations(np.zeros((count, 3)))

    @classmethod
    def translations(cls, vectors: Array) -> Motion:
        """Translations by vectors (n, 3)."""
        return cls(np.tile(np.eye(3), (len(vectors), 1, 1)), vectors)

    @classmethod
    def stack(cls, motions: Sequence[Motion]) -> Motion:
        """Single motions as one batch (n,)."""
        return cls(np.stack([m.rotation for m in motions]), np.stack([m.translation for m in motions]))

    def __iter__(self) -> Iterator[Motion]:
        return (self[i] for i in range(len(self)))

    @property
    def handedness(self) -> IntArray:
        """+1 for proper motions, -1 for mirrors: (...)."""
        return np.where(np.linalg.det(self.rotation) < 0, -1, 1)

    def apply(self, points: Array) -> Array:
        """Images of points (..., 3); leading axes broadcast against the batch."""
        return self.apply_to_vectors(points) + self.translation

    def apply_to_vectors(self, vectors: Array) -> Array:
        """Images of directions (..., 3), which are rotated only."""
        if self.translation.ndim == 1:
            return np.asarray(vectors @ self.rotation.T)
        return np.einsum("...ij,...j->...i", self.rotation, vectors)

    def apply_inverse(self, points: Array) -> Array:
        """Preimages R^T (x - t) of points (..., 3)."""
        return self.apply_inverse_to_vectors(points - self.translation)

    def apply_inverse_to_vectors(self, vectors: Array) -> Array:
        """Preimages R^T v of directions (..., 3)."""
        if self.translation.ndim == 1:
            return np.asarray(vectors @ self.rotation)
        return np.einsum("...ji,...j->...i", self.rotation, vectors)

    def __matmul__(self, inner: Motion) -> Motion:
        """The composition: first `inner`, then this one; one of them may be a single motion."""
        return Motion(self.rotation @ inner.rotation, self.apply(inner.translation))

    def relative_to(self, frame: Motion) -> Motion:
        """frame^-1 composed with this motion: the motion as seen from the frame."""
        rotation = np.swapaxes(frame.rotation, -2, -1) @ self.rotation
        return Motion(rotation, frame.apply_inverse(self.translation))


def match_points(points: Array, images: Array) -> Motion:
    """The proper rigid motions that bring points (P, m, 3) nearest to their images (P, m, 3); exact translations stay exact.

    W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A 32 (1976), 922.
    """
    centre, image_centre = points.mean(axis=1, keepdims=True), images.mean(axis=1, keepdims=True)
    left, _, right = np.linalg.svd(np.swapaxes(images - image_centre, 1, 2) @ (points - centre))
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    rotation = left @ right
    shift = images[:, 0] - points[:, 0]
    extent = np.ptp(points[0], axis=0).max()
    translated = np.abs(images - points - shift[:, None]).max(axis=(1, 2)) <= TRANSLATION_TOL_FRACTION * extent
    rotation[translated] = np.eye(3)
    moved = image_centre[:, 0] - np.einsum("pij,pj->pi", rotation, centre[:, 0])
    return Motion(rotation, np.where(translated[:, None], shift, moved))
