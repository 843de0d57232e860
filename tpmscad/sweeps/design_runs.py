"""The work on one row of a sweep, as a task that an executor runs: make the design, measure it, write its file.

A task gets plain values and returns the figures of the design as plain values. It raises nothing: what goes wrong is a figure,
too.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad.api.public_calls import translate_error
from tpmscad.errors import InvalidRequest, NotMet, TpmscadError
from tpmscad.recipe.blend_recipe import BlendRecipe
from tpmscad.recipe.recipe_runs import BlendRun, SolidRun, read_recipe, run_blend_recipe
from tpmscad.results.domain_results import MINUS, PLUS, FluidDomains
from tpmscad.results.model import Model
from tpmscad.solids._fluid_domains import fluid_domains
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice
from tpmscad.solids._struts import struts
from tpmscad.solids.coarse_domains import sample_domains
from tpmscad.studies._estimate_exchanger import estimate_sides, read_stream
from tpmscad.studies._homogenize import homogenize
from tpmscad.studies._measure import measure
from tpmscad.studies.channel_geometry import ChannelGeometry, describe_channel, find_length, measure_channel

FIGURES: Mapping[str, type] = {
    "met": bool,
    "volume": float,
    "area": float,
    "porosity": float,
    "faces": int,
    "max_deviation": float,
    "rms_deviation": float,
    "pieces": int,
    "tunnels": int,
    "cavities": int,
    "smallest_wall": float,
    "smallest_pore": float,
    "hydraulic_diameter": float,
    "volume_plus": float,
    "volume_minus": float,
    "wetted_area_plus": float,
    "wetted_area_minus": float,
    "hydraulic_diameter_plus": float,
    "hydraulic_diameter_minus": float,
    "opening_area_plus": float,
    "opening_area_minus": float,
    "pressure_drop_plus": float,
    "pressure_drop_minus": float,
    "effectiveness": float,
    "heat": float,
    "compactness": float,
    "mass": float,
    "flow": str,
    "coarse": bool,
    "E1": float,
    "E2": float,
    "E3": float,
    "nu12": float,
    "nu13": float,
    "nu23": float,
    "G12": float,
    "G13": float,
    "G23": float,
    "bulk_modulus": float,
    "conductivity": float,
    "property_error": float,
    "file": str,
    "error": str,
    "message": str,
    "seconds": float,
}
"""The columns of results after those of the parameters, and their types; one that was not measured is empty. A parameter of
such a name has a column of another one (`results_table.name_column`)."""

METRICS = ("smallest_wall", "smallest_pore", "hydraulic_diameter")
"""The figures that are measured on demand only, as they take longer than most lattices."""

FLOW = ("flow",)
SOLID = ("faces",)
"""What only rows of exchangers with two fluids, and only those whose solids were made, have."""

PROPERTIES = tuple(FIGURES)[tuple(FIGURES).index("E1") : tuple(FIGURES).index("property_error") + 1]
"""The homogenised properties and their relative error, which are computed on demand only. Moduli are relative to Young's modulus
of the solid, the conductivity to that of the solid."""

SUFFIXES = {"plus": PLUS, "minus": MINUS}
"""Of the columns of a channel."""

POISSON_RATIO = 0.3
"""Of the solid in homogenised properties."""


def run_design(
    function: str,
    parameters: Mapping[str, Any],
    file: Path | None,
    metrics: bool,
    properties: bool,
    flow: Mapping[str, Any] | None = None,
    solids: bool = True,
) -> dict[str, Any]:
    """The figures of a design, or the type and the message of the error that it ended in."""
    begun = time.perf_counter()
    figures: dict[str, Any] = {"met": False}
    try:
        if not solids:
            figures |= _sample_domains(parameters, flow) | {"coarse": True, "met": True}
            return figures | {"seconds": round(time.perf_counter() - begun, 3)}
        model = MAKERS[function](parameters)
        figures |= _measure_domains(model, flow) if isinstance(model, FluidDomains) else _measure(model, metrics)
        certificate = model.certificate
        if not certificate.met:
            raise NotMet("; ".join(certificate.shortfalls), certificate)
        if file is not None:
            model.export(file)
            figures["file"] = str(file)
        if properties and isinstance(model, Model):
            figures |= _homogenize(model)
        figures["met"] = True
    except Exception as error:  # whatever it is, it is the result of this row, and the others go on
        figures |= describe_failure(error if isinstance(error, TpmscadError) else translate_error("the design", error))
    return figures | {"seconds": round(time.perf_counter() - begun, 3)}


def describe_failure(error: Exception) -> dict[str, Any]:
    """The figures of a design that ended in an error."""
    return {"met": False, "error": type(error).__name__, "message": " ".join(str(error).split())}


def _measure(model: Model, metrics: bool) -> dict[str, Any]:
    """What the certificate says of a model, its porosity, and its metrics on demand."""
    certificate = model.certificate
    pieces, tunnels, cavities = certificate.betti
    figures = {
        "volume": certificate.volume,
        "area": certificate.area,
        "porosity": None if model.envelope is None else 1.0 - certificate.volume / model.envelope.volume,
        "faces": certificate.n_faces,
        "max_deviation": certificate.max_deviation,
        "rms_deviation": certificate.rms_deviation,
        "pieces": pieces,
        "tunnels": tunnels,
        "cavities": cavities,
    }
    if metrics:
        found = measure(model)
        widths = (found.smallest_wall, found.smallest_pore)
        figures |= dict(
            zip(METRICS, [*(None if w is None else w.width for w in widths), found.hydraulic_diameter], strict=True)
        )
    return figures


def _measure_domains(parts: FluidDomains, flow: Mapping[str, Any] | None) -> dict[str, Any]:
    """What the certificate says of the wall of an exchanger, and the figures of its channels."""
    figures = _measure(parts.wall, False) | {"porosity": 1.0 - parts.wall.volume / parts.volume, "coarse": False}
    diameters = parts.hydraulic_diameters
    for suffix, name in SUFFIXES.items():
        channel, diameter = parts.domains[name], diameters.get(name)
        figures[f"volume_{suffix}"] = channel.volume
        figures[f"hydraulic_diameter_{suffix}"] = diameter
        figures[f"wetted_area_{suffix}"] = None if diameter is None else 4.0 * channel.volume / diameter
        figures[f"opening_area_{suffix}"] = sum(contact.areas.get(name, 0.0) for contact in parts.touches)
    if flow is not None:
        sides = tuple(measure_channel(parts, side) for side in "+-")
        figures |= _estimate(sides, parts.volume, parts.offset, parts.wall.volume, flow)
    return figures


def _sample_domains(parameters: Mapping[str, Any], flow: Mapping[str, Any] | None) -> dict[str, Any]:
    """The figures of an exchanger by samples, without its solids; hydraulic diameters are those of the endless sheet."""
    parts = sample_domains(**_without_kind(parameters), progress=False)
    wall = parts.volume - sum(parts.volumes.values())
    figures: dict[str, Any] = {"volume": wall, "porosity": 1.0 - wall / parts.volume}
    sides = []
    for suffix, name in SUFFIXES.items():
        openings, volume = parts.openings[name], parts.volumes[name]
        figures |= {f"volume_{suffix}": volume, f"opening_area_{suffix}": sum(area for area, _ in openings)}
        if parts.offset is not None and len(set(parts.cell)) == 1:
            length = find_length(name, [centre for _, centre in openings]) if flow is not None else 1.0
            side = describe_channel(parts.surface, parts.cell[0], parts.offset, name[-1], length)
            side = replace(side, cross_section=volume / (side.porosity * length))
            figures[f"hydraulic_diameter_{suffix}"] = side.hydraulic_diameter
            figures[f"wetted_area_{suffix}"] = 4.0 * volume / side.hydraulic_diameter
            sides.append(side)
    if flow is not None:
        if not sides:
            raise InvalidRequest("flow is estimated of even walls in cubic cells: leave it out, or thickness a number")
        figures |= _estimate(tuple(sides), parts.volume, parts.offset, wall, flow)
    return figures


def _estimate(
    sides: tuple[ChannelGeometry, ...],
    volume: float,
    offset: tuple[float, float] | None,
    wall: float,
    flow: Mapping[str, Any],
) -> dict[str, Any]:
    """Effectiveness, heat and pressure drops, the least that sources say, and the mass, g, of a wall of a volume, mm3."""
    found = estimate_sides(
        sides,
        (read_stream("plus", flow.get("plus")), read_stream("minus", flow.get("minus"))),
        flow.get("arrangement", "counter"),
        volume,
        None if offset is None else offset[1] - offset[0],
        flow.get("wall_conductivity"),
    )
    drops = found.pressure_drops
    density = flow.get("wall_density")
    return {
        "pressure_drop_plus": drops["+"] and drops["+"][0],
        "pressure_drop_minus": drops["-"] and drops["-"][0],
        "effectiveness": found.effectiveness[0],
        "heat": found.heat and found.heat[0],
        "compactness": found.compactness,
        "mass": None if density is None else 1e-6 * density * wall,
        "flow": describe_flow(flow),
    }


def describe_flow(flow: Mapping[str, Any]) -> str:
    """The text that tells one flow from another."""
    return json.dumps(flow, sort_keys=True, default=str)


def _homogenize(model: Model) -> dict[str, float]:
    """The homogenised properties of a model that repeats, with a solid of Young's modulus and conductivity 1."""
    found = homogenize(model, poisson_ratio=POISSON_RATIO, progress=False)
    figures = {
        **found.engineering_constants,
        "bulk_modulus": found.bulk_modulus,
        "conductivity": float(np.trace(found.conductivity)) / 3.0,
        "property_error": found.error,
    }
    return {name: figures[name] for name in PROPERTIES}


