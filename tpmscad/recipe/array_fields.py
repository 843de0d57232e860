"""The field of a file that the command line names: beams; or an image by a level, a fraction, labels, or as a graded lattice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import fields
from tpmscad._typing import BoxCorners
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.fields.data.beam_files import is_beam_path
from tpmscad.fields.data.field_notes import DEFAULT_TOL_SPACINGS, find_least_spacing
from tpmscad.fields.data.image_files import read_image
from tpmscad.fields.kinds.coordinate_transforms import place_samples
from tpmscad.fields.kinds.data_domains import bound_by_data
from tpmscad.fields.kinds.label_partitions import LabelPartition
from tpmscad.fields.kinds.sampled_data import SampledField
from tpmscad.solids.matter.field_patches import limit_tol_to_walls

DEFAULT_TOL_CELLS = 0.01
"""In edges of a cell: the tolerance of a graded lattice if none is given; less where its walls are too thin for it."""

DEFAULT_TOL_DIAMETERS = 0.01
"""In diameters of the thinnest beam: the tolerance of a file of beams if none is given."""

BEAMS_MARGIN = 0.01
"""In sizes of the beams: how far the box of their solid reaches beyond them."""

LEAST_FRACTION, GREATEST_FRACTION = 0.15, 0.6
"""Volume fractions of a lattice to which densities are limited: thinner walls break, and thicker ones close the pores."""

OVERSHOOT = 0.12
"""Beyond these limits: what the spline through the densities may pass them by."""


def make_array_field(
    path: Path,
    *,
    as_surface: str | None = None,
    cell: Any = None,
    label: Any = None,
    among: Any = None,
    tol: float | None = None,
    **given: Any,
) -> tuple[Field, BoxCorners, float]:
    """The field, its domain and the tolerance of its solid, which is chosen if none is given, model units.

    Without a level, a volume fraction or a label it is the part of all labels but 0.
    """
    read = {name: value for name, value in given.items() if value is not None}
    if is_beam_path(path):
        others = {"as_surface": as_surface, "cell": cell, "label": label, "among": among}
        unused = [*read, *(name for name, value in others.items() if value is not None)]
        if unused:
            raise InvalidRequest(
                f"{', '.join(f'`{name}`' for name in unused)}: for images, not for beams; leave it out"
            )
        return _read_beams(path, tol)
    if as_surface is not None:
        unused = [f"`{name}`" for name in ("level", "volume_fraction") if name in read]
        unused += ["`label`"] if label is not None else []
        if unused:
            raise InvalidRequest(f"{', '.join(unused)}: a lattice is graded by all of the densities; leave it out")
        return _grade_lattice(path, as_surface, cell, tol, read)
    if cell is not None:
        raise InvalidRequest("`cell` is that of a lattice: give `as_surface` too, or leave it out")
    if among is not None and read.keys() & {"level", "volume_fraction", "smoothing"}:
        raise InvalidRequest("`among` is for labels: leave it out, or `level`, `volume_fraction` and `smoothing`")
    if not read.keys() & {"level", "volume_fraction"}:
        if read.get("centred") is False:
            raise InvalidRequest("labels belong to voxels: leave centred=False out")
        smoothing = read.pop("smoothing", None)
        read.pop("centred", None)
        if among is not None:
            parts, field = _cut_out_label(path, label, among, read)
            return field, parts.domain, _choose_tol(tol, parts.spacing)
        field = fields.labels(path, label="all" if label is None else label, **read)
        if smoothing is not None:
            raise InvalidRequest(
                "labels are smoothed within half a voxel: leave `smoothing` out, it is for grey values"
            )
    elif label is None:
        field = fields.sampled(path, **read)
    else:
        raise InvalidRequest(
            "give either `level` or `volume_fraction`, for grey values, or `label`, for a segmentation"
        )
    domain, spacing = field.domain, find_least_spacing(field)
    assert domain is not None
    assert spacing is not None
    return field, domain, _choose_tol(tol, (spacing,))


def _read_beams(path: Path, tol: float | None) -> tuple[Field, BoxCorners, float]:
    """The beams of a 3MF file with what is beside them, a box around all, and the tolerance."""
    from tpmscad.files.beam_report import report_beams  # loads the kernel

    field = fields.beams(path)
    low, high = np.array(report_beams(path).bounds)
    margin = BEAMS_MARGIN * float((high - low).max())
    domain = tuple((low - margin).tolist()), tuple((high + margin).tolist())
    return field, domain, DEFAULT_TOL_DIAMETERS * float(field.diameters.min()) if tol is None else tol


def _choose_tol(tol: float | None, spacing: tuple[float, ...]) -> float:
    return DEFAULT_TOL_SPACINGS * min(spacing) if tol is None else tol


def _cut_out_label(path: Path, label: Any, among: Any, given: Mapping[str, Any]) -> tuple[LabelPartition, Field]:
    """The regions of several labels that share faces, and that of one of them."""
    parts = fields.label_partition(path, label=among, **given)
    known = ", ".join(map(str, parts.regions))
    if label is None or isinstance(label, str) or np.size(label) != 1:
        raise InvalidRequest(f"give one `label` of those in `among`, {known}")
    number = int(np.ravel(label)[0])
    if number not in parts.regions:
        raise InvalidRequest(f"label {number} is none of those in `among`, {known}: name one of them")
    return parts, parts.regions[number]


def _grade_lattice(
    path: Path, surface: str, cell: Any, tol: float | None, given: Mapping[str, Any]
) -> tuple[Field, BoxCorners, float]:
    """The sheet of a surface whose volume fraction is the density of an image everywhere, and the tolerance that it allows."""
    if cell is None:
        raise InvalidRequest("a lattice needs `cell`, the edge of its cell in mm")
    chosen = {name: given[name] for name in ("frame", "centred", "volume", "array_name") if name in given}
    image = read_image(path, **chosen)
    densities = image.values.astype(float)
    if not ((densities >= 0) & (densities <= 1)).all():  # NaN, too
        raise InvalidRequest(
            f"{path.name} holds values that are no densities from 0 to 1, {np.nanmin(densities):g} to {np.nanmax(densities):g}, "
            "or places without one: a lattice would fill them"
        )
    limited = np.clip(densities, LEAST_FRACTION, GREATEST_FRACTION)
    spacing, origin = given.get("spacing", image.spacing), given.get("origin", image.origin)
    centred = given.get("centred", image.centred)
    smoothing = given.get("smoothing", 0.0)
    density = fields.sampled(limited, spacing, origin, centred=bool(centred), smoothing=smoothing)
    assert isinstance(density, SampledField)
    outside = int((limited != densities).sum())
    told = (
        f"{path.name}: a {surface} sheet with the densities as volume fractions, {outside} of {densities.size} of which were "
        f"limited to {LEAST_FRACTION:g} to {GREATEST_FRACTION:g}"
    )
    density = replace(density, notes=(*image.notes, *density.notes, told))
    phi, placed = fields.tpms(surface, cell), density
    if image.directions is not None:
        own = replace(density, origin=(0.0, 0.0, 0.0))
        placed = place_samples(own, image.directions, np.array(density.origin))
    span = (LEAST_FRACTION - OVERSHOOT, GREATEST_FRACTION + OVERSHOOT)
    thresholds = fields.graded_threshold(phi, placed, span, "sheet")
    assert isinstance(thresholds, tuple)
    lattice, domain = bound_by_data(fields.sheet(phi, *thresholds), placed)
    if tol is None:
        low, high = (np.array(corner) for corner in domain)
        tol = limit_tol_to_walls(lattice, low, high, DEFAULT_TOL_CELLS * float(np.min(cell)))
    return lattice, domain, tol
