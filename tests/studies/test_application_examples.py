"""The applications among the examples run at a small size; they make a picture and a STEP file, and what they claim holds."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from tpmscad import fields, topology
from tpmscad.kernel.measure.shape_report import check_step

pytestmark = [pytest.mark.kernel, pytest.mark.documentation]

FOLDER = Path(__file__).parents[2] / "examples"


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Import an example by its name, in an empty folder."""
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.chdir(tmp_path)
    return importlib.import_module


def require_files(*stems: str) -> None:
    """Valid solids in STEP, and pictures that show something."""
    for stem in stems:
        assert check_step(f"{stem}.step").ok
        assert Path(f"{stem}.png").stat().st_size > 10_000


def test_a_bracket_is_one_solid(load: Any) -> None:
    pytest.importorskip("build123d")
    found = load("build123d_bracket").main(length=20.0, cell=10.0, tol=0.2)
    assert found["met"]
    assert found["valid"]
    assert found["pieces"] == 1
    require_files("bracket")


def test_a_body_with_holes_and_fillets_is_filled_and_cut_open(load: Any) -> None:
    pytest.importorskip("build123d")
    found = load("trimmed").main(length=22.0, cell=16.0, tol=0.2)["schwarz_p"]
    assert found["met"]
    assert found["betti"][0] == 1
    assert found["deviation"] <= 0.2
    require_files("trimmed_schwarz_p")


def test_the_fluids_of_an_exchanger_run_from_port_to_port_and_fill_it_with_the_wall(load: Any) -> None:
    bd = pytest.importorskip("build123d")
    found = load("counter_flow_exchanger").main(cells=(2, 2, 2), tol=0.1)
    assert found["met"]
    assert found["valid"]
    assert found["betti"][2] == 2, "the channels are closed off before the holes are made"
    names = ("wall", "fluid_plus", "fluid_minus")
    assert found["pieces"] == found["shells"] == dict.fromkeys(names, 1)
    assert sum(found["volumes"].values()) == pytest.approx(found["hull"], rel=1e-6)
    assert found["gap between the fluids"] == pytest.approx(0.8, abs=0.25)
    ends = {}
    for name in names:
        assert check_step(f"counter_flow_exchanger_{name}.step").ok
        box = bd.import_step(f"counter_flow_exchanger_{name}.step").bounding_box()
        ends[name] = [*np.round([*box.min, *box.max], 3)]
    assert ends["wall"] == [-10, 0, -10, 26, 16, 26]
    assert [ends["fluid_plus"][k] for k in (2, 5)] == [-10, 26]
    assert [ends["fluid_minus"][k] for k in (0, 3)] == [-10, 26]
    assert Path("counter_flow_exchanger.png").stat().st_size > 10_000


def test_an_implant_is_dense_where_the_image_is(load: Any) -> None:
    pytest.importorskip("build123d")
    implant = load("implant")
    rods = implant.graded_rods(implant.bone_image(6.0, 12.0), 6.0, 4.0)
    x = np.random.default_rng(1).uniform((-6, -6, 0), (6, 6, 12), (40_000, 3))
    radius, solid = np.hypot(x[:, 0], x[:, 1]), rods(x) < 0
    assert solid[radius < 3].mean() < 0.5 < 0.6 < solid[(radius > 5) & (radius < 6)].mean()


