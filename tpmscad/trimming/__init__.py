"""Lattices cut by bodies without the kernel: trimmed faces and the body's own as a new, closed complex."""

from tpmscad.trimming.tool import TrimmingError, box, polyhedron
from tpmscad.trimming.trimmed import Report, Trimmed, trim, trim_box

__all__ = ["Report", "Trimmed", "TrimmingError", "box", "polyhedron", "trim", "trim_box"]
