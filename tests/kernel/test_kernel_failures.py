"""Failures of the kernel, provoked: each becomes a KernelError with its operation, none a wrong solid."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

import build123d as bd
from OCP.BRep import BRep_Tool
from OCP.TopoDS import TopoDS_Shape, TopoDS_Vertex

from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.boolean import body_split, boolean_operations
from tpmscad.solids import cut

BODY = bd.Box(3, 4, 5).solid().wrapped


class Undone:
    """An operation of the kernel that ends without a result."""

    def __init__(self, *_: Any) -> None:
        pass

    def IsDone(self) -> bool:
        return False

    def Shape(self) -> TopoDS_Shape:
        return TopoDS_Shape()

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


class Null(Undone):
    """An operation that claims to be done and has no shape."""

    def IsDone(self) -> bool:
        return True


@pytest.mark.parametrize("kind", [Undone, Null])
@pytest.mark.parametrize(
    ("module", "name", "call", "words"),
    [
        (
            boolean_operations,
            "BRepAlgoAPI_Common",
            lambda: boolean_operations.intersect_solids(BODY, BODY),
            "intersection",
        ),
        (boolean_operations, "BRepAlgoAPI_Cut", lambda: boolean_operations.subtract_solid(BODY, BODY), "difference"),
        (body_split, "BRepAlgoAPI_Splitter", lambda: body_split.split_body(BODY, BODY, ["a"] * 6), "body split"),
    ],
    ids=["common", "cut", "splitter"],
)
def test_an_operation_without_a_result_is_an_error(
    monkeypatch: pytest.MonkeyPatch, kind: type, module: Any, name: str, call: Any, words: str
) -> None:
    monkeypatch.setattr(module, name, kind)
    with pytest.raises(KernelError, match=f"{words}.* failed") as caught:
        call()
    assert caught.value.shape is BODY


def test_an_exception_of_the_kernel_is_translated_and_others_are_not() -> None:
    with pytest.raises(KernelError, match=r"my operation: Standard_NullObject.*; try another"):  # noqa: SIM117
        with boolean_operations.translate_occt_errors("my operation", BODY, "; try another"):
            BRep_Tool.Pnt_s(TopoDS_Vertex())
    with pytest.raises(ZeroDivisionError), boolean_operations.translate_occt_errors("my operation", BODY):
        _ = 1 / 0


PATCHES: Any = SimpleNamespace(faces=range(10))


def test_the_kernels_boolean_is_not_tried_with_tens_of_thousands_of_patches() -> None:
    with pytest.raises(InvalidRequest, match="has 20001 patches"):
        cut.require_few_faces(cut.MAX_KERNEL_FACES + 1)


def test_the_kernels_boolean_is_checked_and_its_volume_compared_with_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    sample, cad = np.zeros((100, 3)), SimpleNamespace(shape=BODY)
    body: Any = SimpleNamespace(volume=100.0, name="the body", sample=lambda: sample)
    filled = round(boolean_operations.estimate_volume(BODY))  # of a hundred

    def matter(count: int) -> Any:
        return SimpleNamespace(
            patches=None,
            contains=lambda points: np.arange(len(points)) < count,
            intersect_in_kernel=lambda _: (BODY,),
            measure=lambda *_: None,
        )

    made = cut.BY_KERNEL.run(body, matter(filled), cad)  # type: ignore[arg-type]
    assert made.built.solids == (BODY,)
    with pytest.raises(KernelError, match=r"it fills 0.6 of the body, but 1 \+- 0\.\d+ of a sample"):
        cut.BY_KERNEL.run(body, matter(100), cad)  # type: ignore[arg-type]
    monkeypatch.setattr(cut, "is_valid", lambda _: False)
    with pytest.raises(KernelError, match="check rejects what its own boolean made"):
        cut.BY_KERNEL.run(body, matter(filled), cad)  # type: ignore[arg-type]
