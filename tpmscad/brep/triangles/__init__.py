"""Triangles of whole patches, of one cell of an endless lattice, and of many such cells cut by a body."""
