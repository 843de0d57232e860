"""In/out classification of intersection curves, lattice edges and points."""
