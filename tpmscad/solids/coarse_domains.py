"""What the wall and the channels of a body will measure, about, by samples: no solid is made, and it takes a second or two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpmscad.api.public_calls import validate_options
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.measure.mass_properties import measure_face
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.requests.channel_openings import ChannelOpenings
from tpmscad.requests.lattice_options import FluidDomainsOptions
from tpmscad.results.domain_results import MINUS, PLUS
from tpmscad.solids._fluid_domains import prepare_domains
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.channel_reach import MAX_SAMPLES, WallHeight, sample_body
from tpmscad.solids.ended_channels import ChannelEnds
from tpmscad.stage_timer import StageTimer

SAMPLES_PER_CELL = 16.0
"""Samples along the shortest edge of a cell: volumes of channels in boxes of a few cells are then within 1 %."""

MIN_OPENING = 0.01
"""Of a face: the least part that counts as an opening where a channel opens wherever it meets the body."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseDomains:
    """Figures of a wall and its channels, model units, of which those by domain are from samples.

    `openings`: for each channel the areas on the body's faces and the centres of these.
    """

    surface: str
    cell: tuple[float, float, float]
    offset: tuple[float, float] | None
    volume: float
    volumes: Mapping[str, float]
    openings: Mapping[str, tuple[tuple[float, tuple[float, float, float]], ...]]


@validate_options(FluidDomainsOptions, 'sample_domains(body, "gyroid", cell=10, thickness=1)')
def sample_domains(options: FluidDomainsOptions) -> CoarseDomains:
    """The figures of fluid domains by samples of body and wall.

    Raises InvalidRequest as `fluid_domains` does before its work, if channels do not connect their openings too, and for bodies
    that are no CAD bodies.
    """
    asked = prepare_domains(options, StageTimer(options.progress))
    body, request = asked.body, asked.request
    if not isinstance(body, KernelBody):
        raise InvalidRequest(f"figures by samples are of CAD bodies, which {body.name} is not: make its solids")
    if asked.length:
        raise InvalidRequest(
            "figures by samples are of channels that end abruptly: give transition 0, or make the solids"
        )
    own = faces_of(body.cad.shape)
    every = frozenset(range(len(own)))
    ends = asked.ends or ChannelEnds(ChannelOpenings(every, every), 0.0)
    low, high = body.cad.box
    spacing = max(min(request.cell) / SAMPLES_PER_CELL, float(np.prod(high - low) / MAX_SAMPLES) ** (1 / 3))
    samples = sample_body(body, ends, spacing)
    volumes, openings = {}, {}
    is_node = samples.face < 0
    for height, (name, opened) in zip(
        WallHeight.of(request, asked.rotation)(samples.points), ends.openings_of.items(), strict=True
    ):
        # the part of a sample's surroundings that is free
        free = np.prod([np.clip(d / spacing + 0.5, 0, 1) for d in (height, samples.depth[name] - ends.skin)], axis=0)
        volumes[name] = body.volume * float(free[is_node].mean())
        measured = []
        for number in sorted(opened):
            fraction = float(free[samples.face == number].mean()) if (samples.face == number).any() else 0.0
            if fraction > MIN_OPENING:
                area, centre = measure_face(own[number])
                measured.append((fraction * area, centre))
        openings[name] = tuple(measured)
        if not volumes[name]:
            raise InvalidRequest(
                f"{body.name} holds no {name}: use a smaller cell or skin, or shift the lattice by phase"
            )
    return CoarseDomains(
        request.surface,
        request.cell,
        request.even_offset,
        body.volume,
        {n: volumes[n] for n in (PLUS, MINUS)},
        openings,
    )
