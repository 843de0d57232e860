"""The folder's own modules (complexes made by hand, a Part 21 parser) and those of patches can be imported by its tests.

Without the kernel's tests (-m "not kernel") none of its files is opened, so that OCP is not loaded either.
"""

import sys
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "patches")]


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    return True if "not kernel" in config.option.markexpr else None
