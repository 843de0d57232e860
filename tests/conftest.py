"""Settings of the whole suite."""

from __future__ import annotations

import importlib.util
import os

import pytest
from hypothesis import settings

# Before NumPy loads: two BLAS threads on matrices this small, on two busy cores, took 139 s where one takes 18 s.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# No deadline: the first example of a compiled or cached function pays for all the others.
settings.register_profile("tpmscad", deadline=None, print_blob=True)
settings.load_profile("tpmscad")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests marked `frontend` are left out, and said to be, where CadQuery is not installed."""
    if importlib.util.find_spec("cadquery") is None:
        for item in items:
            if item.get_closest_marker("frontend"):
                item.add_marker(pytest.mark.skip(reason="CadQuery is not installed: pip install '.[cadquery]'"))
