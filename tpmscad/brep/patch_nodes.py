"""Nodes of whole B-spline patches: from them the nearest patch of a point, its side and its distance are found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces, stacked_spline_faces
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.splines.bspline import BSplineSurface

NODES_PER_DIRECTION = 7
"""Nodes of every patch along u and v from which foot points are sought."""

SIDE_NODES = 5
"""The same where only the side of the surface is asked."""

SEARCH_RADIUS_PATCHES = 2.0
"""In sizes of the largest patch: the distance around the points within which nodes are searched first."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchNodes:
    """Points (n, 3) of spline faces, the face (n,) of each, its parameters (n, 2), and the size of the largest patch."""

    points: Array
    face: IntArray
    parameters: Array
    size: float


def place_nodes(brep: Brep, count: int = NODES_PER_DIRECTION) -> PatchNodes:
    """A grid of count x count nodes on every face that lies on a B-spline."""
    found, size = [(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros((0, 2)))], 0.0
    for own, place, stack in stacked_spline_faces(brep):
        u, v = _make_grid(stack, count)
        local = _unstack(stack(u, v))
        size = max(size, float(np.ptp(local, axis=1).max()))
        placed = brep.faces.motion[own][:, None].apply(local[place]).reshape(-1, 3)
        found.append((placed, np.repeat(own, len(u)), np.tile(np.column_stack([u, v]), (len(own), 1))))
    points, face, parameters = map(np.concatenate, zip(*found, strict=True))
    return PatchNodes(points, face, parameters, size)


def _make_grid(carrier: BSplineSurface, count: int) -> tuple[Array, Array]:
    """The parameters u, v (count^2,) of a grid on a patch."""
    u, v = np.meshgrid(*(np.linspace(*domain, count) for domain in carrier.domain), indexing="ij")
    return u.ravel(), v.ravel()


def _unstack(values: Array) -> Array:
    """Values (n, 3k) of k stacked surfaces one by one: (k, n, 3)."""
    return values.reshape(len(values), -1, 3).swapaxes(0, 1)


def project_from_nodes(brep: Brep, nodes: PatchNodes, points: Array, nearest: int) -> Iterator[tuple[IntArray, Array]]:
    """Faces (n,) of the nodes nearest to points (n, 3), the nearest first, and the distances (n,) from their patches."""
    _, index = cKDTree(nodes.points).query(points, min(nearest, len(nodes.points)))
    for node in index.reshape(len(points), -1).T:
        face, distance = nodes.face[node], np.empty(len(points))
        carrier = brep.faces.carrier[face]
        for number in np.unique(carrier).tolist():
            at = np.flatnonzero(carrier == number)
            patch = brep.carriers[number]
            assert isinstance(patch, BSplineSurface)
            local = brep.faces.motion[face[at]].apply_inverse(points[at])
            distance[at] = project_to_patch(patch, local, *nodes.parameters[node[at]].T)[0]
        yield face, distance


def measure_patch_distances(brep: Brep, points: Array, nearest: int = 4) -> Array:
    """Distances (n,) of points (n, 3) from the spline faces, whole, by the patches of the nearest nodes."""
    return np.min([distance for _, distance in project_from_nodes(brep, place_nodes(brep), points, nearest)], axis=0)


def signed_distances_to_nodes(patches: Brep, points: Array) -> Array:
    """Distances (n,) of points (n, 3) from the nearest node of the patches along its outward normal; negative in the lattice."""
    size = max(float(np.ptp(carrier.poles, axis=(0, 1)).max()) for _, carrier in spline_faces(patches))
    for radius in (SEARCH_RADIUS_PATCHES * size, np.inf):
        nodes, normals = _place_normals(patches, points.min(axis=0) - radius, points.max(axis=0) + radius)
        if len(nodes):
            distance, nearest = cKDTree(nodes).query(points)
            if distance.max() <= radius - size:  # no patch outside the searched box is nearer
                break
    return np.einsum("ni,ni->n", points - nodes[nearest], normals[nearest])


def _place_normals(patches: Brep, low: Array, high: Array) -> tuple[Array, Array]:
    """Nodes and outward normals (n, 3), (n, 3) of the patches whose centers lie in the box [low, high]."""
    faces = patches.faces
    nodes, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for own, place, stack in stacked_spline_faces(patches):
        points, by_u, by_v = map(_unstack, stack.jet(*_make_grid(stack, SIDE_NODES)))
        center = faces.motion[own].apply(points.mean(axis=1)[place])
        near = ((center >= low) & (center <= high)).all(axis=1)
        motion, place = faces.motion[own[near]], place[near]
        orientation = faces.sense[own[near]] * motion.handedness
        nodes.append(motion[:, None].apply(points[place]).reshape(-1, 3))
        normal = motion[:, None].apply_to_vectors(np.cross(by_u, by_v)[place]) * orientation[:, None, None]
        normals.append(normal.reshape(-1, 3))
    return np.concatenate(nodes), np.concatenate(normals)
