"""Lattices cut by bodies without the kernel: trimmed faces and the body's own as a new, closed complex."""

from tpmscad.errors import TrimmingError
from tpmscad.trimming.operands.polyhedra import box, polyhedron
from tpmscad.trimming.trim_pipeline import TrimReport, TrimResult, trim, trim_box

__all__ = ["TrimReport", "TrimResult", "TrimmingError", "box", "polyhedron", "trim", "trim_box"]
