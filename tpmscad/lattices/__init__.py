"""Exact surfaces as boundary representations: a fitted primitive, its copies by symmetry, mirrored pieces and coordinate maps."""
