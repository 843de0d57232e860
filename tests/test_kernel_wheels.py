"""A kernel that is missing, damaged or installed twice: told at import and by `tpmscad doctor`, with the line that fixes it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tpmscad.errors import KernelConflictWarning, MissingKernel
from tpmscad.kernel_wheels import (
    INSTALL_LIBGL,
    WHEELS,
    WITH_CADQUERY,
    WITHOUT_CADQUERY,
    choose_remedy,
    describe_conflict,
    describe_load_failure,
    find_conflict,
    find_installed_versions,
    find_overwritten_wheels,
)

ROOT = Path(__file__).resolve().parents[1]

REMEDY = choose_remedy(find_installed_versions())
"""The lines for this environment, with or without CadQuery."""


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
    ("installed", "remedy"),
    [
        ({}, None),
        ({"cadquery-ocp-novtk": "8.0.1.1.0"}, None),
        ({"cadquery-ocp": "7.9.3.1.1", "cadquery-ocp-novtk": "7.9.3.1.1", "cadquery": "2.8.0"}, None),
        ({"cadquery-ocp": "7.9.3.1.1", "cadquery-ocp-novtk": "8.0.1.1.0", "cadquery": "2.8.0"}, WITH_CADQUERY),
        ({"cadquery-ocp": "7.9.3.1.1", "cadquery-ocp-novtk": "8.0.1.1.0"}, WITHOUT_CADQUERY),
    ],
)
def test_two_versions_are_a_conflict_and_one_is_none(installed: dict[str, str], remedy: tuple[str, str] | None) -> None:
    found = describe_conflict(installed)
    assert bool(found) == bool(remedy)
    if remedy:
        lines = found.splitlines()
        assert tuple(line.strip() for line in lines[1:]) == remedy
        assert all(f"{name} {number}" in lines[0] for name, number in installed.items() if name != "cadquery")


def write_wheel(folder: Path, name: str, content: bytes) -> Path:
    """The metadata of a wheel of the kernel and its files, which overwrite those of another; the library."""
    install(folder, name)
    library, loader = folder / "OCP" / "OCP.cpython-311.so", folder / "OCP" / "__init__.py"
    library.parent.mkdir(exist_ok=True)
    library.write_bytes(content)
    loader.write_bytes(b"from OCP.OCP import *")
    written = ",".join([library.relative_to(folder).as_posix(), "sha256=y", str(len(content))])
    record = f"OCP/gp/__init__.py,sha256=x,31\n{written}\nOCP/__init__.py,sha256=z,21\n{name}.dist-info/RECORD,,\n"
    (folder / f"{name}.dist-info" / "RECORD").write_text(record)
    return library


def test_the_wheel_without_vtk_over_the_other_of_the_same_version_is_noticed(tmp_path: Path) -> None:
    last = tmp_path / "with VTK last"
    write_wheel(last, "cadquery_ocp_novtk-7.9.3.1.1", b"without it")
    write_wheel(last, "cadquery_ocp-7.9.3.1.1", b"with VTK")
    assert find_overwritten_wheels([str(last)]) == ["cadquery-ocp-novtk"]
    first = tmp_path / "with VTK first"
    write_wheel(first, "cadquery_ocp-7.9.3.1.1", b"with VTK")
    write_wheel(first, "cadquery_ocp_novtk-7.9.3.1.1", b"without it")
    assert find_overwritten_wheels([str(first)]) == ["cadquery-ocp"]
    assert find_conflict([str(last)]) == find_conflict([str(first)]) == ""
    for folder in last, first:
        install(folder, "cadquery-2.8.0")
    assert find_conflict([str(last)]) == ""
    assert "CadQuery misses what needs VTK" in find_conflict([str(first)])


@pytest.mark.parametrize("name", WHEELS)
def test_a_wheel_whose_library_is_not_its_own_is_damaged(tmp_path: Path, name: str) -> None:
    library = write_wheel(tmp_path, f"{name.replace('-', '_')}-8.0.1.1.0", b"its own")
    folders = ["", str(tmp_path / "none"), str(tmp_path)]
    assert find_conflict(folders) == ""
    library.write_bytes(b"another's")
    replaced = find_conflict(folders)
    library.unlink()
    assert find_conflict(folders) == replaced
    assert f"lacks files of {name} 8.0.1.1.0, or holds another wheel's" in replaced
    assert tuple(line.strip() for line in replaced.splitlines()[1:]) == WITHOUT_CADQUERY
    install(tmp_path, "cadquery-2.8.0")
    assert tuple(line.strip() for line in find_conflict(folders).splitlines()[1:]) == WITH_CADQUERY


def test_a_wheel_without_the_module_that_loads_its_library_is_damaged(tmp_path: Path) -> None:
    library = write_wheel(tmp_path, "cadquery_ocp-7.9.3.1.1", b"its own")
    library.with_name("__init__.py").unlink()
    assert "the CAD kernel is damaged" in find_conflict([str(tmp_path)])


def test_two_wheels_of_one_version_are_damaged_if_the_library_is_neither_ones(tmp_path: Path) -> None:
    for name in ("cadquery_ocp-7.9.3.1.1", "cadquery_ocp_novtk-7.9.3.1.1"):
        library = write_wheel(tmp_path, name, name.encode())
    library.unlink()
    assert "lacks files of cadquery-ocp 7.9.3.1.1 and cadquery-ocp-novtk 7.9.3.1.1" in find_conflict([str(tmp_path)])


def test_a_wheel_without_a_record_of_its_files_is_not_called_damaged(tmp_path: Path) -> None:
    assert find_conflict([str(install(tmp_path, "cadquery_ocp-7.9.3.1.1"))]) == ""


CONFLICT = "two CAD kernels are installed over each other"

RECORD_OF_WARNINGS = """
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    import tpmscad
    import tpmscad.errors
