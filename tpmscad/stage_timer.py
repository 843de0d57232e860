"""Timing of the stages of a piece of work, with reports of progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from tpmscad._typing import FractionProgress, ProgressOption
from tpmscad.api.public_calls import call_user_function
from tpmscad.progress_display import show_stage


@dataclass(slots=True)
class StageTimer:
    """Times the stages of a piece of work and reports them as they begin and end.

    Each stage is a `with` block: `with timer("trim") as report: ...`. A callable `progress` gets the stage's name with 0.0 at its
    start and 1.0 at its end; `report(fraction)` reports in between. None or True shows a bar in a terminal or a notebook; False
    shows nothing.
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
        with self._open_report(stage) as report:
            report(0.0)
            try:
                yield report
            finally:
                self.seconds[stage] = self.seconds.get(stage, 0.0) + self.clock() - begun
            report(1.0)

    @contextmanager
    def _open_report(self, stage: str) -> Iterator[FractionProgress]:
        """The function that reports the fraction of the stage that is done."""
        call = self.progress
        if callable(call):
            yield lambda done: call_user_function("progress", call, stage, done)
        elif call is False:
            yield lambda done: None
        else:
            with show_stage(stage, self.begun) as report:
                yield report
