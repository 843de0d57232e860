"""Seams of cylinders, cones and tori, kept out of the faces on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from OCP.gp import gp_Ax1

SEAM_TOL = 1e-6
"""Radians by which a face may reach beyond the seam of its surface without crossing it."""


def turn_seam_aside(value: Any, low: float, high: float) -> Any:
    """A cylinder, cone or torus, turned about its axis where its seam crosses a face from u = `low` to `high`: to its back.

    Without pcurves the kernel's STEP reader places each loop of a face by itself. Of a face across the seam it may put a hole and
    the outer loop into different turns, and its check then finds the hole outside. A face all round keeps its seam.
    """
    turn = 2.0 * np.pi
    seam = turn * (np.floor((low + SEAM_TOL) / turn) + 1.0)
    if high <= seam + SEAM_TOL or high - low >= turn - SEAM_TOL:
        return value
    position = value.Position()
    angle = float(0.5 * (low + high) - np.pi)
    axis = gp_Ax1(position.Location(), position.Direction())
    return value.Rotated(axis, angle if position.Direct() else -angle)
