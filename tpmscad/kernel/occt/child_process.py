"""Calls in a child process with a time limit: a crash of OCCT on a file from elsewhere ends the child, not the caller.

On Linux the child is a fork, which takes a few milliseconds and has everything imported. The interpreter's lock is held
meanwhile, so that no other Python thread is inside OCCT; OCCT's own threads do not survive a fork, and are not used in one
(`may_use_threads`).
On other systems, where forks are unsafe or unknown, the child is a new interpreter.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn, TypeVar

from tpmscad.errors import TpmscadError

T = TypeVar("T")

CAN_FORK = sys.platform.startswith("linux")

NEW_INTERPRETER = "from tpmscad.kernel.occt.child_process import answer_standard_input; answer_standard_input()"

_is_forked = False


class ChildFailure(TpmscadError):
    """A call in a child process crashed or exceeded its time limit."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def may_use_threads() -> bool:
    """True if OCCT's algorithms may run in parallel; in a forked process they would wait for threads that do not exist."""
    return not _is_forked


def call_in_child(function: Callable[..., T], *arguments: Any, seconds: float) -> T:
    """`function(*arguments)` of a module's function, computed in a child process; all travels as pickles.

    Raises the error that the function raises, and ChildFailure if the child crashes or takes longer than `seconds`.
    """
    answer = (_fork if CAN_FORK else _start_interpreter)(function, arguments, seconds)
    succeeded, value = pickle.loads(answer)
    if not succeeded:
        raise value
    return value


def _fork(function: Callable[..., Any], arguments: tuple[Any, ...], seconds: float) -> bytes:
    """The pickled answer of a forked child, which an alarm ends after `seconds`."""
    read_end, write_end = os.pipe()
    with warnings.catch_warnings():  # Python 3.12 warns if there are other threads, which the child does not need
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        _answer_and_exit(function, arguments, write_end, seconds)
    os.close(write_end)
    try:
        with os.fdopen(read_end, "rb") as pipe:
            answer = pipe.read()
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        _, status = os.waitpid(child, 0)
    return _require_success(answer, os.waitstatus_to_exitcode(status), seconds)


def _answer_and_exit(
    function: Callable[..., Any], arguments: tuple[Any, ...], write_end: int, seconds: float
) -> NoReturn:
    """What the forked child does: nothing of the parent's is flushed, and no handler of the parent's runs."""
    status = 1
    with suppress(BaseException):
        faulthandler.disable()
        for number in (signal.SIGTERM, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent, which is interrupted too, ends the child
        signal.setitimer(signal.ITIMER_REAL, seconds)
        answer = _answer(function, arguments)
        with os.fdopen(write_end, "wb") as pipe:
            pipe.write(answer)
        status = 0
    os._exit(status)


def _start_interpreter(function: Callable[..., Any], arguments: tuple[Any, ...], seconds: float) -> bytes:
    """The pickled answer of a new interpreter, which is ended after `seconds`."""
    command = [sys.executable, "-c", NEW_INTERPRETER]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    request = pickle.dumps((function, arguments))
    try:
        child = subprocess.run(
            command, input=request, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        raise ChildFailure(f"did not end within {seconds:g} s") from None
    return _require_success(child.stdout, child.returncode, seconds)


def answer_standard_input() -> None:
    """What the new interpreter does: a pickled call on standard input, its pickled answer on standard output."""
    output = os.dup(1)
    os.dup2(2, 1)  # what OCCT prints must not enter the answer
    function, arguments = pickle.load(sys.stdin.buffer)
    with os.fdopen(output, "wb") as pipe:
        pipe.write(_answer(function, arguments))


def _answer(function: Callable[..., Any], arguments: tuple[Any, ...]) -> bytes:
    """Pickle of (True, value) or of (False, error)."""
    try:
        return pickle.dumps((True, function(*arguments)))
    except Exception as error:
        return pickle.dumps((False, error))


def _require_success(answer: bytes, exit_code: int, seconds: float) -> bytes:
    """The answer of a child that ended with `exit_code`, which is minus the number of a signal; ChildFailure unless it is 0."""
    if CAN_FORK and exit_code == -signal.SIGALRM:
        raise ChildFailure(f"did not end within {seconds:g} s")
    if CAN_FORK and exit_code == -signal.SIGXCPU:  # beyond a limit that the function has set
        raise ChildFailure("used up its CPU time")
    if exit_code < 0:
        raise ChildFailure(f"crashed ({signal.strsignal(-exit_code)})")
    if exit_code > 0:
        raise ChildFailure(f"crashed (status {exit_code})")
    return answer


def _after_fork() -> None:
    global _is_forked
    _is_forked = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
