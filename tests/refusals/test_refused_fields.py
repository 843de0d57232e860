"""Refusals of fields, regions, data and samples: each request that cannot be carried out, with words of its message."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.refusals.refused import Row, check_refusal
from tpmscad import fields, surfaces, topology
from tpmscad.errors import InvalidRequest, NoFoot
from tpmscad.fields.analysis.isometries import find_isometries
from tpmscad.fields.data.image_files import read_image
from tpmscad.fields.data.sample_grid import SampleGrid, sample_field
from tpmscad.fields.kinds.volume_fraction_thresholds import volume_fractions
from tpmscad.studies.surface_limits import thickest_wall
from tpmscad.surfaces.plane_waves import level_set_waves

NAN, INF = float("nan"), float("inf")
GYROID, BALL = fields.tpms("gyroid", 2.0), fields.sphere((0, 0, 0), 1.0)
POINT = np.array([[0.1, 0.2, 0.3], [0.4, 0.1, 0.2]])
GRID = SampleGrid((0, 0, 0), (1, 1, 1), (4, 4, 4))
SLICES = np.insert(np.random.default_rng(0).random((3200, 2)), 2, np.repeat((0.0, 5.0), 1600), axis=1)
CLOUD = np.random.default_rng(0).random((30, 3))


UNIT = ((0, 0, 0), (1, 1, 1))


def staircase(p: np.ndarray) -> np.ndarray:
    return np.floor(4 * p[..., 0])


class OtherGrid:
    """A field whose values on a grid do not fit it."""

    def on_grid(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.zeros((len(z), len(y), len(x) + 1))


ARGUMENTS: dict[str, Row] = {
    "point of two": (lambda: fields.sphere((0, 0), 1.0), "center.*three numbers"),
    "radius zero": (lambda: fields.sphere((0, 0, 0), 0.0), "radius 0.*must be positive"),
    "radius of text": (lambda: fields.sphere((0, 0, 0), "one"), "radius 'one'"),
    "height below zero": (lambda: fields.cylinder((0, 0, 0), 1.0, "x", -2.0), "height -2.*must be positive"),
    "scaled by zero": (lambda: fields.scale(BALL, 0.0), "factor 0.*must be positive"),
    "no direction": (lambda: fields.halfspace((0, 0, 0), (0, 0, 0)), "no direction"),
    "word for a direction": (lambda: fields.halfspace((0, 0, 0), "w"), "give x, y, z, -x"),
    "offset of text": (lambda: fields.linear((1, 0, 0), "a"), "offset 'a' is not a number"),
    "array of no dimension": (lambda: fields.sphere(np.array(1.0), 1.0), r"center array\(1\.0?\) is no sequence"),
    "object without length": (lambda: fields.sphere(object(), 1.0), "center <object .* is no sequence"),
    "points of unequal lengths": (lambda: GYROID([[1, 2, 3], [1, 2]]), "points .* is no array of numbers of one shape"),
    "points of two": (lambda: GYROID(np.zeros((4, 2))), r"shape \(4, 2\).*x, y and z"),
    "points of text": (lambda: GYROID([["a", "b", "c"]]), "no array of numbers"),
    "grid of points": (lambda: GYROID.on_grid(np.zeros((2, 2)), np.zeros(2), np.zeros(2)), "one-dimensional"),
    "box inside out": (lambda: fields.box((1, 0, 0), (0, 1, 1)), "each lo below its hi"),
    "box of all space": (lambda: fields.box((-INF,) * 3, (INF,) * 3), "all of space"),
    "constant NaN": (lambda: fields.constant(NAN), "value nan must be finite"),
    "no field": (lambda: fields.as_field("x"), "it takes a field, a function"),
    "division by zero": (lambda: GYROID / 0, "other than zero"),
    "union of none": (lambda: fields.union(), "at least one field"),
}

GRADING: dict[str, Row] = {
    "ramp of one value": (lambda: fields.ramp("x", (0, 1), (1,)), "values .* must be two numbers"),
    "limits inside out": (
        lambda: fields.clip(GYROID, 1, 0.5),
        "the least value 1 of clip must be below the greatest, 0.5",
    ),
    "empty span": (lambda: fields.ramp("x", (2, 2), (0, 1)), "starts and ends at 2"),
    "sizes of no period": (lambda: fields.cell_sizes(BALL, x=([0, 1], [1, 2])), "need a periodic field"),
    "sizes along none": (lambda: fields.cell_sizes(GYROID), "at least one of the axes"),
    "sizes for other positions": (lambda: fields.cell_sizes(GYROID, x=([0, 1, 2], [1, 2])), "3 positions and 2 sizes"),
    "positions descending": (lambda: fields.cell_sizes(GYROID, y=([1, 0], [1, 2])), "along y.*must be ascending"),
    "size of zero": (lambda: fields.cell_sizes(GYROID, z=([0, 1], [1, 0])), "along z.*must be positive"),
    "map that drops an axis": (lambda: fields.warp(GYROID, lambda p: p[:, :2])(POINT), "must keep the shape"),
    "map that is not finite": (lambda: fields.warp(GYROID, lambda p: p * NAN)(POINT), "not finite at"),
    "Jacobian of another shape": (
        lambda: fields.warp(GYROID, lambda p: p, lambda p: np.eye(3)).gradient(POINT),
        r"must return \(n, 3, 3\)",
    ),
    "wall of no thickness": (lambda: fields.wall(GYROID, 0.0), "thickness"),
    "kind of fraction": (lambda: volume_fractions(GYROID, np.zeros(1), "foam"), "choose rod, pore or sheet"),
    "three samples": (lambda: fields.volume_fraction(GYROID, samples=3), "at least 4"),
    "fraction without period": (lambda: fields.volume_fraction(BALL), "not periodic"),
    "span of one": (lambda: fields.graded_threshold(GYROID, 0.3, (0.2,)), "span .* must be two numbers"),
    "fraction between two plateaus": (
        lambda: fields.threshold_for(staircase, 0.1, domain=UNIT),
        "fraction 0.1 is out of reach: the field is constant .* a rod fills between 0.25 and 1 of it",
    ),
    "fractions over plateaus": (
        lambda: fields.graded_threshold(staircase, 0.5, (0.3, 0.9), domain=UNIT),
        "not a function of the volume fraction from 0.3 to 0.9: narrow the span",
    ),
    "no span": (lambda: fields.graded_threshold(GYROID, BALL), "give span="),
    "span inside out": (lambda: fields.graded_threshold(GYROID, 0.3, (0.5, 0.2)), "the least first"),
    "isometries without periods": (lambda: find_isometries(BALL), "no lattice of copies"),
}

FUNCTIONS: dict[str, Row] = {
    "values of another shape later": (
        lambda: fields.from_function(lambda p: p[: len(p), 0] if len(p) < 6 else p[:, :2])(np.zeros((9, 3))),
        r"gave shape \(9, 2\) for 9 points: .* one value for each point",
    ),
}

FORMULAS: dict[str, Row] = {
    "no text": (lambda: fields.expression(3), "must be text"),
    "too long": (lambda: fields.expression("x+" * 60_000 + "x"), "characters, more than"),
    "name with a meaning": (lambda: fields.expression("x + sin", sin=GYROID), "has a meaning in every formula"),
    "parentheses too deep": (lambda: fields.expression("(" * 400 + "x" + ")" * 400), "cannot be read"),
    "too deep": (lambda: fields.expression("-" * 150 + "x"), "nests .* deep"),
    "null character": (lambda: fields.expression("x\x00"), "cannot be read"),
    "truth value": (lambda: fields.expression("True"), "may not stand"),
    "keyword": (lambda: fields.expression("sin(u=x)"), "may not stand"),
    "function without its argument": (lambda: fields.expression("sin + x"), r"write sin\(x\)"),
    "attribute": (lambda: fields.expression("x.real"), "may not stand in the formula"),
    "unknown name": (lambda: fields.expression("x + q"), "'q' is unknown"),
    "operator": (lambda: fields.expression("x % 2"), r"other than \+ - \* /"),
    "unknown function": (lambda: fields.expression("sine(x)"), "function 'sine' is unknown .*did you mean 'sin'"),
    "syntax": (lambda: fields.expression("x +"), "cannot be read"),
    "huge number": (lambda: fields.expression("x + " + "9" * 400), "too large"),
    "infinite number": (lambda: fields.expression("1e400 * x"), "too large"),
    "two arguments": (lambda: fields.expression("atan2(x)"), "takes two arguments, here 1"),
    "one argument": (lambda: fields.expression("sin(x, y)"), "takes one argument, here 2"),
    "more arguments": (lambda: fields.expression("min(x)"), "two or more arguments"),
}

DATA: dict[str, Row] = {
    "no path": (lambda: fields.sampled(""), "values '' is no path of a file: it is empty .* as in values=np.zeros"),
    "path with a null character": (lambda: fields.scattered("a\0.csv"), "points .* holds a null character"),
    "rows of unequal lengths": (
        lambda: fields.image_region([[True], [True, False]], (0, 0), (1, 1)),
        r"mask \[\[True\], \[True, False\]\] is no array of one shape",
    ),
    "slices far apart": (
        lambda: fields.scattered(SLICES, SLICES[:, 0], resolution=4),
        "cannot be interpolated .* if the 80 points next to a place lie in one plane",
    ),
    "samples of another grid": (
        lambda: sample_field(OtherGrid(), SampleGrid((0, 0, 0), (1, 1, 1), (4, 5, 6))),  # type: ignore[arg-type]
        r"the field gave values of shape \(6, 5, 5\) on a grid of \(4, 5, 6\)",
    ),
    "flat array": (lambda: fields.sampled(np.zeros((4, 4))), "three dimensions"),
    "file of text": (lambda: fields.sampled("density.txt"), "choose one of .npy"),
    "missing file": (lambda: fields.sampled("absent.npy"), "there is no file"),
    "three samples along an axis": (lambda: fields.sampled(np.zeros((5, 3, 5))), "at least 4 samples"),
    "spacing of zero": (lambda: fields.sampled(np.zeros((4, 4, 4)), spacing=0), "spacing 0 must"),
    "endless sample": (
        lambda: fields.sampled(np.where(np.arange(64).reshape(4, 4, 4) == 7, INF, 1.0)),
        r"1 of 64 entries, the first at index \(0, 1, 3\)",
    ),
    "text for samples": (lambda: fields.sampled([[["a"]]]), "no array of numbers"),
    "negative smoothing": (lambda: fields.scattered(CLOUD, CLOUD[:, 0], smoothing=-1.0), "smoothing -1"),
    "missing table": (lambda: fields.scattered("none.csv"), "there is no file none.csv"),
    "values beside a file": (lambda: fields.scattered("none.csv", np.zeros(5)), "leave values out"),
    "points without values": (lambda: fields.scattered(CLOUD), "give the values after them"),
    "values for other points": (lambda: fields.scattered(CLOUD, CLOUD[:5, 0]), r"give \(n, 3\) and \(n,\)"),
    "too few points": (lambda: fields.scattered(CLOUD[:3], CLOUD[:3, 0]), "fewer than"),
    "point that is not finite": (
        lambda: fields.scattered(CLOUD * [1, 1, NAN], CLOUD[:, 0]),
        "not finite at 30 of 90 entries",
    ),
    "point twice": (lambda: fields.scattered(CLOUD[[*range(30), 4]], np.arange(31.0)), "occurs twice"),
    "points in a plane": (lambda: fields.scattered(CLOUD * [1, 1, 0], CLOUD[:, 0]), "one plane"),
    "resolution of scattered data": (lambda: fields.scattered(CLOUD, CLOUD[:, 0], resolution=1.5), "resolution 1.5"),
    "resolution of one sample": (lambda: fields.scattered(CLOUD, CLOUD[:, 0], resolution=1), "resolution 1:"),
    "resolution NaN": (lambda: fields.scattered(CLOUD, CLOUD[:, 0], resolution=NAN), "resolution nan"),
    "text for points": (lambda: fields.scattered([["a"] * 3], [1]), "no array of numbers"),
    "domain inside out": (
        lambda: fields.scattered(CLOUD, CLOUD[:, 0], domain=((1, 1, 1), (0, 0, 0))),
        "each coordinate of the first corner must be below",
    ),
    "no booleans": (lambda: fields.image_region(np.zeros((4, 4)), (0, 0), (1, 1)), "not bool"),
    "mask of four dimensions": (
        lambda: fields.image_region(np.ones((2,) * 4, bool), (0,) * 4, (1,) * 4),
        "two or three",
    ),
    "mask of one value": (lambda: fields.image_region(np.ones((4, 4), bool), (0, 0), (1, 1)), "one value only"),
    "empty image": (lambda: fields.image_region(np.eye(4, dtype=bool), (0, 0), (0, 1)), "is empty"),
    "corner of an image": (lambda: fields.image_region(np.eye(4, dtype=bool), (0, 0, 0), (1, 1)), "2 finite numbers"),
    "axis of an image": (lambda: fields.image_region(np.eye(4, dtype=bool), (0, 0), (1, 1), axis="w"), "axis 'w'"),
    "coefficients of two dimensions": (
        lambda: fields.bspline_unit(np.ones((2, 2)), 1.0),
        "must be finite samples in an array of three dimensions",
    ),
    "coefficient NaN": (lambda: fields.bspline_unit(np.full((2, 2, 2), NAN), 1.0), "not finite at 8 of 8 entries"),
    "empty grid": (lambda: SampleGrid((0, 0, 0), (0, 1, 1), (4, 4, 4)), "each low must be below"),
    "one sample": (lambda: SampleGrid((0, 0, 0), (1, 1, 1), (1, 4, 4)), "at least 2 samples"),
    "samples of another shape": (lambda: sample_field(lambda p: np.zeros(3), GRID, "structure 1"), "structure 1 gave"),
    "samples that are not finite": (
        lambda: sample_field(lambda p: p[..., 0] * NAN, GRID, "structure 1"),
        "not finite at",
    ),
    "function of one point": (
        lambda: sample_field(lambda p: [][0], GRID, "structure 1"),
        "structure 1 can't be called",
    ),
}

TOPOLOGY: dict[str, Row] = {
    "dimension three": (lambda: topology.persistence_diagram(np.zeros((3, 3, 3)), dimensions=(3,)), "choose from 0"),
    "no dimension": (lambda: topology.persistence_diagram(np.zeros((3, 3, 3)), dimensions=()), "choose from 0"),
    "negative persistence": (
        lambda: topology.persistence_diagram(np.zeros((3, 3, 3)), min_persistence=-1),
        "at least 0",
    ),
    "diagram outside a box": (lambda: topology.persistence_diagram(BALL), "not periodic along every axis"),
    "diagram in an empty box": (
        lambda: topology.persistence_diagram(BALL, ((1, 1, 1), (0, 0, 0)), 4),
        "each coordinate of the first corner must be below",
    ),
    "one sample along an axis": (lambda: topology.persistence_diagram(GYROID, resolution=1), "at least 2 samples"),
    "an array in a box": (lambda: topology.persistence_diagram(np.zeros((3,) * 3), resolution=4), "has its own grid"),
    "one value for all points": (
        lambda: topology.persistence_diagram(lambda p: np.zeros(3), UNIT, (4, 5, 6)),
        r"the field gave shape \(3,\) for points of shape \(4, 5, 6\)",
    ),
    "convention of components": (
        lambda: topology.count_components_and_cavities(np.zeros((3, 3, 3)), 0.0, "cubes"),
        "convention 'cubes'",
    ),  # type: ignore[arg-type]
    "diagram of text": (lambda: topology.persistence_diagram("x"), "no array of numbers"),
    "dimension not computed": (
        lambda: topology.persistence_diagram(np.random.default_rng(0).random((4,) * 3), dimensions=(0,)).pairs(2),
        "computed for 0",
    ),
    "flat samples": (
        lambda: topology.betti(np.zeros((3, 3))),
        "must be finite samples in an array of three dimensions",
    ),
    "samples with NaN": (lambda: topology.betti(np.full((3, 3, 3), NAN)), "not finite at 27 of 27 entries"),
}

SURFACES: dict[str, Row] = {
    "no patch": (lambda: surfaces.primitive_patch("octo", "nodal"), "no patch in closed form"),
    "no record": (lambda: surfaces.check_reference(3, "minimal"), "record 3 is no record of the catalogue"),  # type: ignore[arg-type]
    "thickest wall of a reference": (
        lambda: thickest_wall("iwp", "exact"),
        "reference 'exact' of the iwp is unknown; choose one of",
    ),
}

TABLES = {
    "arguments": ARGUMENTS,
    "grading": GRADING,
    "functions": FUNCTIONS,
    "formulas": FORMULAS,
    "data": DATA,
    "topology": TOPOLOGY,
    "surfaces": SURFACES,
}


@pytest.mark.parametrize(("table", "name"), [(table, name) for table, rows in TABLES.items() for name in rows])
def test_what_cannot_be_a_field_is_refused(table: str, name: str) -> None:
    check_refusal(TABLES[table][name], InvalidRequest)


def test_points_without_a_foot_on_the_level_set_are_counted() -> None:
    waves = level_set_waves("schwarz_p", "nodal")
    check_refusal((lambda: waves.project_to_level_set(np.zeros((2, 3))), "2 points are critical points"), NoFoot)
    check_refusal((lambda: waves.project_to_level_set(np.full((1, 3), 1e-9)), "too far from the level set"), NoFoot)


def test_an_image_that_states_no_spacing_is_refused(tmp_path: Path) -> None:
    nrrd = pytest.importorskip("nrrd")
    header = {"spacings": [0.5, 0.0, 2.0]}
    nrrd.write(str(tmp_path / "a.nrrd"), np.zeros((3, 4, 5)), header)
    words = r"a\.nrrd states a spacing of \[0\.5, 0\.0, 2\.0\], which must be positive"
    check_refusal((lambda: read_image(tmp_path / "a.nrrd"), words), InvalidRequest)


def test_a_reader_that_is_not_installed_is_named_with_the_way_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.nii").touch()
    monkeypatch.setitem(sys.modules, "nibabel", None)
    words = r"needs nibabel: pip install 'tpmscad\[images\]'"
    check_refusal((lambda: read_image(tmp_path / "a.nii"), words), InvalidRequest)


def test_points_in_a_file_that_is_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_bytes(b"PAR1\xff\xfe\x00")
    check_refusal(
        (lambda: fields.scattered(tmp_path / "points.csv"), "points.csv is no text: give a CSV"), InvalidRequest
    )
