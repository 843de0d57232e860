"""Boolean operations of OCCT on lattices and CAD bodies, and the offset and hollowing of bodies."""
