"""Curves on nearly singular patches, and curves whose curvature varies fast."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Chebyshev, Polynomial
from scipy.interpolate import BPoly, PPoly

from tpmscad.brep.carriers import Plane
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.arc_fitting import CoarsePath, fit_arcs
from tpmscad.trimming.operands.quadric_table import build_implicit_surfaces

KNOTS = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
TOL = 5e-8


def squared(beyond: float) -> BSplineSurface:
    """The square [0, 1]^2 with x = 1 - ((1 + d - u) / (1 + d))^2 along u, singular at u = 1 + d, and y = v."""
    end = beyond / (1 + beyond)
    x = 1 - np.array([1.0, end, end**2])  # the blossom of the square
    poles = np.stack(np.broadcast_arrays(x[:, None], np.array([0.0, 0.5, 1.0]), 0.0), axis=-1)
    return BSplineSurface(np.ascontiguousarray(poles), KNOTS, KNOTS, 2, 2)


@pytest.mark.parametrize("beyond", [0.3, 0.03, 0.003])
def test_a_straight_cut_across_a_nearly_singular_patch_is_fitted(beyond: float) -> None:
    """The cut y = 0.2 + 0.6 x is straight in space; on the patch it bends ever more sharply towards u = 1."""
    patch = squared(beyond)
    normal = np.array([0.6, -1.0, 0.0]) / np.hypot(0.6, 1.0)  # its negative side lies on the left of the path
    plane = build_implicit_surfaces([Plane(np.array([0.0, 0.2, 0.0]), np.array([0.0, 0.0, 1.0]), normal)])
    u = np.linspace(0.0, 1.0, 33)
    x = patch.grid(u, np.array([0.5]))[:, 0, 0]
    path = CoarsePath(np.stack([u, 0.2 + 0.6 * x], axis=1), np.zeros((0, 3)))
    (arc,) = fit_arcs([patch], plane, [path], TOL)
    t = np.linspace(0.0, 1.0, 2001)
    on_patch = np.stack([patch.grid(np.array([a]), np.array([b]))[0, 0] for a, b in arc.pcurve(t)])
    np.testing.assert_allclose(on_patch, arc.curve(t), rtol=0, atol=TOL)
    np.testing.assert_allclose(on_patch[:, 1], 0.2 + 0.6 * on_patch[:, 0], rtol=0, atol=2 * TOL)


def test_a_cut_along_which_the_curvature_swings_is_fitted() -> None:
    """z = 0.03 T(2 x - 1), T the seventh Chebyshev polynomial: a parameter that follows turning leaves 2e-6 at 181 spans."""
    wave = Chebyshev.basis(7, domain=[0, 1]).convert(kind=Polynomial, domain=[-1, 1], window=[-1, 1])
    heights = 0.03 * BPoly.from_power_basis(PPoly(wave.coef[::-1, None], [0.0, 1.0])).c
    x = np.linspace(0.0, 1.0, 8)
    poles = np.stack(np.broadcast_arrays(x[:, None], np.array([0.0, 1.0]), heights), axis=-1)
    patch = BSplineSurface(np.ascontiguousarray(poles), np.repeat([0.0, 1.0], 8), np.array([0.0, 0.0, 1.0, 1.0]), 7, 1)
    normal = np.array([0.6, -1.0, 0.0]) / np.hypot(0.6, 1.0)
    plane = build_implicit_surfaces([Plane(np.array([0.0, 0.2, 0.0]), np.array([0.0, 0.0, 1.0]), normal)])
    u = np.linspace(0.0, 1.0, 65)
    (arc,) = fit_arcs([patch], plane, [CoarsePath(np.stack([u, 0.2 + 0.6 * u], axis=1), np.zeros((0, 3)))], TOL)
    points = arc.curve(np.linspace(0.0, 1.0, 5001))
    np.testing.assert_allclose(points[:, 1], 0.2 + 0.6 * points[:, 0], rtol=0, atol=TOL)
    np.testing.assert_allclose(points[:, 2], 0.03 * np.cos(7 * np.arccos(2 * points[:, 0] - 1)), rtol=0, atol=TOL)
