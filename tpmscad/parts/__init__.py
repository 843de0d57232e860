"""What engineers do with a part: fill it with a lattice, keep a skin, get the fluid volumes too."""

from tpmscad.kernel.distance import body_field
from tpmscad.parts.domains import FluidDomains, Touch, fluid_domains
from tpmscad.parts.filling import infill
from tpmscad.parts.part import Part

__all__ = ["FluidDomains", "Part", "Touch", "body_field", "fluid_domains", "infill"]
