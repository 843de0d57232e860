"""What engineers do with a part: fill it with a lattice, keep a skin, get the fluid volumes too."""

from tpmscad.kernel.measure.signed_distance import body_field
from tpmscad.workflows.fluid_volumes import FaceContact, FluidDomains, fluid_domains
from tpmscad.workflows.lattice_infill import InfillModel, infill

__all__ = ["FaceContact", "FluidDomains", "InfillModel", "body_field", "fluid_domains", "infill"]
