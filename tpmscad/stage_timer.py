"""Timing of the stages of a piece of work, with reports of progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from tpmscad._typing import FractionProgress, ProgressOption
from tpmscad.api.public_calls import call_user_function
from tpmscad.progress_display import show_stage

COMPILING = "compiling, once"
"""Name that is shown while functions are compiled, which are then kept on disk."""

_open_stages: list[Callable[[str | None], None]] = []
"""What shows another name in each of the stages that are open, or its own name again."""


def show_activity(name: str | None) -> None:
    """Show in the innermost open stage what is going on in it, such as `COMPILING`, or with None its own name again."""
    if _open_stages:
        _open_stages[-1](name)


@dataclass(slots=True)
class StageTimer:
    """Times the stages of a piece of work and reports them as they begin and end.

    Each stage is a `with` block: `with timer("trim") as report: ...`. A callable `progress` gets the stage's name with 0.0 at its
    start and 1.0 at its end; `report(fraction)` reports in between. None or True shows what
    `progress_display` says; False shows nothing.
    """

    progress: ProgressOption
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds by stage. A stage that runs twice has the sum."""
    clock: Callable[[], float] = time.perf_counter
    """Wall-clock time by default; `time.process_time` for CPU time."""
    begun: float = field(default_factory=time.monotonic)
    """When the work began, from which the delay of the display counts."""

    @contextmanager
    def __call__(self, stage: str) -> Iterator[FractionProgress]:
        """Time a stage: a context manager that yields the function for reports in between."""
        begun = self.clock()
        with self._open_report(stage) as (report, show):
            report(0.0)
            _open_stages.append(show)
            try:
                yield report
            finally:
                _open_stages.remove(show)
                self.seconds[stage] = self.seconds.get(stage, 0.0) + self.clock() - begun
            report(1.0)

    @contextmanager
    def _open_report(self, stage: str) -> Iterator[tuple[FractionProgress, Callable[[str | None], None]]]:
        """The function that reports the fraction of the stage that is done, and one that shows another name in its place."""
        call = self.progress
        if callable(call):
            done = [0.0]

            def report(fraction: float) -> None:
                done[0] = fraction
                call_user_function("progress", call, stage, fraction)

            yield (
                report,
                lambda name: call_user_function("progress", call, *((name, 0.0) if name else (stage, done[0]))),
            )
        elif call is False:
            yield lambda fraction: None, lambda name: None
        else:
            with show_stage(stage, self.begun) as (show_fraction, rename):
                yield show_fraction, lambda name: rename(name or stage)
