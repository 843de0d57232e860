"""The public functions: each turns a surface, a field, a body or a file into a certified result.

`lattice` fills a box with a minimal surface, `infill` a CAD body; `solidify` makes a solid of any field; `fluid_domains`
makes the wall and the two channels of a heat exchanger. `measure` gives the figures that parts are designed by, and `check_print`
judges a part before printing. `export_step`, `check_step` and `render_step` write, verify and draw STEP files; `render` draws any
result. The modules are loaded at their first use, because they need the CAD kernel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad.kernel import body_field
    from tpmscad.workflows.certificate import Certificate
    from tpmscad.workflows.channel_permeability import ChannelPermeability, permeability
    from tpmscad.workflows.domain_results import FaceContact, FluidDomains
    from tpmscad.workflows.flow_estimates import estimate_flow
    from tpmscad.workflows.flow_results import FlowEstimate, FlowEstimateRow
    from tpmscad.workflows.fluid_volumes import fluid_domains
    from tpmscad.workflows.homogenization import homogenize
    from tpmscad.workflows.implicit_solid import solidify
    from tpmscad.workflows.lattice_infill import infill
    from tpmscad.workflows.lattice_instances import InstancedFile, export_instances
    from tpmscad.workflows.lattice_slabs import SlabFiles, export_slabs
    from tpmscad.workflows.lattice_solid import lattice
    from tpmscad.workflows.layer_slices import Layer, Slices
    from tpmscad.workflows.metrics import LocatedWidth, Metrics, measure
    from tpmscad.workflows.model import Model
    from tpmscad.workflows.pictures import render, render_bytes
    from tpmscad.workflows.print_check import PrintFinding, PrintReport, check_print
    from tpmscad.workflows.sheet_derivatives import DesignDerivatives, design_derivatives
    from tpmscad.workflows.solid_preview import SolidPreview, preview_solid
    from tpmscad.workflows.step_files import check_step, export_step, render_step, slice_step
    from tpmscad.workflows.surface_limits import thickest_wall
    from tpmscad.workflows.volume_meshing import mesh_step

__all__ = [
    "Certificate",
    "ChannelPermeability",
    "DesignDerivatives",
    "FaceContact",
    "FlowEstimate",
    "FlowEstimateRow",
    "FluidDomains",
    "InstancedFile",
    "Layer",
    "LocatedWidth",
    "Metrics",
    "Model",
    "PrintFinding",
    "PrintReport",
    "SlabFiles",
    "Slices",
    "SolidPreview",
    "body_field",
    "check_print",
    "check_step",
    "design_derivatives",
    "estimate_flow",
    "export_instances",
    "export_slabs",
    "export_step",
    "fluid_domains",
    "homogenize",
    "infill",
    "lattice",
    "measure",
    "mesh_step",
    "permeability",
    "preview_solid",
    "render",
    "render_bytes",
    "render_step",
    "slice_step",
    "solidify",
    "thickest_wall",
]

_MODULE_OF_NAME = {
    "DesignDerivatives": "tpmscad.workflows.sheet_derivatives",
    "design_derivatives": "tpmscad.workflows.sheet_derivatives",
    "Certificate": "tpmscad.workflows.certificate",
    "ChannelPermeability": "tpmscad.workflows.channel_permeability",
    "permeability": "tpmscad.workflows.channel_permeability",
    "FaceContact": "tpmscad.workflows.domain_results",
    "FlowEstimate": "tpmscad.workflows.flow_results",
    "FlowEstimateRow": "tpmscad.workflows.flow_results",
    "FluidDomains": "tpmscad.workflows.domain_results",
    "estimate_flow": "tpmscad.workflows.flow_estimates",
    "LocatedWidth": "tpmscad.workflows.metrics",
    "Metrics": "tpmscad.workflows.metrics",
    "Model": "tpmscad.workflows.model",
    "PrintFinding": "tpmscad.workflows.print_check",
    "PrintReport": "tpmscad.workflows.print_check",
    "InstancedFile": "tpmscad.workflows.lattice_instances",
    "SlabFiles": "tpmscad.workflows.lattice_slabs",
    "SolidPreview": "tpmscad.workflows.solid_preview",
    "body_field": "tpmscad.kernel.measure.signed_distance",
    "check_print": "tpmscad.workflows.print_check",
    "check_step": "tpmscad.workflows.step_files",
    "export_instances": "tpmscad.workflows.lattice_instances",
    "export_slabs": "tpmscad.workflows.lattice_slabs",
    "export_step": "tpmscad.workflows.step_files",
    "fluid_domains": "tpmscad.workflows.fluid_volumes",
    "infill": "tpmscad.workflows.lattice_infill",
    "lattice": "tpmscad.workflows.lattice_solid",
    "measure": "tpmscad.workflows.metrics",
    "homogenize": "tpmscad.workflows.homogenization",
    "mesh_step": "tpmscad.workflows.volume_meshing",
    "preview_solid": "tpmscad.workflows.solid_preview",
    "render": "tpmscad.workflows.pictures",
    "render_bytes": "tpmscad.workflows.pictures",
    "render_step": "tpmscad.workflows.step_files",
    "slice_step": "tpmscad.workflows.step_files",
    "Layer": "tpmscad.workflows.layer_slices",
    "Slices": "tpmscad.workflows.layer_slices",
    "solidify": "tpmscad.workflows.implicit_solid",
    "thickest_wall": "tpmscad.workflows.surface_limits",
}

__getattr__, __dir__ = lazy_attributes(__name__, _MODULE_OF_NAME)
