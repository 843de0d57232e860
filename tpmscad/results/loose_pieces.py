"""Loose pieces of a result: the chips that the faces of a box or a body cut off a lattice.

A piece is loose if its volume is below 1 % of the largest one's. Loose pieces are left out unless they are asked for, and the
certificate says how many there were. Those of sampled data are removed before the fit, as far as the samples tell them; their
volumes are those of their samples. Where the solid has a boundary representation, it loses their faces too, so that arrays,
kernel and files agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.data_domains import BoundedData
from tpmscad.fields.kinds.sample_specks import remove_specks
from tpmscad.fields.kinds.sampled_data import SampledField
from tpmscad.kernel.boolean.boolean_operations import estimate_volume
from tpmscad.kernel.build.solids import BrepSolids, select_solids
from tpmscad.results.certificate import CHIP_VOLUME_FRACTION

DROP, KEEP = "drop", "keep"


@dataclass(frozen=True, slots=True)
class DroppedPieces:
    """The volumes of the pieces that were left out, model units cubed, largest first."""

    volumes: tuple[float, ...] = ()

    def __or__(self, other: DroppedPieces) -> DroppedPieces:
        return DroppedPieces(tuple(sorted((*self.volumes, *other.volumes), reverse=True)))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the certificate says about them: nothing if there are none."""
        if not self.volumes:
            return ()
        count, limit = len(self.volumes), f"{100 * CHIP_VOLUME_FRACTION:g} % of the largest piece"
        if count == 1:
            return (f'left out: 1 loose piece of {self.volumes[0]:.4g} mm3, below {limit}; loose="{KEEP}" keeps it',)
        return (
            f"left out: {count} loose pieces, {sum(self.volumes):.4g} mm3 together, the largest {self.volumes[0]:.4g} mm3, "
            f'each below {limit}; loose="{KEEP}" keeps them',
        )


NOTHING_DROPPED = DroppedPieces()


def drop_specks(field: Field, lo: Array, hi: Array, loose: str) -> tuple[Field, DroppedPieces]:
    """A field of samples without the specks of its solid in a box, and what was left out; other fields as they are."""
    if loose == KEEP:
        return field, NOTHING_DROPPED
    if isinstance(field, BoundedData):
        first, dropped = drop_specks(field.first, lo, hi, loose)
        return replace(field, first=first), dropped
    if isinstance(field, AffineTransformedField) and isinstance(field.field, SampledField):
        low, high = np.array(field.domain)
        if (lo > low).any() or (hi < high).any():  # what the box cuts off moved data is not known by samples
            return field, NOTHING_DROPPED
        first, last = np.array(field.field.domain)
        cleaned, volumes = remove_specks(field.field, first, last, CHIP_VOLUME_FRACTION)
        share = 1.0 / abs(float(np.linalg.det(field.matrix)))
        return replace(field, field=cleaned), DroppedPieces(tuple(share * volume for volume in volumes))
    if not isinstance(field, SampledField):
        return field, NOTHING_DROPPED
    cleaned, volumes = remove_specks(field, lo, hi, CHIP_VOLUME_FRACTION)
    return cleaned, DroppedPieces(volumes)


def drop_loose_pieces(brep: Brep, built: BrepSolids, loose: str) -> tuple[Brep, BrepSolids, DroppedPieces]:
    """A boundary representation and its solids without the loose pieces, and what was left out."""
    nesting = built.nesting
    kept, dropped = select_pieces([float(nesting.volume[list(of)].sum()) for of in nesting.shells_of_solid], loose)
    if not dropped.volumes:
        return brep, built, dropped
    return *select_solids(brep, built, kept), dropped


def drop_loose_solids(solids: Sequence[Any], loose: str) -> tuple[tuple[Any, ...], DroppedPieces]:
    """The kernel's solids without the loose ones, and what was left out."""
    if len(solids) < 2 or loose == KEEP:
        return tuple(solids), NOTHING_DROPPED
    kept, dropped = select_pieces([estimate_volume(solid) for solid in solids], loose)
    return tuple(solids[i] for i in kept), dropped


def select_pieces(volumes: Sequence[float], loose: str) -> tuple[list[int], DroppedPieces]:
    """Indices of the pieces to keep, and the volumes of the others."""
    least = CHIP_VOLUME_FRACTION * max(volumes, default=0.0)
    kept = [i for i, volume in enumerate(volumes) if loose == KEEP or volume >= least]
    left = sorted((volume for volume in volumes if loose != KEEP and volume < least), reverse=True)
    return kept, DroppedPieces(tuple(left))
