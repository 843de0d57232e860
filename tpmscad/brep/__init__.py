"""The boundary representation (Brep) that every way to a solid ends in and everything downstream starts from.

A `Brep` is a frozen value of arrays, without a kernel object: lattices and level-set meshes make one, trimming cuts one, the
kernel builds and writes one. Its data structure is described in `tpmscad.brep.boundary_representation`:

    carriers -- faces -- loops -- edge uses -- edges -- vertices
                             (half-edges)   |       |
                                       pcurves    curves

What follows from it needs no kernel either: closedness, shells and Betti numbers, volume, area and centroid, deviation from a
reference surface, continuity across edges.
"""
