"""The wheels that bring the CAD kernel: two of them write the same module `OCP`, and of two versions only one is there.

CadQuery depends on `cadquery-ocp`, build123d on `cadquery-ocp-novtk`. pip takes them for unrelated, so that the one installed
last overwrites files of the other; if the versions differ, what is imported is a mixture, or the older kernel under a library for
the newer one. Only the names of folders of metadata are read here: `importlib.metadata` would take 40 ms of every import.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable, Mapping

WHEELS = ("cadquery-ocp", "cadquery-ocp-novtk")
"""Distributions that hold the module OCP, with and without VTK."""

CADQUERY = "cadquery"

WITH_CADQUERY = "pip install 'build123d==0.12.*' 'cadquery==2.8.*'"
WITHOUT_CADQUERY = "pip install build123d"
"""What installs one kernel again: build123d 0.12 and CadQuery 2.8 share OCCT 7.9."""

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


def describe_conflict(installed: Mapping[str, str]) -> str:
    """What is wrong with the wheels of the kernel, and the two lines that mend it; "" if nothing is."""
    wheels = {name: installed[name] for name in WHEELS if name in installed}
    if len(set(wheels.values())) < 2:
        return ""
    named = " and ".join(f"{name} {number}" for name, number in wheels.items())
    return (
        f"two CAD kernels are installed over each other, {named}: both write the module OCP, so that imports fail or shapes "
        f"break. These two lines mend it:\n"
        f"    pip uninstall -y {' '.join(WHEELS)}\n"
        f"    {WITH_CADQUERY if CADQUERY in installed else WITHOUT_CADQUERY}"
    )


def warn_of_conflict() -> None:
    """Warn if two kernels are installed over each other; Python shows a warning of one place once."""
    if conflict := describe_conflict(find_installed_versions()):
        warnings.warn(f"{conflict}\n`tpmscad doctor` shows what is installed", stacklevel=3)
