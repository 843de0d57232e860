"""The wheels that bring the CAD kernel: two of them write the same module `OCP`, and of two versions only one is there.

CadQuery depends on `cadquery-ocp`, build123d on `cadquery-ocp-novtk`. pip takes them for unrelated, so that the one installed
last overwrites files of the other. If the versions differ, what is imported is a mixture, or the older kernel under a library for
the newer one; if they are the same, the one without VTK, installed last, lacks what CadQuery imports. Only names and sizes of
files are read here: `importlib.metadata` would take 40 ms of every import.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable, Mapping
from glob import escape, glob

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

_LIBRARY = re.compile(r"OCP/OCP[^,]*\.(so|pyd|dylib),")
_METADATA = re.compile(r"(cadquery(?:_ocp(?:_novtk)?)?)-([^-]+)\.dist-info")


def find_installed_versions(folders: Iterable[str] | None = None) -> dict[str, str]:
    """The versions of CadQuery and of the wheels of the kernel in the folders, by default of `sys.path`; the first counts."""
    found: dict[str, str] = {}
    for folder in sys.path if folders is None else folders:
        try:
            names = os.listdir(folder or ".")
        except OSError:
            continue
        for match in filter(None, map(_METADATA.fullmatch, names)):
            found.setdefault(match[1].replace("_", "-"), match[2])
    return found


def is_overwritten(folders: Iterable[str] | None = None) -> bool:
    """Whether the library of `cadquery-ocp`, which is installed, is another one in place of its own, told by its size."""
    for folder in sys.path if folders is None else folders:
        for record in glob(os.path.join(escape(folder or "."), "cadquery_ocp-*.dist-info", "RECORD")):
            with open(record, encoding="utf-8") as lines:
                library = next((line for line in lines if _LIBRARY.match(line)), None)
            if library is not None:
                name, _, size = library.rstrip().rsplit(",", 2)
                path = os.path.join(folder or ".", name)
                return not os.path.isfile(path) or os.path.getsize(path) != int(size)
    return False


def describe_conflict(installed: Mapping[str, str], overwritten: bool = False) -> str:
    """What is wrong with the wheels of the kernel, and the two lines that mend it; "" if nothing is."""
    wheels = {name: installed[name] for name in WHEELS if name in installed}
    has_cadquery = CADQUERY in installed
    if len(wheels) < 2 or (len(set(wheels.values())) == 1 and not (overwritten and has_cadquery)):
        return ""
    named = " and ".join(f"{name} {number}" for name, number in wheels.items())
    what = "imports fail or shapes break" if len(set(wheels.values())) > 1 else "CadQuery misses what needs VTK"
    mend = "\n    ".join(WITH_CADQUERY if has_cadquery else WITHOUT_CADQUERY)
    return (
        f"two CAD kernels are installed over each other, {named}: both write the module OCP, so that {what}. "
        f"These two lines mend it:\n    {mend}"
    )


def find_conflict() -> str:
    """`describe_conflict` of this environment."""
    installed = find_installed_versions()
    return describe_conflict(installed, len(installed) == len(WHEELS) + 1 and is_overwritten())


def warn_of_conflict() -> None:
    """Warn if two kernels are installed over each other; Python shows a warning of one place once."""
    if conflict := find_conflict():
        warnings.warn(f"{conflict}\n`tpmscad doctor` shows what is installed", stacklevel=3)