(told,) = caught
assert told.filename == "<string>"  # the line that imports
print(told.category is tpmscad.KernelConflictWarning, told.message)
"""


def test_a_conflict_is_told_once_at_import_by_a_warning_of_its_own(tmp_path: Path) -> None:
    found = run("-c", RECORD_OF_WARNINGS, path=install(tmp_path, "cadquery_ocp-1.2.3.4", "cadquery_ocp_novtk-5.6.7.8"))
    assert found.returncode == 0, found.stderr
    assert found.stdout.startswith(f"True {CONFLICT}")
    assert issubclass(KernelConflictWarning, UserWarning)  # as filters of user warnings expect


def test_a_damaged_wheel_is_told_at_import(tmp_path: Path) -> None:
    for name in ("cadquery_ocp", "cadquery_ocp_novtk"):  # both, as one may be installed beside CadQuery
        write_wheel(tmp_path / "site", f"{name}-8.0.1.1.0", b"its own").unlink()
    found = run("-c", "import tpmscad", path=tmp_path / "site")
    assert (found.returncode, found.stderr.count("the CAD kernel is damaged")) == (0, 1)


ABSENT, UNLOADABLE, EMPTY = (
    ("raise ModuleNotFoundError(\"No module named 'OCP'\", name='OCP')", "No module named 'OCP'"),
    ("raise ImportError('undefined symbol: TopoDS')", "undefined symbol: TopoDS"),
    ("", "No module named 'OCP.gp'; 'OCP' is not a package"),  # nothing but a name is left
)
"""Modules OCP, and why they do not load."""


@pytest.mark.parametrize(
    ("statement", "module", "reason"),
    [
        ("import tpmscad; tpmscad.lattice", *ABSENT),
        ("import tpmscad; tpmscad.lattice", *UNLOADABLE),
        ("import tpmscad; tpmscad.lattice", *EMPTY),
        ("import tpmscad.build123d", *UNLOADABLE),
        ("import tpmscad.kernel.step.part21", *UNLOADABLE),
    ],
)
def test_a_kernel_that_does_not_load_is_one_error_that_names_the_remedy(
    tmp_path: Path, statement: str, module: str, reason: str
) -> None:
    (tmp_path / "OCP.py").write_text(module)
    install(tmp_path, "cadquery-2.8.0")
    found = run("-c", statement, path=tmp_path)
    last = found.stderr.splitlines()[-1]
    remedy = " && ".join(WITH_CADQUERY)
    assert last == f"tpmscad.errors.MissingKernel: the CAD kernel does not load ({reason}); this fixes it: {remedy}"
    assert issubclass(MissingKernel, ImportError)  # as guards of optional imports expect


def test_the_command_line_tells_in_one_line_that_the_kernel_does_not_load(tmp_path: Path) -> None:
    (tmp_path / "OCP.py").write_text("raise ImportError('undefined symbol: TopoDS')")
    found = run("-m", "tpmscad", "lattice", "P", "--cell", "1", "--thickness", "0.1", "-o", "p.step", path=tmp_path)
    assert found.returncode == 1
    assert found.stderr == (
        f"tpmscad: the CAD kernel does not load (undefined symbol: TopoDS); this fixes it: {' && '.join(REMEDY)}\n"
    )
    assert not list(tmp_path.glob("p.step*"))


BROKEN_BUILD123D = "raise ImportError('cannot import name TColgp')"

WITHOUT_BUILD123D = """
import tpmscad
from tpmscad.errors import MissingKernel
model = tpmscad.lattice("P", cell=1, thickness=0.1, tol=0.02, progress=None)
model.export_step("p.step")
for use in (lambda: model.solid, lambda: __import__("tpmscad.build123d")):
    try:
        use()
    except MissingKernel as error:
        print(f"{type(error).__name__}: {error}")
