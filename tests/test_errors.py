"""Errors travel between processes: every class survives pickling with its message and attributes."""

from __future__ import annotations

import importlib
import pickle
import pkgutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import pytest

import tpmscad
from tpmscad.errors import KernelError, NotMet, NotQuadric, ThinWall, TpmscadError

pytestmark = pytest.mark.kernel

ARGUMENTS: dict[type[TpmscadError], tuple[object, ...]] = {
    KernelError: ("write", "IFSelect_RetFail", object()),
    NotMet: ("the deviation 0.2 exceeds 0.1", {"met": False}),
    NotQuadric: ("the body has 1 free-form face", (3,)),
    ThinWall: ("the wall is 0.1 thick", 0.1),
}
"""What the constructors take that need more than a message."""


def subclasses(base: type[TpmscadError]) -> Iterator[type[TpmscadError]]:
    """The class and everything derived from it."""
    yield base
    for child in base.__subclasses__():
        yield from subclasses(child)


def every_error_class() -> set[type[TpmscadError]]:
    """Every class of errors in the package, private ones included."""
    for module in pkgutil.walk_packages(tpmscad.__path__, "tpmscad."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    return set(subclasses(TpmscadError))


def test_every_class_of_errors_survives_pickling_with_its_message_and_attributes() -> None:
    classes = every_error_class()
    assert len(classes) > 10
    for kind in classes:
        error = kind(*ARGUMENTS.get(kind, ("cell 0 must be positive",)))
        error.add_note("found in the second row")
        copy = pickle.loads(pickle.dumps(error))
        assert (type(copy), str(copy), copy.args) == (kind, str(error), error.args)
        assert copy.__dict__ == {**error.__dict__, **({"shape": None} if kind is KernelError else {})}


def fail_in_kernel() -> None:
    """What a worker of a process pool meets when the kernel refuses."""
    raise KernelError("write", "IFSelect_RetFail", object())


@pytest.mark.slow
def test_a_process_pool_hands_on_the_error_of_a_worker_and_goes_on() -> None:
    with ProcessPoolExecutor(1) as pool:
        with pytest.raises(KernelError, match="write: IFSelect_RetFail") as caught:
            pool.submit(fail_in_kernel).result(timeout=60)
        assert caught.value.status == "IFSelect_RetFail"
        assert pool.submit(len, "next").result(timeout=60) == 4
