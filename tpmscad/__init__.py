"""Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids.

The public names are imported when they are first asked for: those that make solids bring the kernel, which takes seconds.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tpmscad import fields, surfaces, topology
    from tpmscad.blending import blend
    from tpmscad.errors import InvalidRequest, KernelError, NotMet, TpmscadError
    from tpmscad.lattices import maps
    from tpmscad.workflows import body_field, fluid_domains, infill
    from tpmscad.workflows.certificate import Certificate
    from tpmscad.workflows.implicit_solid import solidify
    from tpmscad.workflows.lattice_solid import check_step, export_step, lattice, render_step
    from tpmscad.workflows.metrics import Metrics, measure
    from tpmscad.workflows.model import Model

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
    "topology",
]

_MODULE_OF_NAME = {
    "Certificate": "tpmscad.workflows.certificate",
    "InvalidRequest": "tpmscad.errors",
    "KernelError": "tpmscad.errors",
    "Metrics": "tpmscad.workflows.metrics",
    "Model": "tpmscad.workflows.model",
    "NotMet": "tpmscad.errors",
    "TpmscadError": "tpmscad.errors",
    "blend": "tpmscad.blending",
    "body_field": "tpmscad.workflows",
    "check_step": "tpmscad.workflows.lattice_solid",
    "export_step": "tpmscad.workflows.lattice_solid",
    "measure": "tpmscad.workflows.metrics",
    "fluid_domains": "tpmscad.workflows",
    "infill": "tpmscad.workflows",
    "lattice": "tpmscad.workflows.lattice_solid",
    "render_step": "tpmscad.workflows.lattice_solid",
    "solidify": "tpmscad.workflows.implicit_solid",
}
_PUBLIC_MODULES = {
    "fields": "tpmscad.fields",
    "maps": "tpmscad.lattices.maps",
    "surfaces": "tpmscad.surfaces",
    "topology": "tpmscad.topology",
}


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF_NAME:
        value = getattr(import_module(_MODULE_OF_NAME[name]), name)
    elif name in _PUBLIC_MODULES:
        value = import_module(_PUBLIC_MODULES[name])
    else:
        raise AttributeError(f"module 'tpmscad' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
