"""Least-squares fit of a patch network to a level set, and the measurement of the result.

- `least_squares`: batched normal equations with direction-dependent weights (tangent-distance minimisation) and hard rows.
- `joint_normals`: normals along curves, by which patches on both sides have the same tangent planes.
- `network_curves`: Bezier curves on the level set between given points.
- `network_fit`: all curves of a network, then all patches, joined with tangent continuity through the field's gradient.
- `fit_quality`: distances, normals and continuity of a fit, and the distances from the level set back to it.
- `box_curves`: the curves in the faces of the box, which bound its caps: whether they leave the box or cross.
"""
