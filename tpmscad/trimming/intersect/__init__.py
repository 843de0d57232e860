"""Intersections of patches, curves and surfaces."""
