"""Moments of the faces of a Brep by quadrature: `integral_properties` chooses, per face, the fastest of three methods.

`loop_integrals` is the general method (Green's theorem along the loops) and the reference for the other two: `legendre_series`
for trimmed faces on a single polynomial patch, `tensor_gauss` for whole Bezier patches.
"""
