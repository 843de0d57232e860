"""Weight functions: what they depend on, their splines, and linear constraints on their coefficients."""
