"""Effectiveness by transfer units: limits, order, and the equations of the streams solved on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad.simulation.effectiveness import counter_flow, cross_flow_mixed, cross_flow_unmixed, parallel_flow

ALL = (parallel_flow, cross_flow_mixed, cross_flow_unmixed, counter_flow)
NTU = st.floats(0.05, 5.0)


@given(ntu=NTU)
def test_all_arrangements_agree_where_one_stream_keeps_its_temperature(ntu: float) -> None:
    for law in ALL:
        assert law(ntu, 0.0) == pytest.approx(1 - math.exp(-ntu))
        assert law(ntu, 1e-7) == pytest.approx(1 - math.exp(-ntu), rel=1e-5)


@given(ntu=NTU, ratio=st.floats(0.01, 1.0))
def test_counter_flow_is_best_and_parallel_flow_worst(ntu: float, ratio: float) -> None:
    worst, mixed, unmixed, best = (law(ntu, ratio) for law in ALL)
    assert 0 < worst <= mixed * (1 + 1e-9)
    assert mixed <= unmixed * (1 + 1e-9)
    assert unmixed <= best * (1 + 1e-9)
    assert best < 1


def test_counter_flow_of_equal_streams_is_the_limit() -> None:
    assert counter_flow(2.0, 1.0) == pytest.approx(2 / 3)
    assert counter_flow(2.0, 1.0 - 1e-6) == pytest.approx(2 / 3, rel=1e-5)


@pytest.mark.parametrize(("ntu", "ratio"), [(0.5, 0.4), (1.0, 1.0), (2.0, 0.7), (4.0, 1.0)])
def test_the_streams_on_a_grid_have_the_effectiveness(ntu: float, ratio: float) -> None:
    """Unmixed cross flow: dT/dx = -NTU (T - t), dt/dy = NTU ratio (T - t) in a unit square, by the midpoints of n x n cells."""
    n = 200
    step = ntu / n
    cold = np.zeros(n)  # entering the row of cells, along x
    outlet = np.zeros(n)
    for j in range(n):
        hot = 1.0
        for i in range(n):
            flux = step * (hot - cold[i]) / (1 + 0.5 * step * (1 + ratio))
            hot, cold[i] = hot - flux, cold[i] + ratio * flux
        outlet[j] = hot
    assert cross_flow_unmixed(ntu, ratio) == pytest.approx(1 - outlet.mean(), rel=1e-4)


@pytest.mark.parametrize(("ntu", "ratio"), [(0.5, 0.4), (3.0, 0.7)])
def test_two_streams_along_a_line_have_the_effectiveness(ntu: float, ratio: float) -> None:
    """The matrix exponential of both temperatures, with the condition at either end."""
    values, vectors = np.linalg.eig(ntu * np.array([[-1.0, 1.0], [ratio, -ratio]]))
    over = (vectors * np.exp(values)) @ np.linalg.inv(vectors)
    assert parallel_flow(ntu, ratio) == pytest.approx(1 - (over @ [1.0, 0.0])[0])
    values, vectors = np.linalg.eig(ntu * np.array([[-1.0, 1.0], [-ratio, ratio]]))
    over = (vectors * np.exp(values)) @ np.linalg.inv(vectors)
    cold = -over[1, 0] / over[1, 1]  # at the hot inlet, of a cold stream that enters at the other end with 0
    assert counter_flow(ntu, ratio) == pytest.approx(1 - (over @ [1.0, cold])[0])
