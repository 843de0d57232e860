"""The solid of a field in a design domain of free form: fitted in the box of the domain, then carried over by its spline.

In the box everything is as for any field (`field_patches`): adaptive mesh, patches, caps, Betti numbers. The spline then maps
the finished boundary representation (`tpmscad.brep.mapped_brep`), so that the solid has the topology of the one in the box, and
its caps lie in the boundary surfaces of the domain. What the certificate says is measured in the model.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.mapped_brep import MappedBrep, map_brep
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field, as_field
from tpmscad.kernel.build.solids import build_solids
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.results.certificate import PatchMeasures, certify_built_solids, require
from tpmscad.results.loose_pieces import drop_loose_pieces
from tpmscad.results.model import Model
from tpmscad.solids.matter.field_patches import FieldPatches, fit_field_patches
from tpmscad.solids.matter.patch_measures import check_field_tangent_jump
from tpmscad.stage_timer import StageTimer

STRETCH_SAMPLES = 17
"""Samples along each axis of the domain for the greatest stretch of the map."""

FIT_TOL_FRACTION = 0.97
"""Part of the tolerance for the patches in the box; the rest is for stretches between the samples and for the mapped patches."""

PREIMAGE_STEPS = 3
"""Newton steps from the parameters of a sample to those of its image, which is off by the error of the interpolation."""


def solidify_mapped(
    field: Field | Callable[..., Any],
    map: SplineMap,
    tol: float,
    loose: str,
    executor: Executor | None,
    stages: StageTimer,
) -> Model:
    """The solid of a field in the domain of a map, within `tol` of the image of its level set; errors as for `solidify`."""
    if any(map.closed):
        raise InvalidRequest(
            f"the {map.name} closes along {'uvw'[map.closed.index(True)]}: the solid of a field would end at the seam; "
            "use tpmscad.lattice, or split the domain in two"
        )
    stretch = _greatest_stretch(map)
    found = fit_field_patches(as_field(field), *map.domain, FIT_TOL_FRACTION * tol / stretch, stages, executor=executor)
    with stages("map"):
        image = map_brep(found.fitted.brep, map.volume)
        moments = integral_properties.integrate_faces(image.brep)
    with stages("build"):
        brep, built, dropped = drop_loose_pieces(image.brep, build_solids(image.brep, moments), loose)
    with stages("check"):
        measures = _measure(found, image, map, stretch, tol)
        certificate = certify_built_solids(built, measures, notes=dropped.notes, dropped=dropped.volumes)
    return Model("mapped field solid", brep, certificate.with_seconds(stages.seconds), built)


def _greatest_stretch(map: SplineMap) -> float:
    """The greatest singular value of the Jacobian on a grid of the domain."""
    axes = [np.linspace(a, b, STRETCH_SAMPLES) for a, b in zip(*map.domain, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return float(np.linalg.norm(map.volume.images(points)[1], ord=2, axis=(1, 2)).max())


def _measure(found: FieldPatches, image: MappedBrep, map: SplineMap, stretch: float, tol: float) -> PatchMeasures:
    """The figures of the mapped patches.

    Their distance from the image of the level set is measured from samples. The other way round it is bounded: by that in the
    box times the greatest stretch, and the error of the interpolation.
    """
    fitted = found.fitted
    distance = _distances_from_level_set(fitted.field, image, map)
    backward = stretch * fitted.deviation.from_reference + image.fit_error
    deviation = Deviation(
        max(float(distance.max()), stretch * fitted.deviation.to_reference + image.fit_error, backward),
        float(np.sqrt((distance**2).mean())),
        float(distance.max()),
        backward,
    )
    checks = (
        check_field_tangent_jump(image.continuity.tangent_jump_deg),
        require(
            found.field_betti in (None, found.properties.betti),
            f"Betti numbers {found.properties.betti} in the domain differ from the field's, {found.field_betti}: "
            "use a finer `tol`",
        ),
    )
    figures = {
        "least Jacobian determinant of the map, proved": map.least_jacobian,
        "greatest stretch of the map": stretch,
        "distance of patches from the exact image": image.fit_error,
        "distance of samples of the solid from the field": float(distance.max()),
    }
    return PatchMeasures(
        tol,
        deviation,
        f"field under the {map.name}",
        image.continuity,
        figures=figures,
        checks=checks,
        notes=fitted.notes,
    )


def _distances_from_level_set(field: Field, image: MappedBrep, map: SplineMap) -> Array:
    """Distances (n,) of samples of the patches from the image of {field = 0}, to first order, at their preimages."""
    at, target = image.sample()
    for _ in range(PREIMAGE_STEPS):
        position, jacobian = map.volume.images(at)
        at = at + np.linalg.solve(jacobian, (target - position)[..., None])[..., 0]
    _, jacobian = map.volume.images(at)
    gradient = np.linalg.solve(np.swapaxes(jacobian, 1, 2), field.gradient(at)[..., None])[..., 0]
    return np.asarray(np.abs(field(at)) / np.linalg.norm(gradient, axis=1))
