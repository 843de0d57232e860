"""The wheels that bring the CAD kernel: two of them write the same module `OCP`, and of two versions only one is there.

CadQuery depends on `cadquery-ocp`, build123d on `cadquery-ocp-novtk`. pip takes them for unrelated, so that the one installed
last overwrites files of the other, and the one removed takes the other's files along. If the versions differ, what is imported is
a mixture, or the older kernel under a library for the newer one; if they are the same, the one without VTK, installed last, lacks
what CadQuery imports. Only names and sizes of files are read here: `importlib.metadata` would take 40 ms of every import.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import PurePath

from tpmscad.errors import KernelConflictWarning, MissingKernel

WHEELS = ("cadquery-ocp", "cadquery-ocp-novtk")
"""Distributions that hold the module OCP, with and without VTK."""

CADQUERY = "cadquery"

WITH_CADQUERY = (
    "pip install 'build123d==0.12.*' 'cadquery==2.8.*'",
    "pip install --force-reinstall --no-deps 'cadquery-ocp==7.9.3.*'",
)
"""What installs one kernel for both, OCCT 7.9: the wheel with VTK last, since it holds all that the other holds."""

WITHOUT_CADQUERY = (f"pip uninstall -y {' '.join(WHEELS)}", "pip install build123d")
"""What installs one kernel for build123d alone."""

INSTALL_LIBGL = "apt-get install libgl1"
"""What installs the library of the system that the kernel links."""

DOCTOR = "doctor"
"""The command that tells a conflict among its findings."""

_CHECKED = re.compile(r"^(OCP/(?:OCP[^,\n]*\.(?:so|pyd|dylib)|__init__\.py)),[^,\n]*,(\d*)", re.MULTILINE)
_METADATA = re.compile(r"(cadquery(?:_ocp(?:_novtk)?)?)-([^-]+)\.dist-info")

Metadata = tuple[str, str, str]
"""The version of a distribution, the folder that holds it, and the name of the folder of its metadata."""


def find_installed_versions(folders: Iterable[str] | None = None) -> dict[str, str]:
    """The versions of CadQuery and of the wheels of the kernel in the folders, by default of `sys.path`; the first counts."""
    return _versions(_find_metadata(folders))


def find_overwritten_wheels(folders: Iterable[str] | None = None) -> list[str]:
    """The installed wheels of the kernel whose library is missing, or another one in place of their own, told by its size."""
    return _overwritten(_find_metadata(folders))


def _versions(found: Mapping[str, Metadata]) -> dict[str, str]:
    return {name: number for name, (number, _, _) in found.items()}


def _overwritten(found: Mapping[str, Metadata]) -> list[str]:
    return [name for name in WHEELS if name in found and not _holds_its_files(*found[name][1:])]


def _find_metadata(folders: Iterable[str] | None) -> dict[str, Metadata]:
    """The metadata of each distribution; the first folder that has it counts."""
    found: dict[str, Metadata] = {}
    for folder in sys.path if folders is None else folders:
        try:
            names = os.listdir(folder or ".")
        except OSError:
            continue
        for match in filter(None, map(_METADATA.fullmatch, names)):
            found.setdefault(match[1].replace("_", "-"), (match[2], folder, match[0]))
    return found


def _holds_its_files(folder: str, metadata: str) -> bool:
    """Whether the library of a wheel and the module that loads it have the sizes in the wheel's record; True without a record."""
    try:
        with open(os.path.join(folder, metadata, "RECORD"), encoding="utf-8", errors="replace") as record:
            checked = _CHECKED.findall(record.read())
    except OSError:
        return True
    return all(_is_file_of_size(os.path.join(folder, name), size) for name, size in checked)


def _is_file_of_size(path: str, size: str) -> bool:
    return os.path.isfile(path) and (not size or os.path.getsize(path) == int(size))


def describe_conflict(installed: Mapping[str, str], overwritten: Collection[str] = ()) -> str:
    """What is wrong with the wheels of the kernel, and the two lines that fix it; "" if nothing is.

    `overwritten` are the wheels whose library is not their own.
    """
    wheels = {name: installed[name] for name in WHEELS if name in installed}
    named = " and ".join(f"{name} {number}" for name, number in wheels.items())
    if len(set(wheels.values())) > 1:
        what = f"{_over_each_other(named)}, so that imports fail or shapes break"
    elif wheels and all(name in overwritten for name in wheels):
        what = (
            f"the CAD kernel is damaged: the module OCP lacks files of {named}, or holds another wheel's in their place, "
            "as after one of two wheels was removed"
        )
    elif len(wheels) > 1 and WHEELS[0] in overwritten and CADQUERY in installed:
        what = f"{_over_each_other(named)}, so that CadQuery misses what needs VTK"
    else:
        return ""
    return f"{what}. {_remedy_in_two_lines(installed)}"


def _over_each_other(named: str) -> str:
    return f"two CAD kernels are installed over each other, {named}: both write the module OCP"


def choose_remedy(installed: Mapping[str, str]) -> tuple[str, str]:
    """The two lines that install one kernel in an environment with, or without, CadQuery."""
    return WITH_CADQUERY if CADQUERY in installed else WITHOUT_CADQUERY


def _remedy_in_two_lines(installed: Mapping[str, str]) -> str:
    return "\n    ".join(("These two lines fix it:", *choose_remedy(installed)))


def find_conflict(folders: Iterable[str] | None = None) -> str:
    """`describe_conflict` of the folders, by default of this environment."""
    found = _find_metadata(folders)
    return describe_conflict(_versions(found), _overwritten(found))


def describe_load_failure(what: str, reason: str, remedy: Sequence[str]) -> str:
    """Why the kernel, or a library above it, does not load, and what to do, in one line."""
    fix = INSTALL_LIBGL if "libGL" in reason else " && ".join(remedy)
    return f"{what} does not load ({reason}); this fixes it: {fix}"


@contextmanager
def explained_load_failure(what: str, remedy: Sequence[str] = ()) -> Iterator[None]:
    """Imports of the kernel, or of a library above it, that fail by MissingKernel; `remedy` as `choose_remedy` by default."""
    try:
        yield
    except ImportError as error:
        if error.name == CADQUERY:  # not installed, as without its extra: no fault of the kernel
            raise
        lines = remedy or choose_remedy(find_installed_versions())
        raise MissingKernel(describe_load_failure(what, str(error), lines)) from error


def warn_of_conflict() -> None:
    """Warn if two kernels are installed over each other, or one is damaged; Python shows a warning of one place once.

    `tpmscad doctor` tells it among its findings, and only there.
    """
    if any(PurePath(program).stem == "tpmscad" and word == DOCTOR for program, word in pairwise(sys.orig_argv)):
        return
    if conflict := find_conflict():
        warnings.warn(f"{conflict}\n`tpmscad doctor` shows what is installed", KernelConflictWarning, stacklevel=3)
