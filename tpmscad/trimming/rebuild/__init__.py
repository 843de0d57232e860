"""Faces of the lattice and of the body rebuilt from trimmed loops."""
