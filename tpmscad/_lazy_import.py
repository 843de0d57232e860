"""Packages whose public names are imported at their first use (PEP 562).

The public functions need the CAD kernel, which takes seconds to load. A package lists its names once, in the stub beside its
source, which type checkers read as well (scientific Python's SPEC 1), here with absolute imports:

    __getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Any

from tpmscad.errors import InvalidRequest


def attach_stub(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """The `__getattr__`, `__dir__` and `__all__` of a module whose names come from other modules, as its stub lists them."""
    homes = {
        alias.asname or alias.name: (node.module, alias.name)
        for node in ast.parse(Path(file).with_suffix(".pyi").read_text("utf-8")).body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    names = sorted(homes)

    def __getattr__(name: str) -> Any:
        if name not in homes:
            near = get_close_matches(name, names, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        home, original = homes[name]
        value = import_module(f"{home}.{original}") if home == package else getattr(import_module(home), original)
        setattr(sys.modules[package], name, value)
        return value

    return __getattr__, lambda: names, names


def import_extra(module: str, what: str, extra: str, package: str | None = None) -> Any:
    """A module that only an extra of tpmscad installs; InvalidRequest that names its package and the extra if it is missing."""
    try:
        return import_module(module)
    except (ImportError, OSError) as error:  # OSError: gmsh without the libraries of the system that it links
        needed = f"for {what} tpmscad needs {package or module}: pip install 'tpmscad[{extra}]' ({error})"
        raise InvalidRequest(needed) from error
