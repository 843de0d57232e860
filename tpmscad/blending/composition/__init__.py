"""The blended field: structures composed by weights, its samples on a grid, and the topological defects of the samples."""
