"""The part of a CAD body that is deeper than a skin, by an arrangement of offset faces in arrays (`tpmscad.erosion`).

The skin has the thickness asked for everywhere, round concave edges too. Where offset faces touch without crossing, the skin is
made thicker by 1e-4. The thickness is measured, on the offset body and on the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tpmscad._typing import Array
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.erosion.eroded_body import erode_body as erode_body_in_arrays
from tpmscad.errors import InvalidRequest, KernelError, NoOffset, format_point
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.body_brep import read_free_form_body
from tpmscad.kernel.body_import.cad_body import CadBody, read_body
from tpmscad.kernel.boolean.hollow_body import find_skin_faces
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.measure.skin_depth import SkinDepth, SkinThickness, measure_skin_thickness, sample_depths
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.results.certificate import Check

MIN_THICKNESS_RATIO = 0.98
MAX_THICKNESS_RATIO = 1.45
"""In skins: limits of the thickness; the mitre at an open face that another one leans over is up to 1.45 skins thick."""

EXACT_RATIO = 1.001
"""In skins: thickness up to which a point counts as exact in the note."""

DEEPEST_STARTS = 3
"""Searches for the deepest point, where no sample is deeper than the skin; each takes some 100 distances."""

DEEPEST_REL_TOL = 1e-5
"""Of the depth: accuracy of the deepest point."""

SKIN_EXCESS = 1e-4
"""In skins: by how much the skin is thicker in the second attempt. Offset surfaces of a body in round numbers may touch without
crossing at just the thickness asked for: a tube may meet the edge between two others, or two planes may coincide."""

GREATEST_TURN = 0.9 * np.pi
"""Radians: spline faces whose normals turn by more are split, for their offset surfaces might cross themselves."""

DEPTH_SAMPLES = 256
INSET_SAMPLES = 256
"""Points in the body's box, and just deeper than the skin below its faces, that tell whether an offset misses a part. Each takes
0.3 to 1 ms, or 5 ms where faces meet in splines."""

DEEP_RATIO = 1.01
"""In skins: depth from which a point must lie in the offset body."""

MITRE_GAP = 1 - 1 / MAX_THICKNESS_RATIO
"""In skins: distance from the offset body up to which a point may be missed in a mitre; the tube that the mitre replaces is
nowhere farther from it."""

MESH_DEVIATION, MESH_ANGLE = 0.05, 0.5
"""In skins, and radians: fineness of the meshes of the eroded body that must hold these points; the kernel's classifier is asked
for those that they miss. With 0.004, which needs no classifier, a wing of 500 skins took 40 s."""


@dataclass(frozen=True, slots=True, eq=False)
class ErodedBody:
    """The parts of a body deeper than the skin, largest first, and the depth they were measured by."""

    parts: tuple[CadBody, ...]
    depth: SkinDepth


def erode_body(body: CadBody, skin: float, open_faces: Sequence[Any] = ()) -> ErodedBody:
    """The parts of the body deeper than `skin` (model units) below its faces; open faces get no skin.

    Raises InvalidRequest if nothing is that deep, TrimmingError if the offset faces do not close, and KernelError if they miss
    the thickness.
    """
    closed = [face for face in faces_of(body.shape) if not any(face.IsSame(o) for o in open_faces)]
    depth = SkinDepth(body.shape, closed)
    points, depths = sample_depths(depth, skin, DEPTH_SAMPLES, INSET_SAMPLES)
    if not (depths > skin).any():
        deepest, most = find_deepest(depth, points, depths)
        if most <= skin * (1 + DEEPEST_REL_TOL):
            raise InvalidRequest(
                f"a skin of {skin:g} leaves nothing of {body.name}, which is nowhere deeper than {most:.6g}: "
                "make it thinner than that, or leave the body solid"
            )
        points, depths = np.concatenate([points, deepest[None]]), np.append(depths, most)

    request = ErosionRequest(body, skin, open_faces, depth, points[depths > DEEP_RATIO * skin])
    return ErodedBody(EROSION_METHODS.run(request).value, depth)


def find_deepest(depth: SkinDepth, points: Array, depths: Array) -> tuple[Array, float]:
    """The deepest point (3,) of a body and its depth, by a simplex search from each of the deepest of points (n, 3)."""
    low, high = enclosing_box(depth.solid)
    best, most = 0.5 * (low + high), 0.0
    for k in np.argsort(depths)[::-1][:DEEPEST_STARTS].tolist():
        found = minimize(
            lambda p: -float(depth(p[None])[0]),
            points[k],
            method="Nelder-Mead",
            options={
                "initial_simplex": points[k] + 0.2 * depths[k] * np.concatenate([np.zeros((1, 3)), np.eye(3)]),
                "xatol": DEEPEST_REL_TOL * depths[k],
                "fatol": 0.1 * DEEPEST_REL_TOL * depths[k],
            },
        )
        if -found.fun > most:
            best, most = np.asarray(found.x), -float(found.fun)
    return best, most


@dataclass(frozen=True, slots=True, eq=False)
class ErosionRequest:
    """A body, its skin and open faces, the depth below its closed faces, and points (n, 3) deeper than the skin."""

    body: CadBody
    skin: float
    open_faces: Sequence[Any]
    depth: SkinDepth
    deep: Array

    def check(self, solids: Sequence[Any]) -> tuple[CadBody, ...]:
        """The solids as bodies; KernelError if they are not the part of the body deeper than the skin."""
        try:
            parts = tuple(map(read_body, solids))
        except InvalidRequest as error:  # it blames the body that was given
            raise KernelError("offset by the skin", "the solid that it made is not valid") from error
        check_eroded(parts, self.open_faces, self.skin, self.depth, self.deep)
        return parts


def erode_in_arrays(request: ErosionRequest, excess: float = 0.0) -> tuple[CadBody, ...]:
    """The parts of a body deeper than (1 + excess) skins, by an arrangement of offset faces."""
    own = faces_of(request.body.shape)
    body = read_free_form_body(request.body.shape, [str(i) for i in range(len(own))], greatest_turn=GREATEST_TURN)
    opened = np.array([any(face.IsSame(o) for o in request.open_faces) for face in own])
    eroded = erode_body_in_arrays(body.brep, body.free_form, (1 + excess) * request.skin, opened[body.brep.faces.tag])
    if not len(eroded.faces):
        raise KernelError("offset by the skin", "the offset is empty")
    return request.check(build_solids(eroded).solids)


EROSION_METHODS = Fallbacks(
    (
        Fallback("an arrangement of offset faces", erode_in_arrays, "one to three seconds"),
        Fallback("an arrangement of offset faces", partial(erode_in_arrays, excess=SKIN_EXCESS), "as much again"),
    ),
    final=(NoOffset,),
    remedy="change `skin` a little",
)
"""How a body is eroded by its skin."""


def check_eroded(parts: Sequence[CadBody], open_faces: Sequence[Any], skin: float, depth: SkinDepth, deep: Any) -> None:
    """KernelError if the boundary of the parts is too shallow or too deep, or if they miss points `deep` (n, 3) in the body.

    Points in mitres, which lie near the parts, are let off.
    """
    if not parts:
        raise KernelError("offset by the skin", "the offset is empty")
    inner = find_skin_faces([part.shape for part in parts], open_faces)
    for check in check_skin_thickness(measure_skin_thickness(inner, depth), skin):
        if not check.passed:
            raise KernelError("offset by the skin", check.shortfall)
    meshes = [mesh for part in parts for mesh in mesh_solids(part.shape, MESH_DEVIATION * skin, MESH_ANGLE)]
    held = np.sum([winding_numbers(mesh.points, mesh.triangles, deep) for mesh in meshes], axis=0)
    missed = deep[held < 1]
    if len(missed):
        missed = missed[~np.any([contains_points(part.shape, missed) for part in parts], axis=0)]
    if len(missed):
        gaps = np.min([SkinDepth(part.shape, faces_of(part.shape)).distances(missed) for part in parts], axis=0)
        missed = missed[(gaps > MITRE_GAP * skin) | (depth.distances(missed) > MAX_THICKNESS_RATIO * skin)]
    if len(missed):
        where = format_point(missed[0])
        raise KernelError("offset by the skin", f"the offset misses a part of the body near {where}")


def check_skin_thickness(measured: SkinThickness, skin: float) -> tuple[Check, ...]:
    """The checks that a skin is nowhere thinner and nowhere thicker than the limits."""
    least, greatest = measured.least, measured.greatest
    if not len(measured.thickness):
        return ()
    return (
        Check(
            "skin thinner than requested by",
            skin - least,
            (1 - MIN_THICKNESS_RATIO) * skin,
            f"the skin is only {least:.4g} thick near ({measured.locate(least)}), less than {MIN_THICKNESS_RATIO:g} x {skin:g}",
        ),
        Check(
            "skin thickness",
            greatest,
            MAX_THICKNESS_RATIO * skin,
            f"the skin is {greatest:.4g} thick near ({measured.locate(greatest)}), more than {MAX_THICKNESS_RATIO:g} x {skin:g}",
        ),
    )


def describe_thickness(measured: SkinThickness, skin: float) -> str:
    """The note on the measured thickness of the skin."""
    n = len(measured.thickness)
    if not n:
        return f"skin of {skin:g} by an arrangement of offset faces"
    exact = float((measured.thickness <= EXACT_RATIO * skin).mean())
    mitres = "" if exact == 1 else f", {1 - exact:.1%} of the points thicker than asked, in mitres along open faces"
    return (
        f"skin of {skin:g} by an arrangement of offset faces: {measured.least:.4g} to {measured.greatest:.4g} thick, "
        f"measured at {n} points of its inner faces{mitres}"
    )
