"""Files and folders that are written: where files may be is checked before the work, and each is complete or absent."""

from __future__ import annotations

import os
import shutil
import signal
import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

from tpmscad.errors import FileError, InvalidRequest
from tpmscad.file_suffixes import list_suffixes


def validate_output_path(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Path:
    """The path; InvalidRequest unless it ends in one of the suffixes and a file can be written there."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise InvalidRequest(f"{path} ends in {path.suffix!r}: give it a name ending in {list_suffixes(suffixes)}")
    if path.is_dir():
        raise InvalidRequest(f"{path} is a folder: give the name of a file")
    if path.exists() and not path.is_file():
        raise InvalidRequest(f"{path} is a device or a pipe: give the name of a file")
    folder = Path(os.path.realpath(path)).parent
    if not folder.is_dir():
        raise InvalidRequest(f"the folder {folder} of {path.name} does not exist: make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InvalidRequest(f"no file can be written in the folder {folder}: choose another one")
    return path


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Temporary path in the folder of `path`, of this process and thread alone; renamed to `path` on success, removed on failure.

    What is written there is a file, or a folder, which may take the place of an empty one only. A symbolic link stays one: the
    file that it leads to is written. SIGTERM removes the temporary file before the process ends.
    Raises FileError, with the reason, if the system cannot write the file.
    """
    target = Path(os.path.realpath(path))
    aside = target.with_name(f".{target.name[:40]}.{uuid.uuid4().hex}.part")
    with _terminate_by_exception():
        try:
            yield aside
            if aside.is_dir() and target.is_dir():
                target.rmdir()
            os.replace(aside, target)
        except FileError:
            raise
        except OSError as error:
            reason = error.strerror or str(error)
            raise FileError(f"{path} cannot be written: {reason}; free space, or choose another folder") from error
        finally:
            if aside.is_dir():
                shutil.rmtree(aside)
            else:
                aside.unlink(missing_ok=True)


@contextmanager
def _terminate_by_exception() -> Iterator[None]:
    """SIGTERM as an exception, so that temporary files are removed; a handler of the program is left alone."""
    is_ours = (
        threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    )
    if is_ours:
        signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        if is_ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    """What a terminated process does: it ends by an exception, with the status that shells give."""
    raise SystemExit(128 + number)
