"""Lattices cut by bodies without the kernel: trimmed faces and caps as a new, closed complex."""

from tpmscad.trimming.box import Report, Trimmed, trim, trim_box
from tpmscad.trimming.tool import Tool, TrimmingError, box, polyhedron

__all__ = ["Report", "Tool", "Trimmed", "TrimmingError", "box", "polyhedron", "trim", "trim_box"]
