"""The blended field: structures composed by weights, sampled, and the defects of the samples."""
