"""A body may be a build123d part, a builder, a kernel shape, a primitive region or a file: the same solid is read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import build123d as bd
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_body import read_body

pytestmark = pytest.mark.kernel


def builder() -> bd.BuildPart:
    with bd.BuildPart() as block:
        bd.Box(2, 3, 4)
    return block


SOURCES: dict[str, Callable[[], Any]] = {
    "part": lambda: bd.Box(2, 3, 4),
    "builder": builder,
    "kernel shape": lambda: bd.Box(2, 3, 4).solid().wrapped,
    "region": lambda: fields.box((-1, -1.5, -2), (1, 1.5, 2)),
    "body": lambda: read_body(bd.Box(2, 3, 4)),
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_body_is_read_from(name: str) -> None:
    body = read_body(SOURCES[name]())
    assert body.report.volume == pytest.approx(24.0)
    assert body.report.solids == 1


@pytest.mark.parametrize("source", [bd.Sketch() + bd.Rectangle(1, 2), bd.Line((0, 0), (1, 1)), object()])
def test_what_has_no_solid_is_refused(source: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"no solid|no body"):
        read_body(source)
