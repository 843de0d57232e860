"""Progress shows itself where people look, after a delay, and nowhere else."""

from __future__ import annotations

import io
import sys
import time
from types import SimpleNamespace
from typing import Any

import numba
import pytest
import rich.progress  # noqa: F401 - its first import takes longer than the stages below

import tpmscad._compiled_loops  # noqa: F401 - reports what is compiled
from tpmscad import progress_display
from tpmscad.stage_timer import COMPILING, StageTimer, show_activity


class Terminal(io.StringIO):
    """A stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    stream = Terminal()
    modules = {name: module for name, module in sys.modules.items() if name != "IPython"}
    # pytest puts its own stream in sys.stderr between fixture and test
    monkeypatch.setattr(progress_display, "sys", SimpleNamespace(stderr=stream, modules=modules))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress_display, "DELAY_SECONDS", 0.05)
    return stream


def work(timer: StageTimer, seconds: float) -> None:
    with timer("fit") as report:
        report(0.25)
        time.sleep(seconds)


@pytest.mark.parametrize("progress", [None, True])
def test_a_stage_longer_than_the_delay_shows_its_name_in_a_terminal_without_a_report(
    terminal: Terminal, progress: bool | None
) -> None:
    work(StageTimer(progress), 0.4)
    assert "fit" in terminal.getvalue()


def test_short_work_and_silenced_work_leave_no_trace(terminal: Terminal) -> None:
    work(StageTimer(None), 0.0)
    work(StageTimer(False), 0.2)
    assert terminal.getvalue() == ""


def test_the_delay_counts_from_the_beginning_of_the_work(terminal: Terminal) -> None:
    timer = StageTimer(None)
    time.sleep(0.1)
    work(timer, 0.0)
    assert "fit" in terminal.getvalue()


def test_a_script_sees_a_line_for_each_long_stage_and_an_estimate(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "isatty", lambda: False)
    work(StageTimer(None), 0.1)
    assert terminal.getvalue() == "", "ten seconds have not passed"
    monkeypatch.setattr(progress_display, "LINE_DELAY_SECONDS", 0.05)
    timer = StageTimer(None)
    with timer("fit") as report:
        for done in (0.25, 0.5, 0.75):
            report(done)
            time.sleep(0.3)
    work(StageTimer(False), 0.2)
    first, *others = terminal.getvalue().splitlines()
    assert first == "tpmscad: fit ..."
    assert {line.split(",")[0] for line in others} <= {"tpmscad: fit: 50 %", "tpmscad: fit: 75 %"}
    assert others[-1].startswith("tpmscad: fit: 75 %")
    assert others[-1].endswith("about 1 s more")


def test_the_bar_ends_with_its_stage_when_the_work_fails(terminal: Terminal) -> None:
    timer = StageTimer(None)

    def fail() -> None:
        with timer("fit"):
            time.sleep(0.3)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    written = len(terminal.getvalue())
    time.sleep(0.3)
    assert written == len(terminal.getvalue())
    assert timer.seconds["fit"] >= 0.3


def test_a_callable_gets_every_report_at_once_and_no_bar_is_drawn(terminal: Terminal) -> None:
    calls: list[tuple[str, float]] = []
    work(StageTimer(lambda stage, done: calls.append((stage, done))), 0.2)
    assert calls == [("fit", 0.0), ("fit", 0.25), ("fit", 1.0)]
    assert terminal.getvalue() == ""


def test_a_notebook_shows_a_line_and_empties_it(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []

    class ZMQInteractiveShell:
        """The shell of a notebook, by its name."""

    def display(data: dict[str, str], **_: Any) -> Any:
        lines.append(data["text/plain"])
        return SimpleNamespace(update=display)

    notebook = SimpleNamespace(get_ipython=ZMQInteractiveShell)
    monkeypatch.setitem(progress_display.sys.modules, "IPython", notebook)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    work(StageTimer(None), 0.2)
    assert lines == ["fit", "fit: 25 %", "fit: 100 %", ""] or lines == ["fit", "fit: 25 %", ""]
    assert terminal.getvalue() == ""


def test_a_stage_says_when_functions_are_being_compiled_and_goes_on_under_its_name(terminal: Terminal) -> None:
    reports: list[tuple[str, float]] = []
    with StageTimer(lambda stage, done: reports.append((stage, done)))("fit") as report:
        report(0.5)
        numba.njit(lambda x: x + 1)(2.0)  # not kept: it is compiled here
    assert reports == [("fit", 0.0), ("fit", 0.5), (COMPILING, 0.0), ("fit", 0.5), ("fit", 1.0)]
    with StageTimer(None)("grow"):
        time.sleep(0.2)
        show_activity(COMPILING)
        time.sleep(0.2)
        show_activity(None)
    assert COMPILING in terminal.getvalue()
