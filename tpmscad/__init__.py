"""Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids.

Lengths are in model units (mm in files), angles in degrees. A point array has shape (..., 3), xyz last. A field is solid where it
is negative. Each public name is imported at its first use, because those that make solids load the CAD kernel, which takes
seconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad import fields, maps, surfaces, topology
    from tpmscad.blending import blend
    from tpmscad.errors import (
        InvalidRequest,
        KernelError,
        LevelSetError,
        NotMet,
        RecipeError,
        TpmscadError,
        TrimmingError,
    )
    from tpmscad.sweeps import sweep
    from tpmscad.workflows import (
        Certificate,
        Metrics,
        Model,
        PrintReport,
        body_field,
        check_print,
        check_step,
        design_derivatives,
        estimate_flow,
        export_instances,
        export_slabs,
        export_step,
        fluid_domains,
        homogenize,
        infill,
        lattice,
        measure,
        permeability,
        render,
        render_step,
        solidify,
    )

__all__ = [
    "Certificate",
    "InvalidRequest",
    "KernelError",
    "LevelSetError",
    "Metrics",
    "Model",
    "NotMet",
    "PrintReport",
    "RecipeError",
    "TpmscadError",
    "TrimmingError",
    "__version__",
    "blend",
    "body_field",
    "check_print",
    "check_step",
    "design_derivatives",
    "estimate_flow",
    "export_instances",
    "export_slabs",
    "export_step",
    "fields",
    "fluid_domains",
    "homogenize",
    "infill",
    "lattice",
    "maps",
    "measure",
    "permeability",
    "render",
    "render_step",
    "solidify",
    "surfaces",
    "sweep",
    "topology",
]

__version__ = "0.1.0"

_MODULE_OF_NAME = {
    "Certificate": "tpmscad.workflows",
    "InvalidRequest": "tpmscad.errors",
    "KernelError": "tpmscad.errors",
    "LevelSetError": "tpmscad.errors",
    "Metrics": "tpmscad.workflows",
    "Model": "tpmscad.workflows",
    "NotMet": "tpmscad.errors",
    "PrintReport": "tpmscad.workflows",
    "RecipeError": "tpmscad.errors",
    "TpmscadError": "tpmscad.errors",
    "TrimmingError": "tpmscad.errors",
    "blend": "tpmscad.blending",
    "body_field": "tpmscad.workflows",
    "check_print": "tpmscad.workflows",
    "check_step": "tpmscad.workflows",
    "design_derivatives": "tpmscad.workflows",
    "estimate_flow": "tpmscad.workflows",
    "export_instances": "tpmscad.workflows",
    "export_slabs": "tpmscad.workflows",
    "export_step": "tpmscad.workflows",
    "fields": "tpmscad.fields",
    "fluid_domains": "tpmscad.workflows",
    "homogenize": "tpmscad.workflows",
    "infill": "tpmscad.workflows",
    "lattice": "tpmscad.workflows",
    "maps": "tpmscad.maps",
    "measure": "tpmscad.workflows",
    "permeability": "tpmscad.workflows",
    "render": "tpmscad.workflows",
    "render_step": "tpmscad.workflows",
    "solidify": "tpmscad.workflows",
    "surfaces": "tpmscad.surfaces",
    "sweep": "tpmscad.sweeps",
    "topology": "tpmscad.topology",
}

__getattr__, __dir__ = lazy_attributes(__name__, _MODULE_OF_NAME)
