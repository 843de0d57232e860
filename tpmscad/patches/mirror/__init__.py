"""Lattices of surfaces with mirror planes, of one piece between the mirrors and its reflections."""
