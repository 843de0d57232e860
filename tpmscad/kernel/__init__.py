"""Arrays in, OCC shapes and STEP files out: the only room that imports OCP."""

from tpmscad.kernel.build import Built, build
from tpmscad.kernel.check import ShapeReport, StepReport, check_shape, check_step, is_valid
from tpmscad.kernel.read import StepContent, read_step
from tpmscad.kernel.render import render
from tpmscad.kernel.step.colour import TAG_COLOURS
from tpmscad.kernel.step.file import Instances, write_step
from tpmscad.kernel.step.shape import write_shape
from tpmscad.kernel.tool.complex import NotQuadric, body_complex, body_faces

__all__ = [
    "TAG_COLOURS",
    "Built",
    "Instances",
    "NotQuadric",
    "ShapeReport",
    "StepContent",
    "StepReport",
    "body_complex",
    "body_faces",
    "build",
    "check_shape",
    "check_step",
    "is_valid",
    "read_step",
    "render",
    "write_shape",
    "write_step",
]