def test_a_scaffold_of_four_quadrants_is_denser_at_its_rim(load: Any) -> None:
    pytest.importorskip("build123d")
    bone = load("bone")
    period = radius = 4.0
    blended = bone.blend_quadrants(period, radius, period)
    assert blended.converged
    x = np.random.default_rng(1).uniform((-4, -4, 0), (4, 4, 4), (60_000, 3))
    distance, solid = np.hypot(x[:, 0], x[:, 1]), blended.field(x) < 0
    assert solid[distance < 2].mean() < solid[(distance > 3) & (distance < 4)].mean() - 0.08
    for k, rods in enumerate(bone.graded_rods(period, radius)):
        quadrant = (1 if k % 2 else -1, 1 if k // 2 else -1)
        own = (x[:, :2] * quadrant > period / 2).all(axis=1)
        assert np.array_equal(blended.field(x[own]), rods(x[own]))


def test_the_wall_of_a_nozzle_is_as_thick_as_asked_for_at_every_height(load: Any) -> None:
    bd = pytest.importorskip("build123d")
    cells = (8, 1, 3)
    found = load("nozzle").main(cells=cells, tol=0.2)
    assert found["met"]
    assert found["deviation"] <= 0.2
    assert found["betti"][0] == 1
    assert found["betti"][2] == 0
    assert found["tunnels in the file"] == found["betti"][1]
    assert (found["betti"][1] - 1) % cells[0] == 0, "the ring repeats itself cell by cell around the axis"
    assert max(found["thickness off by at most"].values()) < 0.02
    assert found["thickness"]["throat"] == pytest.approx(0.7, abs=0.02)
    assert found["thickness"]["throat"] > 1.3 * found["thickness"]["inlet"] > 1.5 * found["thickness"]["exit"]
    (solid,) = bd.import_step("nozzle.step").solids()
    assert solid.is_valid
    assert solid.volume == pytest.approx(found["volume"], rel=1e-5), "the kernel's own quadrature is that exact"
    require_files("nozzle")


def test_a_tooth_has_the_topology_of_the_structure_in_its_block(load: Any) -> None:
    pytest.importorskip("build123d")
    example, cells = load("tooth"), np.array([3, 3, 3])
    found = example.main()  # this is small enough; coarser tolerances are not met
    assert found["met"], found["shortfalls"]
    assert found["deviation"] <= found["tolerance"]
    # the rods are a lattice graph: a node in each cell, an edge through each face between two cells
    edges = sum(int(np.prod(cells - np.eye(3, dtype=int)[axis])) for axis in range(3))
    assert found["betti"] == found["betti in the block"] == (1, edges - int(cells.prod()) + 1, 0)
    assert found["least Jacobian, proved"] > 0
    assert found["isolated parts of the blend"] == found["pieces left out"] == 0
    map, field = example.tooth(tuple(cells.tolist())), example.blend_regions(tuple(cells.tolist())).field
    x = np.random.default_rng(1).uniform((0, 0, 0), cells, (100_000, 3))
    volume = cells.prod() * (np.linalg.det(map.jacobian(x, 1.0)) * (field(x) < 0)).mean()
    assert found["volume"] == pytest.approx(volume, rel=0.03)
    require_files("tooth")


def test_a_solid_beam_of_voxels_bends_as_a_timoshenko_beam(load: Any) -> None:
    pytest.importorskip("pyamg")
    length, height = 40.0, 10.0
    found = load("voxel_beam").resolve_compliance(fields.constant(-1.0), ((0.0, 0.0, 0.0), (length, height, 5.0)), 24)
    timoshenko = length**3 / (3 * height**3 / 12) + 1.2 * length * 2.6 / height
    assert found["compliance"] == pytest.approx(timoshenko, rel=0.08)
    assert found["volume fraction"] == 1.0
    assert found["loose parts"] == 0


def test_a_blended_beam_is_one_solid_with_the_topology_of_its_voxels(
    load: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyamg")
    pytest.importorskip("matplotlib").use("Agg")
    beam = load("beam")
    density = np.linspace(0.6, 0.4, 4)[:, None] * np.ones(4)
    share = np.repeat([[0.0], [1.0]], 2, axis=0) * np.ones(4)
    design = beam.Design(density, share, 5.0, 100.0, ())
    monkeypatch.setattr(beam, "optimise", lambda *_: design)  # which needs longer beams; it has tests of its own
    found = beam.main(cells=(2, 2), size=5.0, voxels=8, tol=0.3)
    assert found["met"]
    assert found["deviation"] <= found["tolerance"] == 0.3
    assert found["isolated parts of the blend"] == 0
    require_files("beam")
    assert Path("beam_design.png").stat().st_size > 10_000
    size = (20.0, 20.0, 10.0)
    _, blended = beam.structures(design, ((0.0, 0.0, 0.0), size))
    solid = blended.field.on_grid(*(np.arange(0.0625, length, 0.125) for length in size))
    assert topology.betti(solid) == topology.Betti(*found["betti"])
    assert found["betti"][0] == 1
    assert found["volume fraction"] == pytest.approx((solid < 0).mean(), abs=0.003)
    assert found["resolved"]["blend"]["volume fraction"] == pytest.approx(found["volume fraction"], abs=0.005)


def test_an_optimised_beam_blends_to_one_piece_of_the_wanted_volume(load: Any) -> None:
    pytest.importorskip("pyamg")
    beam, box = load("beam"), ((0.0, 0.0, 0.0), (60.0, 30.0, 10.0))
    design = beam.optimise(beam.Plate(60.0, 30.0, 5.0), beam.fit_stiffness(beam.read_units()), 10.0, 8)
    _, blended = beam.structures(design, box)
    assert blended.errors.remaining == 0
    solid = blended.field.on_grid(*(np.arange(0.25, size, 0.5) for size in box[1])) < 0
    assert ndimage.label(solid)[1] == 1
    assert solid.mean() == pytest.approx(0.5, abs=0.04)


def test_a_solid_block_of_voxels_has_the_confined_modulus(load: Any) -> None:
    pytest.importorskip("pyamg")
    found = load("voxel_beam").confined_moduli(fields.constant(-1.0), ((0.0, 0.0, 0.0), (4.0, 2.0, 3.0)), 8)
    assert found == pytest.approx([0.7 / (1.3 * 0.4)] * 3, rel=1e-6)


def test_phases_are_the_integral_where_there_is_one_and_the_closest_gradient_where_there_is_none(load: Any) -> None:
    phases = load("cell_phases")
    box, rng = ((0.0, -3.0, -4.0), (20.0, 3.0, 4.0)), np.random.default_rng(1)

    def frequency(p: np.ndarray) -> np.ndarray:
        return 1 / np.interp(p[:, 0], (0.0, 20.0), (10.0, 5.0))

    along, across, _ = phases.solve_phases(frequency, box, 0.25)
    x = rng.uniform(*box, (2000, 3))
    integral = -4.0 * np.log(10.0 - x[:, 0] / 4.0)
    assert np.ptp(along(x) - integral) < 1e-3

    def squares(phase: fields.Field) -> float:
        return float(np.sum((phase.gradient(x) - np.outer(frequency(x), (0, 1, 0))) ** 2))

    plain = phases.modulate(frequency, box, np.array([10.0, 0.0, 0.0]))[1]
    bump = fields.sampled(rng.normal(size=(5, 5, 5)), (5.0, 1.5, 2.0), box[0])
    others = [plain, fields.linear((0, 0.14, 0)), across + 0.01 * bump, across - 0.01 * bump]
    assert squares(across) < min(squares(phase) for phase in others)


def test_a_voronoi_foam_has_the_holes_of_its_graph(load: Any) -> None:
    found = load("voronoi_foam").main(count=6, size=10.0, diameter=0.5, shortest=1.2)
    assert found["met"]
    assert found["betti"] == (1, found["struts"] - found["nodes"] + 1, 0)
    require_files("voronoi_foam")


def test_a_periodic_foam_is_meshed_with_equal_nodes_in_opposite_sides(load: Any) -> None:
    pytest.importorskip("gmsh")
    found = load("periodic_foam").main(diameter=0.6)
    assert found["met"]
    assert all(found["pairs of nodes in opposite sides"].get(axis, 0) > 50 for axis in "xyz")


def test_phases_keep_cell_sizes_that_plain_modulation_misses(load: Any) -> None:
    pytest.importorskip("pyamg")
    pytest.importorskip("gmsh")
    found = load("cell_size_grading").main(size=(12.0, 6.0, 6.0), tol=0.2, voxels=24)
    assert found["met"]
    assert found["deviation"] <= found["tolerance"] == 0.2
    assert found["betti"][0] == 1
    assert found["volume fraction"] == pytest.approx(0.4, abs=0.003)
    best, *others = found["errors"].values()
    for kind in ("cell size error, rms", "measured cell size error, rms", "greatest ratio of stretches"):
        assert best[kind] < min(other[kind] for other in others)
    require_files("cell_size_grading")


def test_a_drawn_layer_is_as_dark_as_the_layer_is_solid(load: Any) -> None:
    image = pytest.importorskip("PIL.Image")
    example = load("layers")
    found = example.main(cell=11.0, height=4.0, chord_error=0.05)
    assert found["layers"] == 5
    assert Path("layers.cli").stat().st_size > 10_000
    picture = np.asarray(image.open("layers.png").convert("L"))
    layers = example.tpmscad.infill_layers(
        example.block(), "gyroid", cell=11.0, volume_fraction=0.25, skin=0.8, height=4.0, chord_error=0.05
    )
    area = sum(
        0.5 * (x[:-1] * np.roll(y, -1)[:-1] - np.roll(x, -1)[:-1] * y[:-1]).sum()
        for x, y in (np.concatenate([c, c[:1]])[:, :2].T for c in layers[2].contours)
    )
    assert (picture < 128).mean() == pytest.approx(area / (example.LENGTH * example.WIDTH), rel=0.02)


def test_the_shell_of_a_segmentation_has_the_volume_of_its_voxels(load: Any) -> None:
    found = load("segmentation").main(size=8.0, cell=6.0)
    assert found["lattice"]["met"]
    assert found["shell"]["met"]
    assert found["shell"]["betti"] == (1, 1, 0), "a tube"
    assert found["shell"]["volume"] == pytest.approx(found["voxels of the shell"], rel=0.03)
    require_files("segmentation_lattice")
