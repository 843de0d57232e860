"""Which cells and patches come near a body: those that miss it need not be fitted."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray
from tpmscad.kernel.body_import._body_field import BodyDistance
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.measure.shape_sampling import contains_points, sample_faces
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.exploration import faces_of

POINTS_PER_CELL = 10.0
"""Points of the body's faces along the edge of a cell."""


class BodyNearness:
    """Whether cells come near a body: by points of its faces, and by the kernel's classifier inside it."""

    def __init__(self, body: CadBody, rotation: Array, edge: float) -> None:
        self.body, self.rotation = body, rotation
        spacing = min(edge / POINTS_PER_CELL, box_diagonal(body.shape))
        self.tree = cKDTree(sample_faces(faces_of(body.shape), spacing).points)
        self.spacing = spacing
        self.low, self.high = body.box

    def __call__(self, images: Array, margin: float, reach: float = 0.0) -> BoolArray:
        """Of cells or patches by the images (n, m, 3) of their points: within a margin, in their diagonals, and a reach."""
        points = images @ self.rotation.T
        distance = self.tree.query(points)[0].min(axis=1)
        near = np.asarray(distance < self.spacing + reach + margin * measure_diagonals(images))
        middle = points[:, points.shape[1] // 2]
        asked = ~near & ((middle > self.low) & (middle < self.high)).all(axis=1)
        clearance = self.tree.query(middle[asked])[0] - 2.0 * self.spacing
        near[asked] = contains_points(self.body.shape, middle[asked], clearance)
        return near

    def is_reached_from(self, points: Array, reach: float) -> BoolArray:
        """Whether points (n, 3) lie in the body or within a reach of it."""
        near = self(points[:, None], 0.0, reach)
        exact = BodyDistance(self.body.shape, self.low, self.high, tuple(faces_of(self.body.shape)))
        near[near] = exact(points[near] @ self.rotation.T) <= reach
        return near


def measure_diagonals(images: Array) -> Array:
    """The diagonals (n,) of the boxes of points (n, m, 3)."""
    return np.asarray(np.linalg.norm(np.ptp(images, axis=1), axis=1))
