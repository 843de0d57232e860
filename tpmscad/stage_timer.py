"""Timing of the stages of a piece of work, with reports of progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from tpmscad._typing import FractionProgress, Progress


@dataclass(slots=True)
class StageTimer:
    """Times the stages of a piece of work and reports them as they begin and end.

    Each stage is a `with` block: `with timer("trim") as report: ...`. The caller's `progress` gets the stage's name with 0.0 at
    its start and 1.0 at its end; `report(fraction)` reports in between.
    """

    progress: Progress | None
    seconds: dict[str, float] = field(default_factory=dict)
    """Seconds by stage. A stage that runs twice has the sum."""
    clock: Callable[[], float] = time.perf_counter
    """Wall-clock time by default; `time.process_time` for CPU time."""

    @contextmanager
    def __call__(self, stage: str) -> Iterator[FractionProgress]:
        """Time a stage: a context manager that yields the function for reports in between."""
        begun = self.clock()
        report = self.progress or (lambda stage, done: None)
        report(stage, 0.0)
        try:
            yield lambda done: report(stage, done)
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + self.clock() - begun
        report(stage, 1.0)
