"""Public functions have numpydoc docstrings: every parameter, what is returned, an example that runs (numpydoc, doctest)."""

from __future__ import annotations

import doctest
import types
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpydoc.docscrape import get_doc_object
from numpydoc.validate import validate

import tpmscad
from tpmscad import fields

PUBLIC = (
    "tpmscad",
    "tpmscad.blending",
    "tpmscad.fields",
    "tpmscad.maps",
    "tpmscad.splines",
    "tpmscad.surfaces",
    "tpmscad.topology",
    "tpmscad.build123d",
    "cq_plugins.tpms",
)
"""Modules whose `__all__` is public; without one, the functions that they define."""

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
        own = [
            name
            for name, value in vars(home).items()
            if getattr(value, "__module__", None) == module and name[0] != "_"
        ]
        for name in getattr(home, "__all__", own):
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


@pytest.mark.kernel
def test_examples_of_public_functions_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    finder = doctest.DocTestFinder(recurse=False, exclude_empty=True)
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    for name, function in public_functions():
        for test in finder.find(function, name, globs={"np": np, "tpmscad": tpmscad, "fields": fields}):
            runner.run(test, out=said.append)
    assert runner.tries > 0
    assert not runner.failures, "".join(said)


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
