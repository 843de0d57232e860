"""The earlier blending methods by name, as the blending paper compares them; none looks at topology."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from tpmscad.blend.composition import BlendedField, Weighting
from tpmscad.blend.coordinates import Along
from tpmscad.blend.grid import Field
from tpmscad.blend.initial import Spec, initial_weight, sides
from tpmscad.blend.scene import Scene
from tpmscad.blend.weights_cells import cell_weight
from tpmscad.blend.weights_gaussian import gaussian_weight
from tpmscad.blend.weights_line import LineWeight
from tpmscad.blend.weights_profile import ProfileWeight
from tpmscad.errors import InvalidRequest

EARLIER = ("sigmoid", "beta-growth", "discrete-reconstruction", "gaussian-rbf")


def earlier_weight(method: str, spec: Spec, field: BlendedField, scenes: Sequence[Scene], stage: int) -> Weighting:
    """The weight of one stage by an earlier method. Sigmoid and beta growth need a layer of a coordinate, else InvalidRequest."""
    first, second, mixing = sides(field, stage)
    box = scenes[0].grid.low, scenes[0].grid.high
    if method == "gaussian-rbf":
        return gaussian_weight(first, second, mixing, box)
    if method == "discrete-reconstruction":
        return cell_weight(first, box, _cell(field, scenes, stage))
    line = initial_weight(spec, field, scenes, stage)
    if not isinstance(line, LineWeight):
        raise InvalidRequest(
            f"method {method!r} needs a blending region that is a layer: blending region {stage} is none"
        )
    profile: Literal["sigmoid", "beta-growth"] = "sigmoid" if method == "sigmoid" else "beta-growth"
    rising = bool(line.coefficients[-1] == 1.0)
    return ProfileWeight(line.coordinate, line.start, line.end, rising, profile)


def _cell(field: BlendedField, scenes: Sequence[Scene], stage: int) -> float:
    """The greatest period of the two structures that meet, or half the layer's thickness where they have none."""
    periods = [_period(structure) for structure in (field.structures[stage], field.structures[stage + 1])]
    if all(periods):
        return max(periods)
    line = initial_weight("auto", field, scenes, stage)
    if isinstance(line, LineWeight) and isinstance(line.coordinate, Along):
        return (line.end - line.start) / 2
    raise InvalidRequest("discrete reconstruction needs structures with periods, for the edge of its cells")


def _period(structure: Field) -> float:
    periods = getattr(structure, "periods", None)
    found = periods() if callable(periods) else None
    return max(found) if found is not None else 0.0
