"""A file is complete or absent, whatever ends its writing, and where it may be is checked before the work."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.errors import FileError, InvalidRequest

TERMINATED = """
import os, signal, sys, time
from pathlib import Path
from tpmscad.atomic_file import atomic_write
with atomic_write(Path(sys.argv[1])) as aside:
    aside.write_text("half")
    print(len(os.listdir(aside.parent)), flush=True)
    time.sleep(60)
"""


def break_off(path: Path, error: Exception) -> None:
    with atomic_write(path) as aside:
        aside.write_text("half")
        raise error


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("old")
    with pytest.raises(ZeroDivisionError):
        break_off(tmp_path / "a.json", ZeroDivisionError())
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.json": "old"}


def test_threads_that_write_one_path_each_write_a_file_of_their_own(tmp_path: Path) -> None:
    together = Barrier(4, timeout=20)

    def write(text: str) -> str:
        with atomic_write(tmp_path / "a.txt") as aside:
            aside.write_text(text)
            together.wait()
            return aside.read_text()

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(write, "abcd")) == list("abcd")
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without a signal")
def test_sigterm_removes_the_temporary_file(tmp_path: Path) -> None:
    command = [sys.executable, "-c", TERMINATED, str(tmp_path / "a.txt")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"1\n"
        child.send_signal(signal.SIGTERM)
        assert child.wait(30) == 128 + signal.SIGTERM
    assert os.listdir(tmp_path) == []


def test_the_programs_own_handler_of_sigterm_is_left_alone(tmp_path: Path) -> None:
    def own(number: int, frame: object) -> None:
        pass

    before = signal.signal(signal.SIGTERM, own)
    try:
        with atomic_write(tmp_path / "a.txt") as aside:
            assert signal.getsignal(signal.SIGTERM) is own
            aside.write_text("whole")
    finally:
        signal.signal(signal.SIGTERM, before)
    with atomic_write(tmp_path / "a.txt") as aside:
        aside.write_text("whole")
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_link_stays_a_link_and_what_it_leads_to_is_written(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    (tmp_path / "link.json").symlink_to(tmp_path / "store" / "real.json")
    for text in ("first", "second"):
        with atomic_write(validate_output_path(tmp_path / "link.json", (".json",))) as aside:
            aside.write_text(text)
        assert (tmp_path / "link.json").is_symlink()
        assert (tmp_path / "store" / "real.json").read_text() == text
    assert os.listdir(tmp_path / "store") == ["real.json"]


def test_a_full_disk_is_named_with_the_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"a\.txt cannot be written: No space left"):
        break_off(tmp_path / "a.txt", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert os.listdir(tmp_path) == []


def test_places_where_no_file_can_be_are_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "lost.json").symlink_to(tmp_path / "gone" / "real.json")
    for name, reason in (
        ("a.txt", r"ends in '\.txt': give it a name ending in \.json"),
        ("folder.json", "is a folder"),
        ("gone/a.json", "the folder .*gone of a.json does not exist"),
        ("lost.json", "the folder .*gone of lost.json does not exist"),
    ):
        with pytest.raises(InvalidRequest, match=reason):
            validate_output_path(tmp_path / name, (".json",))
    with pytest.raises(InvalidRequest, match=r"a name ending in \.msh, \.inp or \.feb$"):
        validate_output_path(tmp_path / "a.txt", (".msh", ".inp", ".feb"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(InvalidRequest, match="is a device or a pipe"):
        validate_output_path(tmp_path / "pipe.json", (".json",))


def test_a_folder_in_which_the_system_allows_no_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(
        InvalidRequest, match=f"no file can be written in the folder {re.escape(str(tmp_path))}: choose"
    ):
        validate_output_path(tmp_path / "a.json", (".json",))


def test_a_folder_takes_the_place_of_an_empty_one_only(tmp_path: Path) -> None:
    target = tmp_path / "case"
    target.mkdir()
    for content in ("first", "second"):
        try:
            with atomic_write(target) as aside:
                (aside / "system").mkdir(parents=True)
                (aside / "system" / "file").write_text(content)
        except FileError:
            assert content == "second"
        assert [path.name for path in tmp_path.iterdir()] == ["case"]
        assert (target / "system" / "file").read_text() == "first"
