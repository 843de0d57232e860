"""The decorator of compiled loops, for every room that has some, and the folder where they are kept."""

from __future__ import annotations

import getpass
import os
import tempfile
import warnings
from pathlib import Path

import numba
from numba.core import event

from tpmscad.stage_timer import COMPILING, show_activity


def keep_in_temporary_folder() -> Path:
    """Keep compiled functions in a temporary folder that only this user can write to, and return it."""
    try:
        folder = Path(tempfile.gettempdir()) / f"tpmscad-compiled-{getpass.getuser()}"
    except (KeyError, OSError):  # a user without a name, as in some containers
        folder = Path(tempfile.gettempdir()) / "tpmscad-compiled"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        state = folder.lstat()
        owned = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
        if folder.is_symlink() or not owned or not os.access(folder, os.W_OK):
            raise PermissionError(folder)
    except OSError:  # another user's
        folder = Path(tempfile.mkdtemp(prefix="tpmscad-compiled-"))
    numba.config.CACHE_DIR = str(folder)
    warnings.warn(
        f"neither the package's folder nor a home folder can be written to: compiled functions are kept in {folder}; "
        "set NUMBA_CACHE_DIR to a folder of your own to keep them longer",
        stacklevel=2,
    )
    return folder


def _probe() -> None:
    """A function of this package, to see whether it can be kept."""


try:
    numba.njit(cache=True)(_probe)
except RuntimeError:  # numba finds no folder that it can write to
    keep_in_temporary_folder()


def cache_folder() -> Path | None:
    """The folder below which compiled functions are kept: the package's, one below a home folder, or NUMBA_CACHE_DIR.

    Numba takes the first of them that can be written to, so it is asked where it keeps a function of this module. None if
    NUMBA_DISABLE_JIT turns compilation off.
    """
    if numba.config.DISABLE_JIT:
        return None
    return Path(numba.njit(cache=True)(_probe).stats.cache_path).parent


class _CompilationListener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Shows in the progress of what is going on that a function is being compiled."""

    def __init__(self) -> None:
        self._depth = 0

    def on_start(self, _: event.Event) -> None:
        self._depth += 1
        if self._depth == 1:
            show_activity(COMPILING)

    def on_end(self, _: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            show_activity(None)


event.register("numba:compile", _CompilationListener())

njit_cached = numba.njit(cache=True, error_model="numpy")
"""Decorator of compiled loops: compiled on first use and cached on disk; a division by zero gives inf or nan, as in NumPy."""

njit_inner = numba.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""The same for functions that compiled loops alone call: what would unpack their arguments from Python, a dozen arrays in named
tuples, takes a third of the time of their compilation."""
