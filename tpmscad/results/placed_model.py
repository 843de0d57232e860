"""Models where a front end has put them: the model whose solid a part is, moved to the place of the part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import move_brep
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.occt.exploration import vertices_of
from tpmscad.kernel.render.scene import pieces_of
from tpmscad.results.model import Model
from tpmscad.rigid_motion import Motion, match_points

PLACE_RTOL = 1e-9
"""In sizes of the model: distance of a part's vertices from those of the moved model."""

WHOLE_TURN_TOL = 1e-12
"""Rotations nearer to quarter turns than this are quarter turns: the rest is round-off of the fit."""


def place_model(model: Model, shape: Any) -> Model:
    """The model moved to the place of `shape`, a TopoDS shape that is the model's own solid after rotations and translations.

    The certificate, which no motion changes, is shared. InvalidRequest if the shape is not the model's solid any more.
    """
    ours, theirs = vertices_of(model.built.shape), vertices_of(shape)
    motion = _fit_motion(ours, theirs) if ours.shape == theirs.shape else None
    if motion is None:
        raise InvalidRequest(
            "the part is not the model's solid any more: it was mirrored, scaled or cut. Write it as any other shape, or "
            "use its `model`, which is as it was made"
        )
    patches = move_brep(model.patches, motion)
    built = model.built
    return replace(
        model,
        patches=patches,
        built=replace(built, solids=tuple(pieces_of(shape)))
        if isinstance(built, OcctSolids)
        else build_solids(patches),
        unit_cell=None,
        distance_to_reference=_move_distance(model.distance_to_reference, motion),
        make_spline_volumes=None,
        envelope=model.envelope and model.envelope.moved(motion),
    )


def _fit_motion(start: Array, end: Array) -> Motion | None:
    """The proper motion that takes points (n, 3) to others in the same order, or None if there is none."""
    rotation = match_points(start[None], end[None])[0].rotation
    if np.abs(rotation - np.rint(rotation)).max() < WHOLE_TURN_TOL:
        rotation = np.rint(rotation)
    motion = Motion(rotation, end.mean(axis=0) - rotation @ start.mean(axis=0))
    size = float(np.ptp(start, axis=0).max() + np.abs(end).max())
    return motion if np.abs(motion.apply(start) - end).max() <= PLACE_RTOL * size else None


def _move_distance(distance: Callable[[Array], Array] | None, motion: Motion) -> Callable[[Array], Array] | None:
    """The distance from the moved reference."""
    return None if distance is None else lambda points: distance(motion.apply_inverse(points))
