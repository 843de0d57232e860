"""Assemblies of copies: what their levels say, and that a copy out of its place in the text of a file is noticed."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from tests.shapes.kernel_shapes import TURN, voxels
from tpmscad.errors import KernelError
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.export.file_check import check_excerpt
from tpmscad.kernel.measure.shape_report import check_step
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.product_entities import MAX_SIDE_BY_SIDE, arrange_cells, compose_levels
from tpmscad.kernel.step.text_check import check_text
from tpmscad.rigid_motion import Motion


@pytest.mark.parametrize("counts", [(1, 1, 1), (4, 4, 4), (5, 4, 4), (65, 1, 1), (2, 1, 40), (9, 8, 7)])
def test_levels_place_every_cell_once(counts: tuple[int, int, int]) -> None:
    edges = (2.0, 3.0, 5.0)
    levels = arrange_cells(edges, counts)
    corners = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3) * edges
    placed = compose_levels(levels)
    assert {tuple(p) for p in placed.translation.tolist()} == {tuple(p) for p in corners.tolist()}
    assert len(placed) == len(corners)
    assert (placed.rotation == np.eye(3)).all()
    nested = np.prod(counts) > MAX_SIDE_BY_SIDE
    assert len(levels) == (sum(n > 1 for n in counts) if nested else 1)


def test_turned_assemblies_turn_what_they_hold() -> None:
    inner = Motion(np.stack([np.eye(3), TURN]), np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]))
    outer = Motion(np.stack([TURN, np.eye(3)]), np.array([[0.0, 0.0, 3.0], [4.0, 0.0, 0.0]]))
    points = np.random.default_rng(1).normal(size=(5, 3))
    whole = compose_levels([inner, outer])
    expected = [
        (points @ r.T + t) @ q.T + s
        for q, s in zip(outer.rotation, outer.translation, strict=True)
        for r, t in zip(inner.rotation, inner.translation, strict=True)
    ]
    found = [points @ r.T + t for r, t in zip(whole.rotation, whole.translation, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-14)


LEVELS = (
    Motion(np.stack([np.eye(3), TURN]), np.array([[0.0, 0.0, 0.0], [7.0, -2.0, 1.0]])),
    Motion.translations(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0], [0.0, 0.0, 21.0]])),
)


def swap_first(pattern: str, replacement: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        changed, n = re.subn(pattern, replacement, text, count=1)
        assert n == 1
        return changed

    return change


def _drop_a_usage(text: str) -> str:
    last = re.findall(r"#\d+=CONTEXT_DEPENDENT_SHAPE_REPRESENTATION\([^;]*;\n", text)[-1]
    return text.replace(last, "")


def _exchange_frames(text: str) -> str:
    (a, b), (c, d), *_ = re.findall(r"ITEM_DEFINED_TRANSFORMATION\('','',#(\d+),#(\d+)\)", text)
    return (
        text.replace(f"'',#{a},#{b})", "'',HERE)")
        .replace(f"'',#{c},#{d})", f"'',#{c},#{b})")
        .replace("HERE", f"#{a},#{d}")
    )


def _exchange_parts(text: str) -> str:
    first, second = re.findall(r"(#\d+,#\d+),\$\)", text)[0], re.findall(r"(#\d+,#\d+),\$\)", text)[-1]
    return text.replace(f"{first},$)", f"{second},$)", 1)


FAULTS = {
    "a copy moved": swap_first(r"\(7\.0?,-2\.0?,1\.0?\)", "(7.,-2.,1.000001)"),
    "a layer moved": swap_first(r"\(0\.0?,0\.0?,21\.0?\)", "(0.,0.,22.)"),
    "two copies in one place": swap_first(r"\(7\.0?,-2\.0?,1\.0?\)", "(0.,0.,0.)"),
    "a usage missing": _drop_a_usage,
    "frames exchanged": _exchange_frames,
    "another part": _exchange_parts,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_copy_out_of_its_place_is_noticed(fault: str, tmp_path: Path) -> None:
    brep = voxels(np.ones((1, 1, 1), bool))
    nesting = build_solids(brep).nesting
    path = tmp_path / "a.step"
    write_step(brep, nesting, path, instances=LEVELS)
    check_text(path, brep, nesting, LEVELS)
    assert check_step(path).shape.solids == 6
    path.write_text(FAULTS[fault](path.read_text()))
    with pytest.raises(KernelError, match="not what was meant"):
        check_text(path, brep, nesting, LEVELS)


def test_another_number_of_copies_than_was_meant_is_noticed(tmp_path: Path) -> None:
    brep = voxels(np.ones((1, 1, 1), bool))
    nesting = build_solids(brep).nesting
    write_step(brep, nesting, tmp_path / "a.step", instances=LEVELS)
    check_excerpt(tmp_path / "a.step", brep, nesting, LEVELS)
    for meant in (LEVELS[:1], (*LEVELS, LEVELS[1])):
        with pytest.raises(KernelError, match="6 placements in place of"):
            check_excerpt(tmp_path / "a.step", brep, nesting, meant)
