"""Intersection of lattice edges, patches and body edges with the body's surfaces, and the arrangement that results."""
