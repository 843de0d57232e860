"""Laws of translated copies: they are translates of their originals, and a solid with copies is as good as one without."""

from __future__ import annotations

from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import astuple
from functools import cache
from typing import Any

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.brep.connectivity import is_closed
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.fields.periods_and_directions import count_whole
from tpmscad.levelset import level_set_fit
from tpmscad.levelset.field_solid import FieldSolid, fit_field_solid
from tpmscad.levelset.fit import fit_quality, network_fit
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import build_dual_mesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork, build_patch_network
from tpmscad.levelset.quadmesh.periodicity import (
    find_translated_copies,
    no_copies,
    snap_translated_vertices,
)
from tpmscad.levelset.quadmesh.smoothing import smooth_mesh
from tpmscad.parallel import task_runner
from tpmscad.splines.bspline import BSplineSurface

LO, TOL = np.zeros(3), 1e-2
GYROID = fields.rod(fields.tpms("gyroid", 10.0), -0.3)


def decimal_boxes(count: int) -> list[tuple[float, int, float, float]]:
    """Periods of one to three digits, whole numbers of them, and the ends of boxes, as products or as decimals."""
    rng = np.random.default_rng(5)
    boxes = [(7.9, 6, 0.0, 47.4), (8.147, 6, -8.147, 40.735)]  # both differ from the product
    for _ in range(count - 2):
        period, n = round(float(rng.uniform(1, 12)), int(rng.integers(1, 4))), int(rng.integers(1, 10))
        first, digits = int(rng.integers(-3, 4)), 3 if rng.random() < 0.5 else 20
        boxes.append((period, n, round(period * first, digits), round(period * (first + n), digits)))
    return boxes


def test_boxes_of_whole_periods_are_known_whatever_their_last_digits() -> None:
    for period, n, low, high in decimal_boxes(200):
        lo, hi = np.array([low, 0.0, 0.0]), np.array([high, 0.4 * period, period * (1 + 1e-9)])
        assert count_whole(lo, hi, np.array([period, period, period])).tolist() == [n, 0, 0]


@pytest.mark.parametrize(("period", "n", "low", "high"), decimal_boxes(4))
def test_solids_in_boxes_of_whole_periods_do_not_depend_on_last_digits(
    period: float, n: int, low: float, high: float
) -> None:
    field = fields.rod(fields.tpms("gyroid", period), 0.1)
    volumes = []
    for first, last in ((low, high), (0.0, n * period)):
        lo, hi = np.array([first, 0.0, 0.0]), np.array([last, 0.5 * period, 0.5 * period])
        found = fit_field_solid(field, lo, hi, 0.03 * period).brep
        assert is_closed(found)
        volumes.append(measure_solid(found).volume)
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-8)


def nothing_fitted(network: PatchNetwork) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(len(network.ends), bool), np.zeros(len(network.curve), bool)


@cache
def net(counts: tuple[int, int, int], size: tuple[float, float, float], refined: bool) -> tuple[PatchNetwork, Octree]:
    hi = np.array(size)
    tree = octree.uniform_octree(LO, hi, np.array(counts))
    if refined:  # one leaf at the lower corner
        tree = octree.split_leaves(tree, np.arange(len(tree.size)) == 0)
    field = extend_linearly(GYROID, LO, hi)
    return build_patch_network(
        snap_translated_vertices(smooth_mesh(build_dual_mesh(tree, field), field, LO, hi, sweeps=20), field, tree),
        field,
    ), tree


@pytest.mark.parametrize("refined", [False, True])
def test_copies_are_translates_by_whole_periods_with_all_that_bounds_them(refined: bool) -> None:
    network, tree = net((16, 8, 4), (40.0, 20.0, 10.0), refined)
    network, copies = find_translated_copies(network, GYROID, tree, *nothing_fitted(network))
    assert 0.2 * len(network.curve) < np.count_nonzero(~copies.original_patches)
    for shift in (copies.curve_shift, copies.patch_shift):
        assert np.array_equal(shift, 10.0 * np.rint(shift / 10.0))
        assert (shift[:, 2] == 0).all()  # the box is a single period high
    main = np.arange(network.n_sides)
    ends = network.vertices[network.ends[main]]
    moved = network.vertices[network.ends[copies.curve[main]]] + copies.curve_shift[main, None]
    assert np.abs(ends - moved).max() < 1e-13 * 40
    assert np.array_equal(network.plane, network.plane[copies.curve])
    sides, firsts = network.curve, network.curve[copies.patch]
    assert np.array_equal(copies.curve[sides], copies.curve[firsts])
    between = copies.curve_shift[sides] - copies.curve_shift[firsts]
    assert np.array_equal(between, np.repeat(copies.patch_shift[:, None], 4, axis=1))
    assert np.array_equal(network.sense, network.sense[copies.patch])