"""


@pytest.mark.kernel
@pytest.mark.slow
def test_a_step_file_needs_no_build123d_and_its_failure_is_one_error(tmp_path: Path) -> None:
    (tmp_path / "build123d.py").write_text(BROKEN_BUILD123D)
    found = run("-c", WITHOUT_BUILD123D, path=tmp_path)
    assert (found.returncode, found.stderr) == (0, "")
    assert (tmp_path / "p.step").exists()
    errors = found.stdout.splitlines()
    assert len(errors) == 2
    for error in errors:
        assert error.startswith("MissingKernel: build123d does not load (cannot import name TColgp); this fixes")
        assert error.endswith(" && ".join(REMEDY))


IMPORT_TWICE = """
import os
for reason in ("ImportError('no VTK')", "ModuleNotFoundError(\\"No module named 'cadquery'\\", name='cadquery')"):
    os.environ["REASON"] = reason
    try:
        import cq_plugins.tpms
    except ImportError as error:
        print(f"{type(error).__name__}: {error}")
"""


@pytest.mark.kernel
def test_only_a_cadquery_that_is_there_and_does_not_load_is_fixed_by_the_lines_for_cadquery(tmp_path: Path) -> None:
    (tmp_path / "cadquery.py").write_text("import os\nraise eval(os.environ['REASON'])")
    assert run("-c", IMPORT_TWICE, path=tmp_path).stdout.splitlines() == [
        f"MissingKernel: CadQuery does not load (no VTK); this fixes it: {' && '.join(WITH_CADQUERY)}",
        "ModuleNotFoundError: No module named 'cadquery'",
    ]


@pytest.mark.parametrize("remedy", [WITH_CADQUERY, WITHOUT_CADQUERY])
def test_the_guide_prints_the_lines_that_messages_name(remedy: tuple[str, str]) -> None:
    guide = (ROOT / "docs" / "guide" / "install.md").read_text(encoding="utf-8")
    assert "\n".join(("```sh", *remedy, "```")) in guide


def test_a_missing_library_of_the_system_is_no_fault_of_the_wheels() -> None:
    found = describe_load_failure("the CAD kernel", "libGL.so.1: cannot open shared object file", WITH_CADQUERY)
    assert found.endswith(f"this fixes it: {INSTALL_LIBGL}")


@pytest.mark.kernel
def test_the_doctor_tells_what_is_installed_and_what_is_wrong(tmp_path: Path) -> None:
    well = run("-m", "tpmscad", "doctor", "--json", path=install(tmp_path / "well"))
    facts = json.loads(well.stdout)
    assert (well.returncode, facts["problems"]) == (0, [])
    assert facts["kernel"].startswith("OCCT ")
    assert "numpy" in facts["libraries"]


@pytest.mark.kernel
def test_the_doctor_tells_a_conflict_once_and_other_commands_warn_of_it(tmp_path: Path) -> None:
    folder = install(tmp_path / "ill", "cadquery_ocp-1.2.3", "cadquery_ocp_novtk-4.5")
    script = folder / "tpmscad"  # as pip writes it
    script.write_text("from tpmscad.cli import main\nmain()\n")
    (folder / "OCP.py").write_text("raise ImportError('undefined symbol: TopoDS')")  # a kernel that loads takes seconds
    for program in (["-m", "tpmscad"], [str(script)]):
        ill = run("-W", "always", *program, "doctor", path=folder)
        assert ill.returncode == 1
        assert ill.stderr.count(CONFLICT) == 1
        assert f"\n    {REMEDY[0]}\n    {REMEDY[1]}\n" in ill.stderr
        other = run("-W", "always", *program, "surfaces", path=folder)
        assert (other.returncode, other.stderr.count(CONFLICT)) == (0, 1)
    named_alike = run("-c", "import tpmscad", "doctor", path=folder)
    assert CONFLICT in named_alike.stderr


@pytest.mark.kernel
def test_the_doctor_answers_without_a_kernel(tmp_path: Path) -> None:
    (tmp_path / "OCP.py").write_text("raise ImportError('undefined symbol: TopoDS')")
    found = run("-m", "tpmscad", "doctor", path=tmp_path)
    assert found.returncode == 1
    assert "the CAD kernel does not load (ImportError: undefined symbol: TopoDS)" in found.stderr
    assert "build123d does not load" not in found.stderr  # which follows from the kernel's
    assert "Traceback" not in found.stderr


@pytest.mark.kernel
def test_the_doctor_tells_that_build123d_does_not_load_on_the_kernel(tmp_path: Path) -> None:
    (tmp_path / "build123d.py").write_text(BROKEN_BUILD123D)
    found = run("-m", "tpmscad", "doctor", path=tmp_path)
    assert found.returncode == 1
    assert "build123d does not load (ImportError: cannot import name TColgp); this fixes it: pip" in found.stderr