def _make_lattice(parameters: Mapping[str, Any]) -> Model:
    return lattice(**parameters, progress=False)


def _make_infill(parameters: Mapping[str, Any]) -> Model:
    return infill(**parameters, progress=False)


def _make_domains(parameters: Mapping[str, Any]) -> FluidDomains:
    return fluid_domains(**_without_kind(parameters), progress=False)


def _without_kind(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in parameters.items() if name != "kind"}


def _make_struts(parameters: Mapping[str, Any]) -> Model:
    return struts(**parameters, progress=False)


def _make_from_recipe(parameters: Mapping[str, Any]) -> Model:
    changes = {name: value for name, value in parameters.items() if name != "recipe"}
    recipe = read_recipe(Path(parameters["recipe"]), changes)
    run: BlendRun | SolidRun
    if isinstance(recipe, BlendRecipe):
        run = BlendRun(run_blend_recipe(recipe, progress=_be_silent), recipe.tol)
    else:
        run = SolidRun(recipe.field, recipe.domain, recipe.tol, recipe.passive, recipe)
    return run.make(_be_silent)[0]


def _be_silent(stage: str, done: float) -> None:
    """A progress that shows nothing."""


MAKERS: dict[str, Callable[[Mapping[str, Any]], Model | FluidDomains]] = {
    "lattice": _make_lattice,
    "fluid_domains": _make_domains,
    "infill": _make_infill,
    "struts": _make_struts,
    "blend": _make_from_recipe,
    "solidify": _make_from_recipe,
}
"""By function: what makes the model of a row."""
