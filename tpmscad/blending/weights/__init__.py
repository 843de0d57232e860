"""Weight functions of a blend: scalar coordinates, B-spline weights, and linear constraints on their coefficients."""
