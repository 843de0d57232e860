"""Two wheels of the kernel over each other: noticed at import and by `tpmscad doctor`, with the lines that mend it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tpmscad.kernel_wheels import (
    WITH_CADQUERY,
    WITHOUT_CADQUERY,
    describe_conflict,
    find_installed_versions,
    is_overwritten,
)

ROOT = Path(__file__).resolve().parents[1]


def install(folder: Path, *names: str) -> Path:
    """A folder with the metadata of distributions, such as "cadquery_ocp-7.9.3.1.1"."""
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / f"{name}.dist-info").mkdir()
    return folder


def run(*command: str, path: Path) -> subprocess.CompletedProcess[str]:
    """A command of the package with a folder before all others on the path."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(path), str(ROOT)])}
    return subprocess.run(
        [sys.executable, *command], env=environment, cwd=path, capture_output=True, text=True, check=False
    )


def test_versions_are_read_from_the_names_of_the_metadata(tmp_path: Path) -> None:
    first = install(tmp_path / "a", "cadquery_ocp_novtk-8.0.1.1.0", "numpy-2.4.6")
    second = install(tmp_path / "b", "cadquery_ocp_novtk-7.9.3.1.1", "cadquery-2.8.0", "cadquery_ocp_proxy-8.0.1.1.0")
    assert find_installed_versions([str(first), "", str(tmp_path / "none"), str(second)]) == {
        "cadquery-ocp-novtk": "8.0.1.1.0",
        "cadquery": "2.8.0",
    }


@pytest.mark.parametrize(
    ("installed", "mends"),
    [
        ({}, None),
        ({"cadquery-ocp-novtk": "8.0.1.1.0"}, None),
        ({"cadquery-ocp": "7.9.3.1.1", "cadquery-ocp-novtk": "7.9.3.1.1", "cadquery": "2.8.0"}, None),
        ({"cadquery-ocp": "7.9.3.1.1", "cadquery-ocp-novtk": "8.0.1.1.0", "cadquery": "2.8.0"}, WITH_CADQUERY),
        ({"cadquery-ocp": "7.9.3.1.1", "cadquery-ocp-novtk": "8.0.1.1.0"}, WITHOUT_CADQUERY),
    ],
)
def test_two_versions_are_a_conflict_and_one_is_none(installed: dict[str, str], mends: tuple[str, str] | None) -> None:
    found = describe_conflict(installed)
    assert bool(found) == bool(mends)
    if mends:
        lines = found.splitlines()
        assert tuple(line.strip() for line in lines[1:]) == mends
        assert all(f"{name} {number}" in lines[0] for name, number in installed.items() if name != "cadquery")


def test_the_wheel_without_vtk_over_the_other_of_the_same_version_is_noticed(tmp_path: Path) -> None:
    names = "cadquery_ocp-7.9.3.1.1", "cadquery_ocp_novtk-7.9.3.1.1", "cadquery-2.8.0"
    folder = install(tmp_path, *names)
    library = folder / "OCP" / "OCP.cpython-311.so"
    library.parent.mkdir()
    library.write_bytes(b"with VTK")
    record = folder / f"{names[0]}.dist-info" / "RECORD"
    record.write_text("OCP/__init__.py,sha256=x,55\nOCP/OCP.cpython-311.so,sha256=y,8\n")
    assert not is_overwritten([str(folder)])
    library.write_bytes(b"without it")
    assert is_overwritten([str(folder)])
    installed = find_installed_versions([str(folder)])
    assert describe_conflict(installed, False) == ""
    assert "CadQuery misses what needs VTK" in describe_conflict(installed, True)
    assert describe_conflict({name: of for name, of in installed.items() if name != "cadquery"}, True) == ""


def test_a_conflict_is_told_once_at_import(tmp_path: Path) -> None:
    folder = install(tmp_path, "cadquery_ocp-1.2.3.4", "cadquery_ocp_novtk-5.6.7.8")
    found = run("-c", "import tpmscad\nimport tpmscad.errors", path=folder)
    assert found.stderr.count("two CAD kernels are installed over each other") == 1
    assert found.returncode == 0


@pytest.mark.kernel
def test_the_doctor_tells_what_is_installed_and_what_is_wrong(tmp_path: Path) -> None:
    well = run("-m", "tpmscad", "doctor", "--json", path=install(tmp_path / "well"))
    facts = json.loads(well.stdout)
    assert (well.returncode, facts["problems"]) == (0, [])
    assert facts["kernel"].startswith("OCCT ")
    assert "numpy" in facts["libraries"]
    ill = run("-m", "tpmscad", "doctor", path=install(tmp_path / "ill", "cadquery_ocp-1.2.3", "cadquery_ocp_novtk-4.5"))
    assert ill.returncode == 1
    assert "two CAD kernels are installed over each other" in ill.stderr
    assert "\n    pip uninstall -y cadquery-ocp cadquery-ocp-novtk\n" in ill.stderr


@pytest.mark.kernel
def test_the_doctor_answers_without_a_kernel(tmp_path: Path) -> None:
    (tmp_path / "OCP.py").write_text("raise ImportError('undefined symbol: TopoDS')")
    found = run("-m", "tpmscad", "doctor", path=tmp_path)
    assert found.returncode == 1
    assert "does not load (ImportError: undefined symbol: TopoDS)" in found.stderr
    assert "Traceback" not in found.stderr
