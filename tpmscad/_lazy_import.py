"""Packages whose public names are imported at their first use (PEP 562).

The public functions need the CAD kernel, which takes seconds to load. A package that lists its names with `lazy_attributes`
loads a module only when one of its names is used:

    __getattr__, __dir__ = lazy_attributes(__name__, {"lattice": "tpmscad.workflows.lattice_solid"})
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from tpmscad.errors import InvalidRequest


def lazy_attributes(
    package: str, module_of_name: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a package whose names come from other modules.

    `module_of_name` maps each public name to the module that defines it, and the name of a public module to its dotted path.
    """

    def __getattr__(name: str) -> Any:
        if name not in module_of_name:
            near = get_close_matches(name, module_of_name, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        module = import_module(module_of_name[name])
        value = module if module_of_name[name].endswith(f".{name}") else getattr(module, name)
        setattr(sys.modules[package], name, value)
        return value

    def __dir__() -> list[str]:
        return sorted(module_of_name)

    return __getattr__, __dir__


def import_extra(module: str, what: str, extra: str) -> Any:
    """A package that only an extra of tpmscad installs; InvalidRequest that names the extra if it is missing."""
    try:
        return import_module(module)
    except (ImportError, OSError) as error:  # OSError: gmsh without the libraries of the system that it links
        raise InvalidRequest(f'{what} need {module}: pip install "tpmscad[{extra}]" ({error})') from error
