"""Classification of intersection curves by faces of the body, and of lattice edges and points as inside or outside."""
