"""The conformance check notices faults: a file is written, one thing in it changed, and the rule that forbids it is named."""

from __future__ import annotations

import re
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tests.part21 import check, parser
from tests.part21.breaches import IMPLIED, RULE_BREAKS, TYPE_BREAKS
from tests.part21.rules import RULES

pytestmark = pytest.mark.kernel

import build123d as bd
from OCP.BRepPrimAPI import BRepPrimAPI_MakeSphere, BRepPrimAPI_MakeTorus
from OCP.IFSelect import IFSelect_RetDone
from OCP.Interface import Interface_Static
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer
from OCP.TopoDS import TopoDS_Shape

from tests.shapes.kernel_shapes import TURN, drilled_dome, hollow_box, plane_box
from tests.shapes.round_shapes import frustum, pierced_block
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.export.shape_file import write_shape
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.step_reader import silence_occt
from tpmscad.rigid_motion import Motion

COLOURS = {"side": (1.0, 0.0, 0.0), "hole": (0.0, 0.0, 1.0)}
PAIR = Motion(np.stack([np.eye(3), TURN]), np.array([[0.0, 0.0, 0.0], [7.0, -2.0, 1.0]]))
SAMPLES = {
    "box": (plane_box, {}),
    "dome": (drilled_dome, {"colours": COLOURS}),
    "pair": (plane_box, {"instances": [PAIR]}),
    "void": (hollow_box, {}),
    "cone": (lambda: frustum(3, 1, 2), {}),
}
OF_THE_KERNEL = {
    "kernel's dome": lambda: build_solids(drilled_dome()).shape,
    "kernel's void": lambda: build_solids(hollow_box()).shape,
    "kernel's pierced block": lambda: build_solids(pierced_block()).shape,
    "kernel's ball": lambda: BRepPrimAPI_MakeSphere(2.0).Shape(),
    "kernel's ring": lambda: BRepPrimAPI_MakeTorus(5.0, 1.5).Shape(),
}


OF_SHAPES = {
    "shape of a void": OF_THE_KERNEL["kernel's void"],
    "shape of a pierced block": OF_THE_KERNEL["kernel's pierced block"],
    "ball": OF_THE_KERNEL["kernel's ball"],
    "ring": OF_THE_KERNEL["kernel's ring"],
    "extrusion": lambda: bd.extrude(bd.make_face(bd.Spline((0, 0), (4, 1), (5, 5), (1, 6), periodic=True)), 4).wrapped,
    "revolution": lambda: (
        bd.revolve(bd.make_face([bd.Spline((2, 0), (4, 2), (2, 5)), bd.Line((2, 5), (2, 0))]), bd.Axis.Y, 200).wrapped
    ),
    "loft": lambda: bd.loft([bd.Circle(5).face(), bd.Pos(0, 0, 8) * bd.Ellipse(3, 4).face()]).wrapped,
    "mirrored cone": lambda: bd.mirror(bd.Pos(3, 1, 2) * bd.Cone(3, 1, 5), about=bd.Plane.XY).wrapped,
}
"""Shapes that our writer takes face by face."""


def write_by_occt(shape: TopoDS_Shape, path: Path, *, schema: str) -> None:
    """OCCT's own file of a shape, as a sample of pcurves, seams and rational surfaces that our writers leave out."""
    STEPControl_Writer()  # the first writer registers the settings
    assert Interface_Static.SetCVal_s("write.step.schema", {"ap242": "AP242DIS", "ap214": "AP214IS"}[schema])
    with silence_occt():
        writer = STEPControl_Writer()
        writer.Transfer(shape, STEPControl_AsIs)
        assert writer.Write(str(path)) == IFSelect_RetDone


