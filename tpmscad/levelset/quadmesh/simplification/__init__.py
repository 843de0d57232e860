"""Simplification of a quadrilateral mesh by collapses, ranked, applied greedily, and undone where a fit misses."""
