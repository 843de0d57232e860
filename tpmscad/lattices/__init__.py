"""Lattices of exact surfaces as boundary representations.

A lattice has a *source* (`sources`): copies of a fitted primitive patch by proper motions (`primitive`, `copies`, `cell_block`),
or reflections of a fitted piece between mirrors (`harmonic_chart`, `mirror_continuity`, `mirror_fit`). Under a coordinate map
(`maps`) every patch is fitted anew (`mapped_lattice`, `g2_fit`).
"""
