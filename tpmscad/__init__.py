"""Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids.

The public names are imported when they are first asked for: those that make solids bring the kernel, which takes seconds.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tpmscad import blend, fields, surfaces
    from tpmscad.errors import InvalidRequest, KernelError, NotMet, TpmscadError
    from tpmscad.metrics import Metrics, measure
    from tpmscad.model import Model
    from tpmscad.parts import body_field, fluid_domains, infill
    from tpmscad.patches import maps
    from tpmscad.patches.certificate import Certificate
    from tpmscad.solids import solidify
    from tpmscad.workflows import check_step, export_step, lattice, render_step

__all__ = [
    "Certificate",
    "InvalidRequest",
    "KernelError",
    "Metrics",
    "Model",
    "NotMet",
    "TpmscadError",
    "blend",
    "body_field",
    "check_step",
    "export_step",
    "fields",
    "fluid_domains",
    "infill",
    "lattice",
    "maps",
    "measure",
    "render_step",
    "solidify",
    "surfaces",
]

_HOMES = {
    "Certificate": "tpmscad.patches.certificate",
    "InvalidRequest": "tpmscad.errors",
    "KernelError": "tpmscad.errors",
    "Metrics": "tpmscad.metrics",
    "Model": "tpmscad.model",
    "NotMet": "tpmscad.errors",
    "TpmscadError": "tpmscad.errors",
    "body_field": "tpmscad.parts",
    "check_step": "tpmscad.workflows",
    "export_step": "tpmscad.workflows",
    "measure": "tpmscad.metrics",
    "fluid_domains": "tpmscad.parts",
    "infill": "tpmscad.parts",
    "lattice": "tpmscad.workflows",
    "render_step": "tpmscad.workflows",
    "solidify": "tpmscad.solids",
}
_ROOMS = {
    "blend": "tpmscad.blend",
    "fields": "tpmscad.fields",
    "maps": "tpmscad.patches.maps",
    "surfaces": "tpmscad.surfaces",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
    elif name in _ROOMS:
        value = import_module(_ROOMS[name])
    else:
        raise AttributeError(f"module 'tpmscad' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