def test_there_are_no_copies_where_no_whole_number_of_leaves_fits_a_period() -> None:
    network, tree = net((15, 8, 4), (38.0, 20.0, 10.0), False)
    _, copies = find_translated_copies(network, GYROID, tree, *nothing_fitted(network))
    assert (copies.patch_shift[:, 0] == 0).all()
    single, tree = net((4, 4, 4), (10.0, 10.0, 10.0), False)
    assert find_translated_copies(single, GYROID, tree, *nothing_fitted(single))[1].original_patches.all()


@cache
def solid(copied: bool) -> FieldSolid:
    with pytest.MonkeyPatch.context() as patch:
        if not copied:
            patch.setattr(
                level_set_fit, "find_translated_copies", lambda n, *_: (n, no_copies(len(n.ends), len(n.curve)))
            )
        return fit_field_solid(GYROID, LO, np.array([40.0, 10.0, 10.0]), TOL)


@pytest.mark.slow
def test_a_solid_of_copies_is_the_one_whose_patches_are_all_fitted() -> None:
    one, other = solid(True), solid(False)
    assert len(one.brep.carriers) < 0.8 * len(other.brep.carriers)
    assert len(one.brep.faces) == len(other.brep.faces)
    assert is_closed(one.brep)
    assert measure_edge_continuity(one.brep, ("surface",)).gap < 1e-12
    assert np.abs(one.brep.vertices - other.brep.vertices).max() < 1e-12
    for i in range(0, len(one.brep.faces), 37):
        a, b = (c.brep.carriers[c.brep.faces.carrier[i]] for c in (one, other))
        if isinstance(a, BSplineSurface):
            assert isinstance(b, BSplineSurface)
            assert (
                np.abs(a.poles + one.brep.faces.motion.translation[i] - b.poles).max() < 1e-6
            )  # fits amplify round-off, far below tol
    assert measure_solid(one.brep).volume == pytest.approx(measure_solid(other.brep).volume, rel=1e-9)
    for name in ("deviation", "continuity"):
        assert astuple(getattr(one, name)) == pytest.approx(astuple(getattr(other, name)), rel=1e-4), name
    assert one.jump_p95_deg == pytest.approx(other.jump_p95_deg, rel=1e-4)


@pytest.mark.slow
def test_copies_are_neither_fitted_nor_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted, measured = [], []
    fit, sample = network_fit.fit_patches, fit_quality.sample_patches
    monkeypatch.setattr(network_fit, "fit_patches", lambda f, b, j: fitted.append(len(b[0])) or fit(f, b, j))
    monkeypatch.setattr(fit_quality, "sample_patches", lambda f, p: measured.append(len(p)) or sample(f, p))
    made = fit_field_solid(GYROID, LO, np.array([50.0, 10.0, 10.0]), TOL).brep
    own = sum(isinstance(c, BSplineSurface) for c in made.carriers)
    assert sum(fitted) == sum(measured) == own < 0.7 * len(made.faces)


class Late(Executor):
    """Runs nothing until it is asked for, and then the last first."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Any, Any]] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        ask = future.result

        def result(timeout: float | None = None) -> Any:
            while self.waiting:
                f, call, given = self.waiting.pop()
                f.set_result(call(*given))
            return ask(timeout)

        future.result = result  # type: ignore[method-assign]
        self.waiting.append((future, fn, args))
        return future


@pytest.mark.slow
@pytest.mark.parametrize(
    "executor",
    [Late, lambda: ThreadPoolExecutor(3), lambda: ProcessPoolExecutor(2)],
    ids=["one of the caller's own", "threads", "processes"],
)
def test_any_executor_makes_the_same_solid_face_by_face(executor: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (network_fit, fit_quality):
        monkeypatch.setattr(module, "ITEMS_PER_TASK", 64)
    box = LO, np.array([20.0, 10.0, 10.0])
    serial = fit_field_solid(GYROID, *box, TOL).brep
    with executor() as pool, task_runner(pool, GYROID) as run_tasks:
        pooled = fit_field_solid(GYROID, *box, TOL, run_tasks=run_tasks).brep
    assert np.array_equal(pooled.vertices, serial.vertices)
    assert np.array_equal(pooled.faces.carrier, serial.faces.carrier)
    assert np.array_equal(pooled.faces.motion.translation, serial.faces.motion.translation)
    assert [type(c) for c in pooled.carriers] == [type(c) for c in serial.carriers]
    pairs = [(a, b) for a, b in zip(pooled.carriers, serial.carriers, strict=True) if isinstance(a, BSplineSurface)]
    assert len(pairs) > 100
    assert all(np.array_equal(a.poles, b.poles) for a, b in pairs)
