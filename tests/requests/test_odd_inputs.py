"""Any request, most of it sensible, some of it not: a clear error, or a correct solid; an error leaves no file behind."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import tpmscad
from tpmscad import fields
from tpmscad.kernel.measure.shape_report import check_step

pytestmark = pytest.mark.kernel

LONGEST = 60.0
"""CPU seconds that a request may take."""

NAN, INF = float("nan"), float("inf")


def _text_file(folder: Path) -> Path:
    (folder / "note.step").write_text("ISO-10303-21; not really")
    return folder / "note.step"


def _step_file(folder: Path) -> Path:
    bd.export_step(bd.Box(13, 12, 11), folder / "box.step")
    return folder / "box.step"


def _step_of_a_face(folder: Path) -> Path:
    bd.export_step(bd.Compound([bd.Face.make_rect(20, 20)]), folder / "face.step")
    return folder / "face.step"


def _hollow(_: Path) -> Any:
    return bd.Box(14, 14, 14) - bd.Box(6, 6, 6)


def _two_that_touch_in_an_edge(_: Path) -> Any:
    return bd.Box(12, 12, 12) + bd.Pos(12, 12, 0) * bd.Box(12, 12, 12)


GOOD: dict[str, list[Any]] = {
    "body": [
        lambda _: bd.Box(14, 12, 11),
        lambda _: bd.fillet(bd.Box(14, 13, 12).edges(), 3),
        lambda _: bd.Pos(3, 1, 2) * bd.Rot(10, 20, 30) * bd.Cylinder(6, 13),
        lambda _: bd.Sphere(7),
        lambda _: bd.Cone(7, 3, 12),
        _step_file,
    ],
    "surface": ["gyroid", "P", "diamond", "iwp"],
    "cell": [9, 10.5],
    "thickness": [1.0, 0.7],
    "kind": ["sheet"],
    "phase": [(0.0, 0.0, 0.0), (0.1, 0.25, -3)],
    "rotation": [(0.0, 0.0, 0.0), (10, 20, 90)],
    "skin": [None, None, 0.8],
    "tol": [0.1],
}
ODD: dict[str, list[Any]] = {
    "body": [
        lambda _: bd.Face.make_rect(20, 20),
        lambda _: bd.Shell(bd.Box(12, 12, 12).faces()[:5]),
        lambda _: bd.Box(12, 12, 12) + bd.Pos(30, 0, 0) * bd.Box(12, 12, 12),
        lambda _: bd.Solid(bd.Box(12, 12, 12).solid().wrapped.Reversed()),
        lambda _: bd.Part(),
        lambda _: bd.Box(14, 14, 1e-6),
        lambda _: bd.Box(14, 14, 0.01),
        lambda _: bd.Box(1e-3, 1e-3, 40),
        lambda _: bd.Sphere(1e-3),
        lambda _: bd.Box(1e10, 12, 12),
        lambda _: bd.Pos(1e7, 0, 0) * bd.Box(12, 12, 12),
        lambda _: bd.Edge.make_line((0, 0, 0), (12, 0, 0)),
        lambda folder: folder / "none.step",
        lambda folder: folder,
        _text_file,
        _step_of_a_face,
        _two_that_touch_in_an_edge,
        _hollow,
        lambda _: bd.Cone(7, 0, 12),
        lambda _: None,
        lambda _: 3.0,
        lambda _: "",
        lambda _: [],
        lambda _: bd.Box,
    ],
    "surface": ["gyroidd", "", None, 3, ("gyroid",), fields.sphere, lambda x, y, z: x],
    "cell": [(9, 10, 11), None, 0, -1, NAN, INF, 1e-9, 1e-3, 1e12, 30, "ten", "10", (10, 10), (10, 10, NAN), (), True, 1j],
    "thickness": [None, 0, -1, NAN, INF, 1e-9, 0.02, 4.0, 20, (1, 2), "1", 1j],
    "kind": ["solid", None, 3, "skeletal"],
    "phase": [(NAN, 0, 0), (0.5,), "abc", (1e9, 0, 0), None, 0.5],
    "rotation": [(1, 2), (NAN, 0, 0), (1e6, 0, 0), "xyz", None, 45],
    "skin": [0, -1, NAN, INF, 1e-9, 1e-3, 3.0, 20, "1", (1, 1), True],
    "tol": [0, -1, NAN, INF, 1e-13, 1e6, "fine", None],
}  # fmt: skip


def request_of(seed: int) -> tuple[dict[str, Any], frozenset[str]]:
    """A request, and which of its parts are odd: mostly one, sometimes none or two."""
    rng = np.random.default_rng(seed)
    names = list(GOOD)
    odd = frozenset(names[i] for i in rng.choice(len(names), rng.choice([0, 1, 1, 1, 2]), replace=False))
    tables = {name: (ODD if name in odd else GOOD)[name] for name in names}
    return {name: table[int(rng.integers(len(table)))] for name, table in tables.items()}, odd


def outcome(request: dict[str, Any], folder: Path) -> tuple[str, Any]:
    """What becomes of a request: "refused" with the error, or "made" with the part and its volume in the file."""
    arguments = dict(request)
    body = arguments.pop("body")(folder)
    before = sorted(folder.iterdir())
    target = folder / "made.step"
    try:
        part = tpmscad.infill(body, arguments.pop("surface"), **arguments)
        part.export_step(target)
    except tpmscad.TpmscadError as error:
        assert sorted(folder.iterdir()) == before, "an error left files behind"
        return "refused", error
    return "made", (part, check_step(target).shape)


def held(request: dict[str, Any], odd: frozenset[str]) -> str:
    """One word for what became of a request; AssertionError where it is neither refused clearly nor made correctly."""
    with tempfile.TemporaryDirectory() as name:
        begun = time.process_time()
        word, found = outcome(request, Path(name))
        assert time.process_time() - begun < LONGEST
    if word == "refused":
        assert odd, f"a sensible request was refused: {found}"
        kernels = "offset by the skin" in str(found) or "reads back" in str(found)  # there the kernel has the last word
        assert isinstance(found, tpmscad.InvalidRequest) or kernels, f"not blamed on the request: {found!r}"
        assert 10 < len(str(found)) < 1000
        return word
    part, stored = found
    certificate = part.certificate
    assert certificate.valid
    assert certificate.closed
    assert stored.valid
    assert math.isclose(stored.volume, certificate.volume, rel_tol=1e-6)
    assert certificate.volume > 0
    assert certificate.met == (not certificate.shortfalls)
    assert certificate.met == (
        certificate.valid and certificate.closed and certificate.max_deviation <= certificate.tol
    )
    return word if certificate.met else "made, not met"


seeds = st.integers(0, 2**32)
quietly = {"deadline": None, "suppress_health_check": list(HealthCheck), "derandomize": True}


@settings(max_examples=4, phases=[Phase.generate], **quietly)
@given(seeds)
def test_any_request_is_refused_clearly_or_made_correctly(seed: int) -> None:
    held(*request_of(seed))
