"""Compiled functions are kept where this user can write, and nowhere that another user can."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import pytest

from tpmscad._compiled_loops import keep_in_temporary_folder

WITHOUT_A_WRITABLE_FOLDER = """
import numba.core.caching as caching
implementation = getattr(caching, "CacheImpl", None) or caching._CacheImpl
implementation._locator_classes = [one for one in implementation._locator_classes if "UserProvided" in one.__name__]
import numpy as np
from tpmscad.topology.persistence import compute_persistence
print(len(compute_persistence(np.arange(27.0).reshape(3, 3, 3), 0)))
"""
"""As on a machine where neither site-packages nor a home folder can be written to."""


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
