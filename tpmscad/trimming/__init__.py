"""Intersection of lattices with bodies of planes and quadrics, as closed boundary representations, without a geometry kernel."""
