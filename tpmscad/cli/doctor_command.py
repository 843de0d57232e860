"""tpmscad doctor: what is installed, whether the kernel loads, where compiled functions are kept, and what is wrong."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import typer

from tpmscad.kernel_wheels import (
    CADQUERY,
    WHEELS,
    choose_remedy,
    describe_load_failure,
    find_conflict,
    find_installed_versions,
)
from tpmscad.memory_limit import format_bytes, physical_memory

LIBRARIES = (
    "build123d",
    CADQUERY,
    "numpy",
    "scipy",
    "numba",
    "gudhi",
    "gmsh",
    "scikit-fem",
    "pynrrd",
    "nibabel",
    "simpleitk",
    "tifffile",
    "mrcfile",
    "vtk",
    "trimesh",
)
"""Libraries whose versions are told; those of extras may be absent."""

LOAD_SECONDS = 120
"""Longest time that the kernel may take to load."""

CACHE_SUFFIXES = (".nbi", ".nbc")
"""Of the files in which numba keeps compiled functions."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print everything as JSON.")]


def doctor(as_json: JsonOption = False) -> None:
    """Show versions, kernel, cache, cores and memory; exit status 1 if something is wrong, with the line that fixes it."""
    import tpmscad

    installed = find_installed_versions()
    loaded, fault = _load("import OCP.gp; print(OCP.__version__)")
    cache, cache_fault = _load("import tpmscad._compiled_loops as c; print(c.cache_folder() or '')")
    stated = next((installed[name] for name in WHEELS if name in installed), loaded)
    if loaded and not stated.startswith(loaded):
        fault = f"it is OCCT {loaded}, its wheel is {stated}"
    problems = [find_conflict() or _explain("the CAD kernel", fault, installed), cache_fault]
    if not problems[0]:
        problems.append(_explain("build123d", _load("import build123d")[1], installed))
        problems.append(_explain("CadQuery", _load("import cadquery")[1] if CADQUERY in installed else "", installed))
    facts: dict[str, Any] = {
        "tpmscad": f"{tpmscad.__version__} in {Path(tpmscad.__file__).parent}",
        "python": f"{platform.python_version()} in {sys.prefix}, {platform.platform()}",
        "kernel": f"OCCT {loaded}" if loaded else "does not load",
        "wheels": ", ".join(f"{name} {installed[name]}" for name in WHEELS if name in installed) or "none",
        "libraries": ", ".join(f"{name} {found}" for name in LIBRARIES if (found := _find_version(name))),
        "cache": _describe_cache(cache) if cache else "none",
        "cores": f"{len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()}, "
        f"OMP_NUM_THREADS {os.environ.get('OMP_NUM_THREADS', 'not set')}",
        "memory": format_bytes(physical_memory()),
        "problems": [problem for problem in problems if problem],
    }
    if as_json:
        print(json.dumps(facts, indent=2))
    else:
        for name, fact in facts.items():
            if name != "problems":
                print(f"{name:<11} {fact}")
    if facts["problems"]:
        print("\n".join(facts["problems"]), file=sys.stderr)
        raise typer.Exit(1)
    if not as_json:
        print("all is well")


def _load(statements: str) -> tuple[str, str]:
    """The last line that statements print in an interpreter of their own, or "" and what went wrong."""
    command = [sys.executable, "-W", "ignore", "-c", statements]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=LOAD_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return "", f"it did not load within {LOAD_SECONDS} s"
    if answer.returncode:
        lines = answer.stderr.strip().splitlines() or [f"it ended with status {answer.returncode}"]
        return "", lines[-1]
    return (answer.stdout.strip().splitlines() or [""])[-1], ""


def _explain(what: str, fault: str, installed: Mapping[str, str]) -> str:
    """Why something does not load, and what to do; "" without a fault."""
    return fault and describe_load_failure(what, fault, choose_remedy(installed))


def _find_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _describe_cache(folder: str) -> str:
    """The folder of compiled functions, with the number and the size of its files."""
    files = [path for path in Path(folder).rglob("*") if path.suffix in CACHE_SUFFIXES]
    size = sum(path.stat().st_size for path in files)
    return f"{len(files)} files of compiled functions, {format_bytes(size)}, in {folder}"
