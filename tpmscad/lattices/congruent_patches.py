"""Patches that a coordinate map leaves congruent: found by their samples, fitted once and moved.

A ring repeats its cell by a rotation, a screw by a screw motion, a stretched lattice by translations. Nothing is assumed about
the map: samples of all patches on one grid of parameters are compared. Distances between a few samples, which rigid motions keep,
separate nearly all classes; within a class the best rigid motion is computed (Kabsch), and a patch that it misses is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.welding import cluster_points
from tpmscad.rigid_motion import Motion, match_points

CONGRUENCE_TOL_FRACTION = 1e-11
"""Samples that agree to this fraction of a patch's extent after a rigid motion belong to congruent patches: above the round-off
of maps (1e-14) and of the differences that give a user's map its normals (1e-12)."""

SIGNATURE_POINTS = 7
"""Samples whose mutual distances separate the classes."""


@dataclass(frozen=True, slots=True, eq=False)
class CongruenceClasses:
    """Classes of patches up to proper rigid motions.

    `first` (n,) is the first patch of each class; patch i is patch first[label[i]] moved by `motion[i]`.
    """

    first: IntArray
    label: IntArray
    motion: Motion


def group_congruent(samples: Array) -> CongruenceClasses:
    """Classes of patches by their samples (P, m, 3) at common parameters, any number of points each."""
    count = len(samples)
    tol = CONGRUENCE_TOL_FRACTION * float(np.ptp(samples[0], axis=0).max())
    chosen = samples[:, np.linspace(0, samples.shape[1] - 1, SIGNATURE_POINTS).astype(int)]
    i, j = np.triu_indices(SIGNATURE_POINTS, 1)
    distances = np.linalg.norm(chosen[:, i] - chosen[:, j], axis=2)
    label, first = cluster_points(distances, 10 * tol)
    motion = match_points(samples[first[label]], samples)
    misses = np.abs(motion[:, None].apply(samples[first[label]]) - samples).max(axis=(1, 2)) > 10 * tol
    alone = np.flatnonzero(misses)
    label[alone] = len(first) + np.arange(len(alone))
    first = np.concatenate([first, alone])
    own = first[label] == np.arange(count)
    motion.rotation[own], motion.translation[own] = np.eye(3), 0.0
    return CongruenceClasses(first, label, motion)
