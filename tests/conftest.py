"""Settings of the whole suite."""

from __future__ import annotations

import gc
import importlib.util
import os
import re
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# Before NumPy loads: two BLAS threads on matrices this small, on two busy cores, took 139 s where one takes 18 s.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# A hundred child processes import the package: without bytecode each compiles it for two seconds.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# No deadline: the first example of a compiled or cached function pays for all the others.
settings.register_profile("tpmscad", deadline=None, print_blob=True)
settings.load_profile("tpmscad")


KERNEL = re.compile(r"^pytestmark = .*pytest\.mark\.kernel", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With -m "not kernel and ..." a file of nothing but the kernel's tests is not opened: importing OCP takes seconds."""
    words = config.option.markexpr.split()
    if "or" in words or "not kernel" not in " ".join(words) or collection_path.suffix != ".py":
        return None
    return True if KERNEL.search(collection_path.read_text(encoding="utf-8")) else None


def pytest_collection_finish(session: pytest.Session) -> None:
    """The part without the kernel has not loaded it; what is loaded by now stays to the end.

    Without the freeze the garbage collector goes through all of it, again and again.
    """
    if "not kernel" in session.config.option.markexpr and "OCP" in sys.modules:
        raise pytest.UsageError(
            "a test file without the mark `kernel` imports OCP: mark it, or import from a room below the kernel"
        )
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests marked `frontend` are left out, and said to be, where CadQuery is not installed."""
    if importlib.util.find_spec("cadquery") is None:
        for item in items:
            if item.get_closest_marker("frontend"):
                item.add_marker(pytest.mark.skip(reason="CadQuery is not installed: pip install '.[cadquery]'"))
