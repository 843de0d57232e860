"""Public functions have numpydoc docstrings: every parameter, what is returned, an example (numpydoc's own validation)."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

import pytest
from numpydoc.docscrape import get_doc_object
from numpydoc.validate import validate

PUBLIC = (
    "tpmscad",
    "tpmscad.blending",
    "tpmscad.fields",
    "tpmscad.lattices.maps",
    "tpmscad.splines",
    "tpmscad.surfaces",
    "tpmscad.topology",
    "tpmscad.build123d",
    "cq_plugins.tpms",
)
"""Modules whose `__all__` is public."""

CHECKS = {
    "GL08": "has no docstring",
    "SS01": "has no summary",
    "SS03": "has a summary that does not end with a period",
    "PR01": "leaves parameters out",
    "PR02": "documents parameters that it does not have",
    "RT01": "has no section Returns",
    "EX01": "has no example",
}


def public_functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """The functions in the lists of public names, each once, and methods of public classes."""
    seen: set[int] = set()
    for module in PUBLIC:
        try:
            home = import_module(module)
        except ModuleNotFoundError as error:
            if error.name not in ("cadquery",):
                raise
            continue
        for name in home.__all__:
            value = getattr(home, name)
            if isinstance(value, types.FunctionType) and id(value) not in seen:
                seen.add(id(value))
                yield f"{module}.{name}", value


def faults(function: Callable[..., Any]) -> list[str]:
    """What numpydoc finds wrong, of the checks above."""
    found = validate(get_doc_object(function))["errors"]
    return [f"{CHECKS[code]}: {text}" for code, text in found if code in CHECKS]


@pytest.mark.kernel
def test_public_functions_have_complete_docstrings() -> None:
    wrong = {name: said for name, function in public_functions() if (said := faults(function))}
    assert not wrong, "\n" + "\n".join(f"{name}: {'; '.join(said)}" for name, said in wrong.items())


def test_an_incomplete_docstring_is_noticed() -> None:
    def undocumented(points, level=0.0):
        """Values at the points.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points.
        """
        return points + level

    said = " ".join(faults(undocumented))
    assert all(CHECKS[code] in said for code in ("PR01", "RT01", "EX01"))
