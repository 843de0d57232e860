"""What the full verification of solids and files notices, the short one notices, and both accept what is sound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from tests.shapes.kernel_shapes import drilled_dome, hollow_box, notched_hollow, voxels
from tests.shapes.mutants import BREP_FAULTS, TEXT_FAULTS
from tests.shapes.round_shapes import cone, flask, pierced_block, torus
from tpmscad.brep.welding import weld_patches
from tpmscad.errors import KernelError, TpmscadError
from tpmscad.files import checked_write
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.export import file_check
from tpmscad.kernel.export.file_check import check_excerpt
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.validity import find_faces_to_check, is_brep_valid
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.entity_table import read_entity_table
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface

SHAPES = {
    "voxels": lambda: voxels(np.ones((2, 2, 1), bool)),
    "drilled dome": drilled_dome,
    "notched hollow": notched_hollow,
    "hollow box": hollow_box,
    "pierced block": pierced_block,
    "flask": flask,
    "cone": lambda: cone(1.0, 2.0),
    "torus": lambda: torus(3.0, 1.0),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_sound_solid_passes_the_short_verification_and_the_kernel_reads_its_excerpt(
    name: str, tmp_path: Path
) -> None:
    brep = SHAPES[name]()
    built = build_solids(brep)
    assert is_brep_valid(brep, built.faces)
    assert is_brep_valid(brep)  # with the faces alone that are checked
    write_step(brep, built.nesting, tmp_path / "a.step")
    check_excerpt(tmp_path / "a.step", brep, built.nesting)


def test_of_faces_that_the_kernel_reads_slowly_the_excerpt_has_one_of_each_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    brep = voxels(np.ones((3, 3, 1), bool))
    monkeypatch.setattr(file_check, "MAX_PROJECTIONS", 0)
    kinds = {file_check._kind_of_carrier(c) for c in brep.carriers}
    assert len(file_check.choose_faces(brep, build_solids(brep).nesting)) <= len(kinds) + 1 < len(brep.faces)


def test_the_excerpt_of_a_solid_with_edges_off_its_faces_is_open_and_healed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_check, "MAX_EXCERPT_FACES", 3)
    monkeypatch.setattr(file_check, "UNEVEN_EXCERPT_FACES", 0)
    brep = voxels(np.ones((2, 2, 1), bool))
    brep = replace(brep, edges=replace(brep.edges, deviation=np.full(len(brep.edges), 2e-7)))
    nesting = build_solids(brep).nesting
    write_step(brep, nesting, tmp_path / "a.step")
    check_excerpt(tmp_path / "a.step", brep, nesting)


@pytest.mark.parametrize("fault", BREP_FAULTS, ids=lambda f: f.__name__)
def test_faults_of_solids_that_the_kernel_notices_are_noticed(fault) -> None:
    mutant = fault(voxels(np.ones((2, 1, 1), bool)), np.random.default_rng(5))
    try:
        built = build_solids(mutant)
    except TpmscadError:
        return  # both verifications begin with this
    seen = is_brep_valid(mutant, built.faces)
    assert is_valid(built.shape) or not seen
    assert is_brep_valid(mutant) == seen


@pytest.mark.parametrize("vertex", [5, 9, 42, 47])
def test_a_vertex_off_its_edges_is_noticed_whatever_the_faces_around_it(vertex: int) -> None:
    brep = notched_hollow()
    vertices = brep.vertices.copy()
    vertices[vertex] += 1e-5  # far within the tolerance that the kernel's vertex gets
    mutant = replace(brep, vertices=vertices)
    assert not is_brep_valid(mutant, build_solids(mutant).faces)


@pytest.mark.parametrize("fault", TEXT_FAULTS, ids=lambda f: f.__name__)
def test_faults_of_files_are_noticed(fault, tmp_path: Path) -> None:
    brep, path = voxels(np.ones((2, 1, 1), bool)), tmp_path / "a.step"
    nesting = build_solids(brep).nesting
    write_step(brep, nesting, path, time_stamp="")
    text = path.read_text()
    check_excerpt(path, brep, nesting)
    for seed in range(3):
        mutant = fault(text, np.random.default_rng(seed))
        if "centre point" in _difference(text, mutant):
            continue  # the stated centroid is no part of the solid
        path.write_text(mutant)
        with pytest.raises(KernelError):
            check_excerpt(path, brep, nesting)


def test_the_faces_with_the_most_uneven_poles_are_read_back() -> None:
    brep = voxels(np.ones((20, 20, 1), bool))
    nesting = build_solids(brep).nesting
    uneven = np.random.default_rng(5).permutation(len(brep.faces))[: file_check.UNEVEN_EXCERPT_FACES]
    carriers = list(brep.carriers)
    for c in brep.faces.carrier[uneven].tolist():
        poles = carriers[c].poles.copy()
        poles[2, 2] += 40.0  # the sides, and so the edges, stay
        carriers[c] = replace(carriers[c], poles=poles)
    chosen = file_check.choose_faces(replace(brep, carriers=tuple(carriers)), nesting)
    assert len(chosen) < len(brep.faces) / 2
    assert set(uneven.tolist()) <= set(chosen.tolist())


def _difference(a: str, b: str) -> str:
    """The lines of a that b has not."""
    return "".join(set(a.splitlines()) - set(b.splitlines()))


def test_the_scanner_reads_numbers_as_python_does(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate(
        [rng.normal(size=400) * 10.0 ** rng.integers(-30, 30, 400), [0.0, 0.1, 1e22, 5e-324, 2.0**53 + 2]]
    )
    texts = [repr(v).replace("e", "E") for v in values.tolist()]
    texts = [t if "." in t else t.replace("E", ".E") for t in texts]
    lines = [f"#{i}=DIRECTION('it''s (#1,2.)',({t},#3,7));\n" for i, t in enumerate(texts, 1)]
    path = tmp_path / "a.step"
    path.write_text("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n" + "".join(lines) + "ENDSEC;\nEND-ISO-10303-21;\n")
    table = read_entity_table(path)
    assert table.templates == ("DIRECTION('it''s (#1,2.)',(&,#,@))",)
    assert table.values.reshape(-1, 3)[:, 0].tolist() == values.tolist()
    assert (table.values.reshape(-1, 3)[:, 1:] == [3, 7]).all()


def test_a_file_above_the_limit_is_read_as_a_whole_on_demand_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built, read = build_solids(voxels(np.ones((2, 1, 1), bool))), []
    monkeypatch.setattr(checked_write, "make_volume_check", lambda volume, rtol, healed: lambda path: read.append(path))
    given = {"schema": "ap242", "name": "a"}
    checked_write.write_checked_brep(built, tmp_path / "a.step", **given)
    assert len(read) == 1  # a small file always
    monkeypatch.setattr(checked_write, "KERNEL_READ_LIMIT", 0)
    checked_write.write_checked_brep(built, tmp_path / "a.step", **given)
    assert len(read) == 1
    checked_write.write_checked_brep(built, tmp_path / "a.step", verify="kernel", **given)
    assert len(read) == 2


@pytest.mark.parametrize(("bumps", "checked"), [((1, 1, 1, 1, 1), 1), ((1, 2, 3, 4, 5), 5), ((1, 2, 3, 2, 5), 4)])
def test_of_faces_on_equal_carriers_one_is_checked_and_of_others_all(bumps: tuple[int, ...], checked: int) -> None:
    """Patches side by side along x that differ in a pole inside; equal ones are carriers of their own."""
    u, v = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 1, 4), indexing="ij")
    carriers, knots, count = [], np.repeat([0.0, 1.0], 4), np.arange(len(bumps))
    for bump in bumps:
        height = np.zeros((4, 4))
        height[1, 1] = 0.1 * bump
        carriers.append(BSplineSurface(np.stack([u, v, height], axis=-1), knots, knots, 3, 3))
    motion = Motion.translations(count[:, None] * np.array([1.0, 0.0, 0.0]))
    ones = np.ones(len(bumps), int)
    brep = weld_patches(carriers, count, motion, ones, 0 * count, ["a"])
    assert len(find_faces_to_check(brep)) == checked


def test_classes_are_not_sought_where_no_carriers_are_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    u, v = np.meshgrid(np.linspace(0, 1, 2), np.linspace(0, 1, 2), indexing="ij")
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    carriers = [BSplineSurface(np.stack([u + k, v, 0 * u], axis=-1), knots, knots, 1, 1) for k in range(4)]
    still, ones = Motion.translations(np.zeros((4, 3))), np.ones(4, int)
    brep = weld_patches(carriers, np.arange(4), still, ones, 0 * ones, ["a"])
    monkeypatch.setattr("tpmscad.kernel.measure.validity.group_congruent_faces", None)
    assert sorted(find_faces_to_check(brep).tolist()) == [0, 1, 2, 3]
