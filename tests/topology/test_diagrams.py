"""Persistence diagrams against the union-find sweeps, closed forms and counts of features."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tpmscad import fields
from tpmscad.blending import blend
from tpmscad.errors import InvalidRequest
from tpmscad.topology import (
    PersistenceDiagram,
    betti,
    compute_persistence,
    count_components_and_cavities,
    persistence_diagram,
)

NOISE = [
    gaussian_filter(np.random.default_rng(seed).normal(size=(9, 8, 7)), sigma)
    for seed, sigma in ((0, 0.0), (1, 0.7), (2, 1.5))
]
GRID = np.linspace(-1.5, 1.5, 61), np.linspace(-1.4, 1.4, 57), np.linspace(-1.3, 1.3, 53)
X, Y, Z = np.meshgrid(*GRID, indexing="ij")
SPACING = 0.05


def counts(diagram: PersistenceDiagram) -> list[int]:
    return [len(diagram.pairs(dimension)) for dimension in diagram.dimensions]


@pytest.mark.parametrize("convention", ["vertices", "top_cells"])
@pytest.mark.parametrize("values", NOISE)
def test_components_and_cavities_are_those_of_the_union_find_sweep(convention: str, values: np.ndarray) -> None:
    diagram = persistence_diagram(values, dimensions=(0, 2), convention=convention)
    for dimension in (0, 2):
        expected = compute_persistence(values, dimension, convention)
        np.testing.assert_array_equal(diagram.pairs(dimension), np.stack([expected.birth, expected.death], axis=-1))


@pytest.mark.parametrize("convention", ["vertices", "top_cells"])
@pytest.mark.parametrize("values", NOISE)
@pytest.mark.parametrize("level", [-0.2, 0.0, 0.3])
def test_features_alive_at_a_level_are_its_betti_numbers(convention: str, values: np.ndarray, level: float) -> None:
    expected = betti(values, level, convention)
    alive = persistence_diagram(values, convention=convention).alive_at(level)
    assert counts(alive) == [expected.b0, expected.b1, expected.b2]


@pytest.mark.slow
def test_a_ball_shell_is_born_with_its_wall_and_its_cavity_fills_at_the_centre() -> None:
    shell = np.abs(np.sqrt(X**2 + Y**2 + Z**2) - 0.9) - 0.2
    diagram = persistence_diagram(shell, min_persistence=0.15)
    assert counts(diagram) == [1, 0, 1]
    np.testing.assert_allclose(diagram.pairs(0), [[-0.2, np.inf]], atol=1e-2)
    birth, death = diagram.pairs(2)[0]
    assert -0.2 <= birth <= -0.2 + SPACING * np.sqrt(3) / 2
    assert death == pytest.approx(0.9 - 0.2, abs=1e-12)


@pytest.mark.slow
def test_a_torus_has_one_tunnel_that_closes_on_its_axis() -> None:
    torus = np.hypot(np.hypot(X, Y) - 0.7, Z) - 0.22
    diagram = persistence_diagram(torus, min_persistence=0.1)
    assert counts(diagram) == [1, 1, 0]
    birth, death = diagram.pairs(1)[0]
    assert -0.22 <= birth <= -0.22 + SPACING
    assert death == pytest.approx(0.7 - 0.22, abs=1e-12)


@pytest.mark.parametrize("values", NOISE)
def test_the_superlevel_filtration_is_the_sublevel_filtration_of_the_negative(values: np.ndarray) -> None:
    void, negative = persistence_diagram(values, sublevel=False), persistence_diagram(-values)
    for dimension in (0, 1, 2):
        np.testing.assert_array_equal(void.pairs(dimension), -negative.pairs(dimension))
    assert counts(void.alive_at(0.1)) == counts(negative.alive_at(-0.1))


def test_fields_functions_and_samples_give_one_diagram() -> None:
    phi = fields.tpms("gyroid", period=(2.0, 3.0, 4.0))
    axes = [np.linspace(0, p, n) for p, n in zip((2.0, 3.0, 4.0), (12, 18, 24), strict=True)]
    expected = persistence_diagram(phi.on_grid(*axes))
    for found in (
        persistence_diagram(phi, resolution=24),
        persistence_diagram(phi, ((0, 0, 0), (2, 3, 4)), (12, 18, 24)),
        persistence_diagram(lambda points: phi(points), ((0, 0, 0), (2, 3, 4)), (12, 18, 24)),
    ):
        for dimension in (0, 1, 2):
            np.testing.assert_array_equal(found.pairs(dimension), expected.pairs(dimension))


def test_a_blend_removes_the_isolated_components_and_cavities_from_the_diagram() -> None:
    rods = [fields.rod(fields.tpms(name, 0.25), level) for name, level in (("schwarz_p", -0.8), ("iwp", -2.2))]
    halves = [fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))]
    band = [fields.box((0.25, 0, 0), (0.75, 0.5, 0.5))]
    before, after = (
        blend(rods, halves, band, resolution=(37, 21, 19), method=method) for method in ("initial", "topological")
    )
    assert after.converged
    n_before, n_after = (counts(persistence_diagram(r).alive_at(0.0)) for r in (before, after))
    assert (n_after[0], n_after[2]) == (1, 0)
    assert n_before[0] + n_before[2] > 1
    axes = [np.linspace(a, b, n) for a, b, n in zip(*before.domain, before.resolution, strict=True)]
    counted = count_components_and_cavities(before.field.on_grid(*axes), convention="vertices")
    assert (n_before[0], n_before[2]) == counted


@pytest.mark.slow
def test_figures_show_every_feature() -> None:
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot

    diagram = persistence_diagram(NOISE[1])
    axes = diagram.plot_diagram()
    drawn = [len(points.get_offsets()) for points in axes.collections]
    assert sum(drawn) == sum(counts(diagram))
    assert drawn[1] == 1, "one component never dies"
    figure, panel = pyplot.subplots()
    assert diagram.plot_barcode(panel) is panel
    assert [len(bars.get_segments()) for bars in panel.collections] == counts(diagram)
    assert persistence_diagram(np.ones((2, 2, 2)), dimensions=[2]).plot_diagram().get_xlabel() == "birth"
    figure.canvas.draw()
    pyplot.close("all")


def test_figures_name_the_extra_that_they_need(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InvalidRequest, match=r"tpmscad\[plot\]"):
        persistence_diagram(NOISE[0]).plot_diagram()
