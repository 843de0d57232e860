"""The output of commands: files and reports that are complete or absent, and a progress bar."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tpmscad.errors import InvalidRequest, NotMet

if TYPE_CHECKING:
    from tpmscad._typing import Progress  # loads NumPy

BAR_DELAY_SECONDS = 1.0
"""Time before the progress bar appears."""

STEP_SUFFIXES = (".step", ".stp")


def check_writable(path: Path, suffixes: Iterable[str]) -> Path:
    """The path; InvalidRequest unless it has one of the suffixes and its folder exists."""
    if path.suffix.lower() not in suffixes:
        raise InvalidRequest(f"{path} ends in {path.suffix!r}: give it a name ending in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise InvalidRequest(f"the folder {path.parent} of {path.name} does not exist: make it first")
    return path


def write_report(path: Path | None, content: dict[str, Any]) -> None:
    """Write a report as JSON under a temporary name and rename it, so that it is complete or absent."""
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
    """A callback that draws a progress bar on standard error; None if that is no terminal, or `quiet`."""
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
        task = bar.add_task(title, total=None)  # moves to and fro until a stage reports a fraction
        yield lambda stage, done: bar.update(task, description=stage, completed=done, total=1.0 if done else None)


@contextmanager
def report_unmet_request(report: Path | None) -> Iterator[None]:
    """Write the certificate of a NotMet that passes through to the report, before any file is written."""
    if report is not None:
        check_writable(report, (".json",))
    try:
        yield
    except NotMet as error:
        if error.certificate is not None:
            write_report(report, error.certificate.to_dict())
        raise


def write_model(model: Any, path: Path, progress: Progress | None, **export_options: Any) -> None:
    """Write a model as STEP; NotMet if it misses the request."""
    certificate = model.certificate
    if not certificate.met:
        raise NotMet(f"{path} not written, it misses the request: {'; '.join(certificate.shortfalls)}", certificate)
    if progress:
        progress("write", 0.0)
    model.export_step(path, **export_options)


def make_and_write(
    title: str,
    make: Callable[[Progress | None], Any],
    output: Path,
    *,
    report: Path | None,
    quiet: bool,
    **export_options: Any,
) -> None:
    """Make a model, write it as STEP and its certificate as JSON, and print the certificate."""
    check_writable(output, STEP_SUFFIXES)
    with report_unmet_request(report):
        with progress_bar(title, quiet) as progress:
            model = make(progress)
            write_model(model, output, progress, **export_options)
        write_report(report, model.certificate.to_dict())
    if not quiet:
        print(model.certificate)