@lru_cache
def lines(sample: str, schema: str) -> tuple[str, dict[int, str]]:
    """The text before the data section, and the data section by number, without blanks between tokens."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.step"
        if sample in SAMPLES:
            make, how = SAMPLES[sample]
            brep = make()
            write_step(brep, build_solids(brep).nesting, path, schema=schema, **how)
        else:
            write = write_shape if sample in OF_SHAPES else write_by_occt
            write((OF_SHAPES | OF_THE_KERNEL)[sample](), path, schema=schema)
        head, data = re.split(r"^DATA;\n", path.read_text(), maxsplit=1, flags=re.M)
    tight = "".join(part if i % 2 else re.sub(r"\s", "", part) for i, part in enumerate(re.split("('[^']*')", data)))
    return head, {int(n): body for n, body in re.findall(r"#(\d+)=(.*?);(?=#\d+=|ENDSEC)", tight)}


def faults(sample: str, schema: str, *changes: tuple[str, str, str]) -> list[str]:
    """What is found after the changes: at a place, a pattern and what takes its place.

    A place is an entity's name, for the first instance of it; A>B is the first B that this refers to, A[1] the second. An empty
    place is a new instance. {A} in a replacement is the number of the instance at that place, {} that of the changed one.
    """
    head, bodies = lines(sample, schema)
    bodies = dict(bodies)

    def is_a(number: int, name: str) -> bool:
        return re.match(rf"(\((.*\))?)?{name}\(", bodies[number]) is not None  # itself, or a part of a complex one

    def find(place: str) -> int:
        among = list(bodies)
        for step in place.split(">"):
            name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", step).groups(default="0")
            number = [n for n in among if is_a(n, name)][int(index)]
            among = [int(n) for n in re.findall(r"#(\d+)", bodies[number])]
        return number

    for place, pattern, replacement in changes:
        number = find(place) if place else max(bodies) + 1
        new = re.sub(r"\{(.*?)\}", lambda m: str(find(m[1]) if m[1] else number), replacement)  # noqa: B023
        if place and not new and not pattern:
            del bodies[number]
        elif place:
            bodies[number], count = re.subn(pattern, new, bodies[number], count=1)
            assert count == 1, (place, pattern, bodies[number])
        else:
            bodies[number] = new
    text = head + "DATA;\n" + "".join(f"#{n}={b};\n" for n, b in bodies.items()) + "ENDSEC;\nEND-ISO-10303-21;\n"
    return check.faults(parser.parse(text)[1], schema)


@pytest.mark.parametrize("schema", ["ap242", "ap214"])
@pytest.mark.parametrize("sample", [*SAMPLES, *OF_SHAPES])
def test_what_is_written_breaks_no_rule(sample: str, schema: str) -> None:
    assert faults(sample, schema) == []


@pytest.mark.parametrize("schema", ["ap242", "ap214"])
@pytest.mark.parametrize("sample", OF_THE_KERNEL)
def test_the_kernels_own_writer_agrees_with_the_table_but_names_no_owner(sample: str, schema: str) -> None:
    found = faults(sample, schema)
    assert [f.split(":")[0] for f in found] == (["product_requires_id_owner"] if schema == "ap214" else [])


@pytest.mark.parametrize("fault", TYPE_BREAKS)
def test_values_that_the_schema_does_not_allow_are_noticed(fault: str) -> None:
    sample, *changes = TYPE_BREAKS[fault]
    found = faults(sample, "ap242", *changes)
    assert len(found) >= 1
    assert not any(f.startswith(tuple(r.name for r in RULES)) for f in found)


@pytest.mark.parametrize(("name", "sample", "changes"), [(n, s, c) for n, s, *c in RULE_BREAKS])
def test_a_broken_rule_is_named(name: str, sample: str, changes: list[tuple[str, str, str]]) -> None:
    schemas = next(r.schemas for r in RULES if r.name == name)
    for schema in schemas:
        assert name in [f.split(":")[0] for f in faults(sample, schema, *changes)]


def test_every_rule_can_be_broken() -> None:
    assert {r.name for r in RULES} - {name for name, *_ in RULE_BREAKS} == IMPLIED
