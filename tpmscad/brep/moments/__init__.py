"""Moments of the faces of a Brep by quadrature: `integral_properties` chooses, per face, the faster of two methods.

`loop_integrals` is the general method (Green's theorem along the loops) and the reference for the other one, `tensor_gauss` for
whole Bezier patches.
"""
