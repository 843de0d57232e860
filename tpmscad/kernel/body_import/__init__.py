"""CAD bodies of planes and quadrics, read out of the kernel as patch complexes to trim with."""
