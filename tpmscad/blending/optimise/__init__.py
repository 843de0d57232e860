"""The optimisation of the weights: topological defects, level margin, subgrid defects and narrow necks."""
