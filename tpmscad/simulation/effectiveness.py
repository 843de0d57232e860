"""Effectiveness of a heat exchanger by its number of transfer units (Kays and London, Compact Heat Exchangers, 3rd ed. 1984).

NTU = conductance / smaller capacity rate, C = smaller / greater capacity rate, and the effectiveness is the heat over that of an
endless counter flow. In cross flow it lies between that of two fluids mixed across their streams and that of two unmixed ones.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ive

ARRANGEMENTS = ("counter", "cross", "parallel")

MIN_RATIO = 1e-9
"""Ratio of capacity rates below which one stream keeps its temperature."""

N_TERMS = 100
"""Of the series of Bessel functions; at 20 transfer units, the 100th is below 1e-16 of the sum."""


def counter_flow(ntu: float, ratio: float) -> float:
    """Effectiveness in counter flow."""
    if abs(1.0 - ratio) < MIN_RATIO:
        return ntu / (1.0 + ntu)
    left = math.exp(-ntu * (1.0 - ratio))
    return (1.0 - left) / (1.0 - ratio * left)


def parallel_flow(ntu: float, ratio: float) -> float:
    """Effectiveness in parallel flow."""
    return -math.expm1(-ntu * (1.0 + ratio)) / (1.0 + ratio)


def cross_flow_mixed(ntu: float, ratio: float) -> float:
    """Effectiveness in cross flow, both fluids mixed across their streams."""
    one = 1.0 / -math.expm1(-ntu)
    other = ratio / -math.expm1(-ratio * ntu) if ratio > 0 else 1.0 / ntu
    return 1.0 / (one + other - 1.0 / ntu)


def cross_flow_unmixed(ntu: float, ratio: float) -> float:
    """Effectiveness in cross flow, neither fluid mixed, by Bessel functions (Baclic, ASME J. Heat Transfer 100 (1978) 746)."""
    if ratio < MIN_RATIO:
        return -math.expm1(-ntu)
    argument, order = 2.0 * ntu * math.sqrt(ratio), np.arange(N_TERMS)
    terms = ratio ** (order / 2) * ive(order, argument)
    total = terms[0] + terms[1] - (1.0 - ratio) / ratio * terms[2:].sum()
    return float(1.0 - math.exp(argument - ntu * (1.0 + ratio)) * total)


LEAST = {"counter": counter_flow, "parallel": parallel_flow, "cross": cross_flow_mixed}
GREATEST = {"counter": counter_flow, "parallel": parallel_flow, "cross": cross_flow_unmixed}
"""By arrangement: the bounds of the effectiveness."""
