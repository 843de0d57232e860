"""The solid of a lattice's wall as trivariate splines: one body between each pair of offset patches, copied by rigid motions.

Between the lower and the upper offset patch of one mid patch lies the *ruled* volume, linear along w: its segments are normals of
the mid surface, since X + d n is linear in d, and its sides are the ruled gap faces of a natural boundary, or lie in the mirror
planes that end a reflected piece. The bodies therefore fill the solid exactly, whatever the fit of the patches; a mid surface
between them would add poles and change nothing but the sides, which would leave the solid.

All bodies run from the lower surface (w = 0) to the upper one; those placed by a mirror are left-handed, as `sense` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray, triple
from tpmscad.brep.welding import WELD_RADIUS_FRACTION, cluster_points, roll_up
from tpmscad.lattices.copies import surfaces_over_mid_patch
from tpmscad.lattices.mapped_lattice import MappedLayer
from tpmscad.lattices.offset_surfaces import OffsetSurfaces
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline_volume import BSplineVolume, ruled_volume
from tpmscad.splines.knots import elevate_degree
from tpmscad.surfaces import PatchSymmetry

SHARED_BODY_TOL_FRACTION = 1e-10
"""Bodies whose poles agree to this fraction of their extent after a rigid motion are copies of one."""


@dataclass(frozen=True, slots=True, eq=False)
class SideConnectivity:
    """What the quadrilaterals that the bodies stand on share: numbers of corners and sides (n, 4), and directions (n, 4).

    Corner i is the start of side i, counter-clockwise in (u, v). `direction` is +1 for the body that has a side first and for
    those that run along it in the same sense, -1 for the others.
    """

    corner: IntArray
    side: IntArray
    direction: IntArray

    @property
    def is_open(self) -> BoolArray:
        """Whether no other body shares a side: (n, 4)."""
        return np.bincount(self.side.ravel())[self.side] == 1


@dataclass(frozen=True, slots=True, eq=False)
class SplineVolumes:
    """Placed trivariate splines: body i is primitives[carrier[i]] moved by motion[i], right-handed if sense[i] is +1.

    `periods` are the lengths after which the endless solid repeats along x, y and z; 0 where it does not. `border` says what the
    open sides are: a ruled "gap", or a "cap" in a mirror plane.
    """

    primitives: tuple[BSplineVolume, ...]
    carrier: IntArray
    motion: Motion
    sense: IntArray
    periods: tuple[float, float, float]
    border: str

    def __len__(self) -> int:
        return len(self.carrier)

    def scaled(self, factor: float) -> SplineVolumes:
        """The bodies scaled about the origin."""
        periods = triple(factor * period for period in self.periods)
        motion = Motion(self.motion.rotation, factor * self.motion.translation)
        primitives = tuple(primitive.scaled(factor) for primitive in self.primitives)
        return replace(self, primitives=primitives, motion=motion, periods=periods)

    def body(self, index: int) -> BSplineVolume:
        """One body, right-handed: w runs downwards where the placed primitive is left-handed."""
        placed = self.primitives[self.carrier[index]].moved(self.motion[index])
        return placed if self.sense[index] > 0 else placed.reversed_w()

    def right_handed_primitives(self) -> list[BSplineVolume]:
        """The primitives, with w reversed where they are left-handed themselves."""
        return [p if _handedness(p) > 0 else p.reversed_w() for p in self.primitives]

    def integrate_volume(self) -> float:
        """Volume of all bodies together."""
        volumes = np.array([abs(p.integrate_volume()) for p in self.primitives])
        return float(volumes @ np.bincount(self.carrier, minlength=len(volumes)))

    def connect(self, periods: Sequence[float] = (0.0, 0.0, 0.0)) -> SideConnectivity:
        """What the bodies share, modulo translations along the axes by the periods, where these are not 0."""
        quarters = np.array([0.0, 0.25, 0.5, 0.75])
        samples = np.stack([_sample_border(primitive, quarters) for primitive in self.primitives])
        points = self.motion[:, None, None].apply(samples[self.carrier])  # (n, 4 sides, 4 quarters, 3)
        radius = WELD_RADIUS_FRACTION * float(min(np.linalg.norm(s[0, 0] - s[2, 0]) for s in samples))
        rolled = roll_up(points.reshape(-1, 3), periods).reshape(-1, 4, 3 + np.count_nonzero(periods))
        corner, _ = cluster_points(rolled[:, 0], radius)
        side, first = cluster_points(rolled[:, 2], radius)
        same = np.linalg.norm(rolled[:, 1] - rolled[first[side], 1], axis=1)
        opposite = np.linalg.norm(rolled[:, 1] - rolled[first[side], 3], axis=1)
        direction = np.where(same <= opposite, 1, -1)
        n = len(self)
        return SideConnectivity(corner.reshape(n, 4), side.reshape(n, 4), direction.reshape(n, 4))


def _sample_border(primitive: BSplineVolume, fractions: Array) -> Array:
    """Points at fractions of the four sides of the lower surface, counter-clockwise: (4, m, 3)."""
    lower = primitive.end(2, last=False)
    curves = [lower.side(s) for s in range(4)]
    return np.stack([c(c.domain[0] + fractions * (c.domain[1] - c.domain[0])) for c in curves])


def _handedness(body: BSplineVolume) -> int:
    """Sign of the Jacobian determinant in the middle of the body."""
    return int(np.sign(body.jacobian(*([(low + high) / 2] for low, high in body.domain))[0, 0, 0]))


def copy_wall(wall: BSplineVolume, motion: Motion, periods: tuple[float, float, float], border: str) -> SplineVolumes:
    """The copies of one body by rigid motions (n,), mirrors included."""
    n = len(motion)
    return SplineVolumes((wall,), np.zeros(n, np.int64), motion, _handedness(wall) * motion.handedness, periods, border)


def wall_over_mid_patch(symmetry: PatchSymmetry, offsets: OffsetSurfaces) -> BSplineVolume:
    """The wall over the mid patch, in cells: both surfaces have one spline space already."""
    lower, upper = surfaces_over_mid_patch(symmetry, offsets)
    return ruled_volume(lower, upper)


def wall_of_piece(offsets: OffsetSurfaces) -> BSplineVolume:
    """The wall over a piece between mirrors, in cells: the surface of lower degree is elevated to that of the other."""
    lower, upper = (offsets.primitives[layer.primitive] for layer in offsets.layers())
    degree_u, degree_v = max(lower.degree_u, upper.degree_u), max(lower.degree_v, upper.degree_v)
    return ruled_volume(*(elevate_degree(surface, degree_u, degree_v) for surface in (lower, upper)))


def mapped_walls(lower: MappedLayer, upper: MappedLayer, periods: tuple[float, float, float]) -> SplineVolumes:
    """The walls between fitted layers of a mapped lattice; those that are congruent share a primitive."""
    primitives: list[BSplineVolume] = []
    first_of: dict[tuple[int, int], tuple[int, int]] = {}  # labels of the two patches -> primitive, placement
    carrier, motions = [], []
    for i in range(len(lower.label)):
        key = int(lower.label[i]), int(upper.label[i])
        body = ruled_volume(lower.patch(i), upper.patch(i))
        if key in first_of:
            number, first = first_of[key]
            motion = lower.motion[i] @ _invert(lower.motion[first])
            extent = float(np.ptp(body.poles.reshape(-1, 3), axis=0).max())
            miss = np.abs(motion.apply(primitives[number].poles) - body.poles).max()
            if miss <= SHARED_BODY_TOL_FRACTION * extent:
                carrier.append(number)
                motions.append(motion)
                continue
        first_of[key] = len(primitives), i
        carrier.append(len(primitives))
        motions.append(Motion(np.eye(3), np.zeros(3)))
        primitives.append(body)
    placed = Motion.stack(motions)
    sense = np.array([_handedness(p) for p in primitives])[carrier] * placed.handedness
    return SplineVolumes(tuple(primitives), np.array(carrier), placed, sense, periods, "gap")


def _invert(motion: Motion) -> Motion:
    """The inverse of a single motion."""
    return Motion(motion.rotation.T, -motion.rotation.T @ motion.translation)
