"""What every command that makes something does with it: a file and a report that are whole or not there, a bar meanwhile."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tpmscad._typing import Progress
from tpmscad.errors import InvalidRequest, NotMet

BAR_DELAY_SECONDS = 1.0
"""Seconds before the progress bar shows: shorter work needs none."""

STEP_SUFFIXES = (".step", ".stp")


def check_writable(path: Path, suffixes: Iterable[str]) -> Path:
    """The path, if a file of one of these kinds can be put there; looked at before anything is computed."""
    if path.suffix.lower() not in suffixes:
        raise InvalidRequest(f"{path} ends in {path.suffix!r}: give it a name ending in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise InvalidRequest(f"the folder {path.parent} of {path.name} does not exist: make it first")
    return path


def write_report(path: Path | None, content: dict[str, Any]) -> None:
    """The report as JSON, written aside and renamed, so that it is whole or not there."""
    if path is None:
        return
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        aside.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


@contextmanager
def progress_bar(title: str, quiet: bool) -> Iterator[Progress | None]:
    """A callback that draws a bar on standard error, or None where nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, ProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    begun = time.monotonic()

    class LateBar(Bar):
        def get_renderables(self) -> Iterable[Any]:
            return super().get_renderables() if time.monotonic() - begun > BAR_DELAY_SECONDS else ()

    columns: list[ProgressColumn] = [TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()]
    with LateBar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)  # moves to and fro until something is known to be done
        yield lambda stage, done: bar.update(task, description=stage, completed=done, total=1.0 if done else None)


@contextmanager
def report_unmet_request(report: Path | None) -> Iterator[None]:
    """A result that misses the request leaves its certificate in the report, and nothing else."""
    if report is not None:
        check_writable(report, (".json",))
    try:
        yield
    except NotMet as error:
        if error.certificate is not None:
            write_report(report, error.certificate.to_dict())
        raise


def write_model(model: Any, path: Path, progress: Progress | None, **how: Any) -> None:
    """Write the model if it meets the request."""
    certificate = model.certificate
    if not certificate.met:
        raise NotMet(f"{path} not written, it misses the request: {'; '.join(certificate.shortfalls)}", certificate)
    if progress:
        progress("write", 0.0)
    model.export_step(path, **how)
