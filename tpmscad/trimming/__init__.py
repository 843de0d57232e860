"""Intersection of lattices with bodies of planes and quadrics, as closed boundary representations, without a geometry kernel."""

from tpmscad.errors import TrimmingError
from tpmscad.trimming.operands.polyhedra import box, polyhedron
from tpmscad.trimming.rebuild.trimmed_brep import LatticeDomain, TrimmedDomains
from tpmscad.trimming.trim_pipeline import TrimReport, TrimResult, trim, trim_domains

__all__ = [
    "LatticeDomain",
    "TrimReport",
    "TrimResult",
    "TrimmedDomains",
    "TrimmingError",
    "box",
    "polyhedron",
    "trim",
    "trim_domains",
]
