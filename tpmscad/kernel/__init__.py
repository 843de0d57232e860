"""Conversion of boundary representations to OCCT shapes and STEP files: the only room that imports OCP.

Other rooms import its names from here. A name is loaded when it is first used, so that a lattice does not wait for the import of
the Boolean operations or of the renderer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad.errors import NotQuadric
    from tpmscad.kernel.body_import.body_brep import brep_and_source_faces, brep_from_shape
    from tpmscad.kernel.boolean.body_split import SplitSolid, split_body
    from tpmscad.kernel.boolean.boolean_operations import (
        KernelSolids,
        betti_numbers,
        estimate_volume,
        intersect_solids,
        subtract_solid,
    )
    from tpmscad.kernel.boolean.hollow_body import resolve_open_faces, subtract_voids
    from tpmscad.kernel.boolean.inward_offset import offset_inward
    from tpmscad.kernel.boolean.local_intersection import intersect_locally
    from tpmscad.kernel.build.solids import BuiltSolids, build_regions, build_solids
    from tpmscad.kernel.measure.cad_body import CadBody, read_body
    from tpmscad.kernel.measure.mass_properties import face_moments
    from tpmscad.kernel.measure.shape_report import ShapeReport, StepReport, check_shape, check_step, is_valid
    from tpmscad.kernel.measure.shape_sampling import (
        Creases,
        FaceSamples,
        find_creases,
        have_touching_solids,
        lie_on_surface,
        sample_faces,
        sample_solid,
    )
    from tpmscad.kernel.measure.signed_distance import body_field
    from tpmscad.kernel.occt.bounding_boxes import bounding_box, enclosing_box
    from tpmscad.kernel.occt.construction import make_compound
    from tpmscad.kernel.occt.convert import transform_shape
    from tpmscad.kernel.occt.exploration import faces_of
    from tpmscad.kernel.render.picture import render_png
    from tpmscad.kernel.step.brep_writer import Instances, write_step
    from tpmscad.kernel.step.product_entities import TAG_COLOURS
    from tpmscad.kernel.step.shape_writer import write_shape
    from tpmscad.kernel.step.step_reader import StepContent, read_step

__all__ = [
    "TAG_COLOURS",
    "BuiltSolids",
    "CadBody",
    "Creases",
    "FaceSamples",
    "Instances",
    "KernelSolids",
    "NotQuadric",
    "ShapeReport",
    "SplitSolid",
    "StepContent",
    "StepReport",
    "betti_numbers",
    "body_field",
    "bounding_box",
    "brep_and_source_faces",
    "brep_from_shape",
    "build_regions",
    "build_solids",
    "check_shape",
    "check_step",
    "enclosing_box",
    "estimate_volume",
    "face_moments",
    "faces_of",
    "find_creases",
    "have_touching_solids",
    "intersect_locally",
    "intersect_solids",
    "is_valid",
    "lie_on_surface",
    "make_compound",
    "offset_inward",
    "read_body",
    "read_step",
    "render_png",
    "resolve_open_faces",
    "sample_faces",
    "sample_solid",
    "split_body",
    "subtract_solid",
    "subtract_voids",
    "transform_shape",
    "write_shape",
    "write_step",
]

_MODULE_OF_NAME = {
    "TAG_COLOURS": "tpmscad.kernel.step.product_entities",
    "BuiltSolids": "tpmscad.kernel.build.solids",
    "CadBody": "tpmscad.kernel.measure.cad_body",
    "Creases": "tpmscad.kernel.measure.shape_sampling",
    "FaceSamples": "tpmscad.kernel.measure.shape_sampling",
    "Instances": "tpmscad.kernel.step.brep_writer",
    "KernelSolids": "tpmscad.kernel.boolean.boolean_operations",
    "NotQuadric": "tpmscad.errors",
    "ShapeReport": "tpmscad.kernel.measure.shape_report",
    "SplitSolid": "tpmscad.kernel.boolean.body_split",
    "StepContent": "tpmscad.kernel.step.step_reader",
    "StepReport": "tpmscad.kernel.measure.shape_report",
    "betti_numbers": "tpmscad.kernel.boolean.boolean_operations",
    "body_field": "tpmscad.kernel.measure.signed_distance",
    "bounding_box": "tpmscad.kernel.occt.bounding_boxes",
    "brep_and_source_faces": "tpmscad.kernel.body_import.body_brep",
    "brep_from_shape": "tpmscad.kernel.body_import.body_brep",
    "build_regions": "tpmscad.kernel.build.solids",
    "build_solids": "tpmscad.kernel.build.solids",
    "check_shape": "tpmscad.kernel.measure.shape_report",
    "check_step": "tpmscad.kernel.measure.shape_report",
    "enclosing_box": "tpmscad.kernel.occt.bounding_boxes",
    "estimate_volume": "tpmscad.kernel.boolean.boolean_operations",
    "face_moments": "tpmscad.kernel.measure.mass_properties",
    "faces_of": "tpmscad.kernel.occt.exploration",
    "find_creases": "tpmscad.kernel.measure.shape_sampling",
    "have_touching_solids": "tpmscad.kernel.measure.shape_sampling",
    "intersect_locally": "tpmscad.kernel.boolean.local_intersection",
    "intersect_solids": "tpmscad.kernel.boolean.boolean_operations",
    "is_valid": "tpmscad.kernel.measure.shape_report",
    "lie_on_surface": "tpmscad.kernel.measure.shape_sampling",
    "make_compound": "tpmscad.kernel.occt.construction",
    "offset_inward": "tpmscad.kernel.boolean.inward_offset",
    "read_body": "tpmscad.kernel.measure.cad_body",
    "read_step": "tpmscad.kernel.step.step_reader",
    "render_png": "tpmscad.kernel.render.picture",
    "resolve_open_faces": "tpmscad.kernel.boolean.hollow_body",
    "sample_faces": "tpmscad.kernel.measure.shape_sampling",
    "sample_solid": "tpmscad.kernel.measure.shape_sampling",
    "split_body": "tpmscad.kernel.boolean.body_split",
    "subtract_solid": "tpmscad.kernel.boolean.boolean_operations",
    "subtract_voids": "tpmscad.kernel.boolean.hollow_body",
    "transform_shape": "tpmscad.kernel.occt.convert",
    "write_shape": "tpmscad.kernel.step.shape_writer",
    "write_step": "tpmscad.kernel.step.brep_writer",
}

__getattr__, __dir__ = lazy_attributes(__name__, _MODULE_OF_NAME)
