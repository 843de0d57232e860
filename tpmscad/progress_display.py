"""The progress of long work, shown without being asked for: a bar in a terminal, a line in a notebook, else lines.

Nothing is written before a delay has passed, so that short work leaves no trace. A timer opens the display, because a stage may
take minutes between two reports; the display disappears at the end of its stage.
"""

from __future__ import annotations

import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from tpmscad._typing import FractionProgress

DELAY_SECONDS = 2.0
"""Time from the beginning of the work before its progress is shown."""

LINE_DELAY_SECONDS = 10.0
"""The same where standard error is no terminal, and the time between a line and the next one of its stage."""

NOTEBOOK_SECONDS = 0.2
"""Least time between two updates of a notebook's line."""

TERMINAL_CHARACTERS = 100
"""Longest name before a bar; what is beyond, as of a long reason why another method follows, is left out."""


class Display(Protocol):
    """A place on which the progress of one stage is shown."""

    def update(self, done: float) -> None:
        """Show the fraction that is done, 0 if it is not known."""

    def rename(self, stage: str) -> None:
        """Show another name for what is going on."""

    def close(self) -> None:
        """Remove the display."""


def find_display() -> Callable[[str], Display] | None:
    """What opens a display for a stage: a notebook's, a terminal's, or lines on standard error; None if there is none."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if type(shell).__name__ == "ZMQInteractiveShell":
        return NotebookLine
    if sys.stderr is None:
        return None
    return TerminalBar if sys.stderr.isatty() else ErrorLines


@contextmanager
def show_stage(stage: str, begun: float) -> Iterator[tuple[FractionProgress, Callable[[str], None]]]:
    """Show the progress of a stage from `DELAY_SECONDS`, in lines `LINE_DELAY_SECONDS`, after `begun` (`time.monotonic`) on.

    Yields the function for reports and one that shows another name.
    """
    open_display = find_display()
    if open_display is None:
        yield lambda done: None, lambda name: None
        return
    lock, shown, fraction, ended = threading.Lock(), list[Display](), [0.0], threading.Event()
    names = [stage]

    def begin() -> None:
        with lock:
            if not ended.is_set():
                shown.append(open_display(names[-1]))
                shown[0].update(fraction[0])

    def report(done: float) -> None:
        with lock:
            fraction[0] = done
            for display in shown:
                display.update(done)

    def rename(name: str) -> None:
        with lock:
            names[-1] = name
            for display in shown:
                display.rename(name)

    wait = begun + (LINE_DELAY_SECONDS if open_display is ErrorLines else DELAY_SECONDS) - time.monotonic()
    timer = threading.Timer(wait, begin)
    timer.daemon = True
    if wait > 0:
        timer.start()
    else:
        begin()
    try:
        yield report, rename
    finally:
        ended.set()
        timer.cancel()
        with lock:
            for display in shown:
                display.close()


class Estimate:
    """The time that a stage still takes, at the mean speed since its first report above 0."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def describe(self, done: float) -> str:
        """In words, after a comma; empty while too little is known."""
        now = time.monotonic()
        if self._first is None or done < self._first[1]:
            self._first = (now, done)
        begun, share = self._first
        if done - share < LEAST_SHARE:
            return ""
        return f", about {max(1, round((1.0 - done) * (now - begun) / (done - share)))} s more"


LEAST_SHARE = 0.05
"""Part of a stage after which its end is estimated."""


class ErrorLines:
    """Lines on standard error for scripts and logs: one as a stage is shown, and of a long one further ones with an estimate."""

    def __init__(self, stage: str) -> None:
        self._told: set[str] = set()
        self.rename(stage)

    def update(self, done: float) -> None:
        """Tell the fraction that is done, now and then."""
        estimate = self._estimate.describe(done) if 0.0 < done < 1.0 else ""
        if estimate and time.monotonic() - self._latest >= LINE_DELAY_SECONDS:
            self._tell(f"{self._stage}: {round(100 * done)} %{estimate}")

    def rename(self, stage: str) -> None:
        """Tell what is going on now, each name once: functions are compiled one by one."""
        self._stage, self._estimate = textwrap.shorten(stage, TERMINAL_CHARACTERS, placeholder=" ..."), Estimate()
        if self._stage not in self._told:
            self._told.add(self._stage)
            self._tell(f"{self._stage} ...")

    def close(self) -> None:
        """Leave the lines as they are."""

    def _tell(self, text: str) -> None:
        """Write a line."""
        self._latest = time.monotonic()
        print(f"tpmscad: {text}", file=sys.stderr, flush=True)


class TerminalBar:
    """A bar of `rich` on standard error; it moves to and fro while no fraction is known."""

    def __init__(self, stage: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        self._bar = Progress(*columns, console=Console(file=sys.stderr), transient=True)
        self._task = self._bar.add_task(stage, total=None)
        self._bar.start()

    def update(self, done: float) -> None:
        """Show the fraction that is done."""
        self._bar.update(self._task, completed=done, total=1.0 if done else None)

    def rename(self, stage: str) -> None:
        """Show another name before the bar."""
        from rich.markup import escape

        shown = textwrap.shorten(stage, TERMINAL_CHARACTERS, placeholder=" ...")
        self._bar.update(self._task, description=escape(shown))

    def close(self) -> None:
        """Remove the bar."""
        self._bar.stop()


class NotebookLine:
    """A line of text below the cell of a notebook."""

    def __init__(self, stage: str) -> None:
        from IPython.display import display

        self._stage, self._latest, self._estimate = stage, 0.0, Estimate()
        show: Any = display
        self._handle: Any = show({"text/plain": stage}, raw=True, display_id=True)

    def update(self, done: float) -> None:
        """Show the fraction that is done."""
        if time.monotonic() - self._latest >= NOTEBOOK_SECONDS:
            self._latest = time.monotonic()
            share = f": {round(100 * done)} %{self._estimate.describe(done)}" if done else " ..."
            self._handle.update({"text/plain": self._stage + share}, raw=True)

    def rename(self, stage: str) -> None:
        """Show another name, until the next report with a percentage."""
        self._stage, self._estimate = stage, Estimate()
        self._handle.update({"text/plain": f"{stage} ..."}, raw=True)

    def close(self) -> None:
        """Empty the line."""
        self._handle.update({"text/plain": ""}, raw=True)
