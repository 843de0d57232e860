"""Conversion of boundary representations to OCCT shapes and STEP files: the only room that imports OCP."""

from tpmscad.errors import NotQuadric
from tpmscad.kernel.body_import.body_brep import brep_and_source_faces, brep_from_shape
from tpmscad.kernel.build.solids import BuiltSolids, build_solids
from tpmscad.kernel.measure.shape_report import ShapeReport, StepReport, check_shape, check_step, is_valid
from tpmscad.kernel.render.picture import render_png
from tpmscad.kernel.step.brep_writer import Instances, write_step
from tpmscad.kernel.step.product_entities import TAG_COLOURS
from tpmscad.kernel.step.shape_writer import write_shape
from tpmscad.kernel.step.step_reader import StepContent, read_step

__all__ = [
    "TAG_COLOURS",
    "BuiltSolids",
    "Instances",
    "NotQuadric",
    "ShapeReport",
    "StepContent",
    "StepReport",
    "brep_and_source_faces",
    "brep_from_shape",
    "build_solids",
    "check_shape",
    "check_step",
    "is_valid",
    "read_step",
    "render_png",
    "write_shape",
    "write_step",
]
