"""Cells of the faces of OCCT shapes (`tpmscad.brep.surface_cells`): surfaces of any kind as bicubic patches in their parameters.

A face's rectangle is bisected until a bicubic patch through 16 of its points is as near as asked to the surface between them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array, IntArray
from tpmscad.brep.surface_cells import DEGREE, CellFit, SurfaceCells, trim_cells
from tpmscad.kernel.measure.shape_sampling import divide_pcurves
from tpmscad.kernel.occt.exploration import orientation_sign
from tpmscad.kernel.occt.geometry_evaluators import SurfaceTable, face_evaluator, pack_surfaces
from tpmscad.splines.basis import apply_bases, bernstein_basis, bezier_interpolation

CHECKED = np.array([0.125, 0.375, 0.625, 0.875])
"""Grid lines between the nodes on which the distance between patch and surface is measured."""

PAD_FACTOR = 2.0
"""The bound of this distance over the greatest one measured."""

MAX_BISECTIONS = 24
"""Of a face before its patches count as near enough, with the distance measured."""

MIN_CHORDS_PER_PCURVE = 16
"""Chords of a curve that trims a face, a line excepted; how far the curve is from them is measured."""

SLACK_FACTOR = 1.5
"""The bound of the distance between a loop and its chord over the one measured at the middle of the chord."""

_NODES, _TO_POLES = bezier_interpolation(DEGREE)


def face_cells(faces: Sequence[TopoDS_Face], tol: float) -> SurfaceCells:
    """Cells of faces whose patches are within `tol` of the surfaces."""
    fit = cell_fitter(faces)
    chords, slacks = zip(*map(_trimming_chords, faces), strict=True)
    box = np.array([np.stack([chord.min(axis=(0, 1)), chord.max(axis=(0, 1))], axis=1) for chord in chords])
    face, done = np.arange(len(faces)), []
    for bisections in range(MAX_BISECTIONS + 1):
        nets, pad = fit(face, box)
        near = (pad <= tol) | (bisections == MAX_BISECTIONS)
        done.append((nets[near], pad[near], box[near], face[near]))
        nets, box, face = nets[~near], box[~near], face[~near]
        if not len(face):
            break
        bend = [np.linalg.norm(np.diff(nets, 2, axis=axis), axis=-1).max(axis=(1, 2)) for axis in (1, 2)]
        at, axis = np.arange(len(face)), (bend[1] > bend[0]).astype(np.int64)
        low, high = box.copy(), box.copy()
        low[at, axis, 1] = high[at, axis, 0] = box[at, axis].mean(axis=1)
        box, face = np.concatenate([low, high]), np.concatenate([face, face])
    nets, pad, box, face = (np.concatenate(parts) for parts in zip(*done, strict=True))
    order = np.argsort(face, kind="stable")
    sign = np.array([float(orientation_sign(each)) for each in faces])
    return trim_cells(nets[order], pad[order], box[order], face[order], sign, chords, slacks, fit)


def cell_fitter(faces: Sequence[TopoDS_Face]) -> CellFit:
    """The function that fits cells of these faces."""
    surfaces = pack_surfaces([face_evaluator(face) for face in faces])
    between = bernstein_basis(DEGREE, CHECKED)

    def fit(face: IntArray, box: Array) -> tuple[Array, Array]:
        nodes, checks = (_evaluate_grids(surfaces, face, *_grid_lines(box, t)) for t in (_NODES, CHECKED))
        nets = apply_bases(_TO_POLES, nodes, _TO_POLES)
        fitted = apply_bases(between, nets, between)
        return nets, PAD_FACTOR * np.linalg.norm(fitted - checks, axis=3).max(axis=(1, 2))

    return fit


def _grid_lines(boxes: Array, t: Array) -> tuple[Array, Array]:
    """Parameters u and v, (n, k) each, of the grid lines t (k,) of rectangles (n, 2, 2)."""
    low, size = boxes[:, :, :1], boxes[:, :, 1:] - boxes[:, :, :1]
    return low[:, 0] + t * size[:, 0], low[:, 1] + t * size[:, 1]


def _evaluate_grids(surfaces: SurfaceTable, face: IntArray, u: Array, v: Array) -> Array:
    """Points (n, k, k, 3) of faces (n,) on the grids of parameters u (n, k) with v (n, k)."""
    uv = np.stack(np.broadcast_arrays(u[:, :, None], v[:, None]), axis=-1)
    points = surfaces(np.repeat(face, uv[0, ..., 0].size), uv.reshape(-1, 2))[0]
    return points.reshape(*uv.shape[:3], 3)


def _trimming_chords(face: TopoDS_Face) -> tuple[Array, Array]:
    """Chords (c, 2, 2) of the loops of a face in its parameters, and how far the loops are from them in u and v, (c, 2)."""
    chords, slacks = [], []
    for curve, t in divide_pcurves(face, MIN_CHORDS_PER_PCURVE):
        ends, middles = (np.array([curve.Value(s).Coord() for s in at.tolist()]) for at in (t, 0.5 * (t[:-1] + t[1:])))
        chords.append(np.stack([ends[:-1], ends[1:]], axis=1))
        slacks.append(SLACK_FACTOR * np.abs(middles - 0.5 * (ends[:-1] + ends[1:])) * (len(t) > 2))
    return np.concatenate(chords), np.concatenate(slacks)
