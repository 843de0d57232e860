"""Batched marching finds the same arcs as marching patch by patch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.shapes import round_shapes as shapes
from tests.trimming.network_operands import trim
from tpmscad.brep.boundary_representation import Brep
from tpmscad.trimming.intersect import marching, marching_batched, patch_surface
from tpmscad.trimming.operands.polyhedra import box

BODIES = {
    "box": lambda: box(np.array([1.3, 2.1, 1.7]), np.array([8.2, 9.1, 7.9])),
    "ball": lambda: shapes.sphere(3.9, translation=(5.1, 4.8, 5.3)),
}


@pytest.mark.slow
@pytest.mark.parametrize("body", BODIES)
def test_patches_marched_together_get_the_arcs_that_each_gets_alone(
    body: str, cover: Callable[..., Brep], monkeypatch: pytest.MonkeyPatch
) -> None:
    lattice = cover("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (-0.05, 0.05))
    seen = []

    def both(patches, implicit, borders, on_corner, zero_tol):
        together = marching_batched.march_patches(patches, implicit, borders, on_corner, zero_tol)
        for i, trace in enumerate(together):
            alone = marching.march_patch(patches[i], implicit.row(i), borders[i], on_corner[i], zero_tol)
            seen.append((trace, alone))
        return together

    monkeypatch.setattr(patch_surface, "march_patches", both)
    trim(lattice, BODIES[body]())
    n_arcs, n_compared = sum(len(alone.arcs) for _, alone in seen), 0
    assert n_arcs > 30
    for trace, alone in seen:
        assert trace.sign == alone.sign
        assert [(a.start, a.end) for a in trace.arcs] == [(a.start, a.end) for a in alone.arcs]
        for a, b in zip(trace.arcs, alone.arcs, strict=True):
            np.testing.assert_allclose(a.path[[0, -1]], b.path[[0, -1]], rtol=0, atol=1e-14)
            if len(a.path) == len(b.path):  # else one of the grids has an additional line
                np.testing.assert_allclose(a.path, b.path, rtol=0, atol=1e-12)
                n_compared += 1
    assert n_compared > 0.5 * n_arcs


def test_most_patches_are_simple(cover: Callable[..., Brep], monkeypatch: pytest.MonkeyPatch) -> None:
    alone, everything = [], []
    march, march_all = marching_batched.march_patch, marching_batched.march_patches
    monkeypatch.setattr(marching_batched, "march_patch", lambda *a: alone.append(1) or march(*a))
    monkeypatch.setattr(patch_surface, "march_patches", lambda *a: everything.extend(a[0]) or march_all(*a))
    trim(cover("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (-0.05, 0.05)), BODIES["ball"]())
    assert len(everything) > 30
    assert len(alone) < 0.3 * len(everything)
