"""Compiled functions are kept where this user can write, and nowhere that another user can."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import pytest

import tpmscad
from tpmscad._compiled_loops import cache_folder, keep_in_temporary_folder

WITHOUT_A_WRITABLE_FOLDER = """
import numba.core.caching as caching
implementation = getattr(caching, "CacheImpl", None) or caching._CacheImpl
implementation._locator_classes = [one for one in implementation._locator_classes if "UserProvided" in one.__name__]
import numpy as np
from tpmscad.topology.persistence import compute_persistence
print(len(compute_persistence(np.arange(27.0).reshape(3, 3, 3), 0)))
"""
"""As on a machine where neither site-packages nor a home folder can be written to."""

IN_A_HOME_FOLDER = """
import numba.core.caching as caching
implementation = getattr(caching, "CacheImpl", None) or caching._CacheImpl
implementation._locator_classes = [one for one in implementation._locator_classes if "InTree" not in one.__name__]
import numpy as np
from tpmscad._compiled_loops import cache_folder
from tpmscad.topology.persistence import compute_persistence
compute_persistence(np.arange(27.0).reshape(3, 3, 3), 0)
print(cache_folder())
"""
"""As on a machine where site-packages cannot be written to, but a home folder can."""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    return tmp_path


def test_the_folder_belongs_to_the_user_alone_and_is_told(temporary: Path) -> None:
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        folder = keep_in_temporary_folder()
    assert folder.parent == temporary
    assert str(folder) == numba.config.CACHE_DIR
    assert folder.stat().st_mode & 0o777 == 0o700
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        assert keep_in_temporary_folder() == folder


def test_a_folder_that_others_can_write_to_is_not_used(temporary: Path) -> None:
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        folder = keep_in_temporary_folder()
    folder.chmod(0o777)
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        assert keep_in_temporary_folder() != folder


def test_a_link_planted_in_its_place_is_not_followed(temporary: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        folder = keep_in_temporary_folder()
    folder.rmdir()
    folder.symlink_to(tmp_path_factory.mktemp("elsewhere"))
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        assert keep_in_temporary_folder() != folder


@pytest.mark.slow
def test_the_package_works_where_no_folder_can_be_written_to(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_A_WRITABLE_FOLDER],
        capture_output=True,
        text=True,
        check=False,
        env={"TMPDIR": str(tmp_path), "PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 0
    assert done.stderr.count("NUMBA_CACHE_DIR") == 1
    assert list(tmp_path.rglob("*.nbi"))


def run_where_only(folder: Path, variable: str, script: str) -> str:
    """What a script prints where an environment variable names the folder that can be written to."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
        env={variable: str(folder), "HOME": str(folder), "PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.strip()


@pytest.mark.slow
def test_the_folder_stated_is_the_one_below_a_home_folder_where_numba_falls_back_to_it(tmp_path: Path) -> None:
    stated = Path(run_where_only(tmp_path, "XDG_CACHE_HOME", IN_A_HOME_FOLDER))
    kept = list(tmp_path.rglob("*.nbi"))
    assert kept
    assert all(stated in path.parents and path.parents[1] == stated for path in kept)


def test_the_folder_stated_is_the_one_that_the_user_names(tmp_path: Path) -> None:
    print_folder = "from tpmscad._compiled_loops import cache_folder\nprint(cache_folder())"
    assert run_where_only(tmp_path, "NUMBA_CACHE_DIR", print_folder) == str(tmp_path)


def test_the_folder_stated_is_the_package_where_it_can_be_written_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    assert cache_folder() == Path(tpmscad.__file__).parent


def test_no_folder_is_stated_where_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert cache_folder() is None
