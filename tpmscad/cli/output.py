"""The output of commands: files and reports that are complete or absent, and a progress bar."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.cli.option_language import RENAMED_KEYWORDS, speak_in_options
from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.file_suffixes import MODEL_SUFFIXES, STEP_SUFFIXES, TRIANGLE_SUFFIXES, list_suffixes

if TYPE_CHECKING:
    from tpmscad._typing import Progress  # loads NumPy


@dataclass(frozen=True, slots=True)
class OutputRequest:
    """Where a result goes and how: the file (None: nowhere), the report, what is said, and the options of the format.

    It is made as a command begins, and `begun` is that time on the monotonic clock.
    """

    output: Path | None
    report: Path | None = None
    quiet: bool = False
    progress: str = "bar"
    verbose: bool = False
    deviation: float | None = None
    schema: str = "ap242"
    instanced: bool = False
    verify: str | None = None
    suffixes: tuple[str, ...] = MODEL_SUFFIXES
    begun: float = field(default_factory=time.monotonic, compare=False)

    def __post_init__(self) -> None:
        check_report(self.report)
        if self.output is None:
            return
        validate_output_path(self.output, self.suffixes)
        suffix = self.output.suffix.lower()
        if self.deviation is not None and suffix not in TRIANGLE_SUFFIXES:
            raise InvalidRequest(
                f"`deviation` is for {list_suffixes(TRIANGLE_SUFFIXES)}; a {suffix} file is exact: leave it out"
            )
        if self.deviation is not None and not 0 < self.deviation < math.inf:
            raise InvalidRequest(f"`deviation` {self.deviation:g} must be a distance in mm above zero")
        if suffix not in STEP_SUFFIXES and (self.instanced or self.schema != "ap242" or self.verify):
            raise InvalidRequest(
                f"`schema`, `instanced` and `verify` are for .step files: leave them out of a {suffix} file"
            )

    @property
    def format_options(self) -> dict[str, Any]:
        """The options of the file's format that differ from its defaults."""
        defaults = {"deviation": None, "instanced": False, "verify": None, "schema": "ap242"}
        return {name: value for name, default in defaults.items() if (value := getattr(self, name)) != default}


def check_report(path: Path | None) -> None:
    """InvalidRequest unless a report can be written, if one is asked for."""
    if path is not None:
        validate_output_path(path, (".json",))


def write_report(path: Path | None, content: dict[str, Any]) -> None:
    """Write a report as JSON under a temporary name and rename it, so that it is complete or absent."""
    if path is None:
        return
    with atomic_write(path) as aside:
        aside.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")


@contextmanager
def progress_bar(title: str, quiet: bool, form: str = "bar") -> Iterator[Progress]:
    """A callback that shows progress on standard error: a bar in a terminal, lines of long work elsewhere; silent if `quiet`.

    The form "lines" is for programs: a line of JSON for each stage and each percent of it, wherever standard error leads.
    """
    if form == "lines":
        yield ProgressLines().report
        return
    if quiet:
        yield lambda stage, done: None  # None would leave the bar to the functions themselves
        return
    from tpmscad.progress_display import show_stage  # loads NumPy

    with show_stage(title, time.monotonic()) as (report, rename):
        shown = [title]

        def show(stage: str, done: float) -> None:
            if stage != shown[0]:
                shown[0] = stage
                rename(stage)
            report(done)

        yield show


class ProgressLines:
    """Reports of progress as lines of JSON on standard error: {"stage": "trim", "done": 0.25}."""

    def __init__(self) -> None:
        self._latest: tuple[str, float] | None = None

    def report(self, stage: str, done: float) -> None:
        """Write a line, unless the latest one says the same to a percent."""
        told = (stage, round(done, 2))
        if told != self._latest:
            self._latest = told
            print(json.dumps({"stage": stage, "done": told[1]}), file=sys.stderr, flush=True)


@contextmanager
def report_unmet_request(report: Path | None) -> Iterator[None]:
    """Write the certificate of a NotMet that passes through to the report, before any file is written."""
    check_report(report)
    try:
        yield
    except NotMet as error:
        if error.certificate is not None:
            write_report(report, error.certificate.to_dict())
        raise


def write_model(model: Any, writing: OutputRequest, progress: Progress) -> Any:
    """Write a model in the format of the file's suffix, and return what `export` does; NotMet if it misses the request."""
    certificate = model.certificate
    if not certificate.met:
        missed = "; ".join(certificate.shortfalls)
        raise NotMet(f"{writing.output} not written, it misses the request: {missed}", certificate)
    progress("write", 0.0)
    return model.export(writing.output, **writing.format_options)


def describe_mesh(file: Any) -> dict[str, Any]:
    """The entry of a report on the triangles of an exported file; none of an exact one."""
    return {"mesh": {"triangles": file.triangles, "deviation": file.deviation}} if file.triangles else {}


def write_layers(slices: Any, source: Path, writing: OutputRequest) -> None:
    """Write layers to the output, and their figures to the report, and print a line."""
    slices.write(writing.output)
    write_report(
        writing.report,
        {
            "file": str(source),
            "slices": str(writing.output),
            "layers": len(slices),
            "contours": slices.n_contours,
            "points": slices.n_points,
            "volume": slices.volume,
            "chord_error": slices.chord_error,
            "unresolved": slices.unresolved,
        },
    )
    tell(slices, writing)


def write_triangles(part: Any, source: Path, writing: OutputRequest) -> None:
    """Write triangles to the output, and their figures to the report, and print a summary."""
    part.write(writing.output)
    write_report(
        writing.report,
        {
            "file": str(source),
            "triangles": str(writing.output),
            "count": len(part.triangles),
            "deviation": part.deviation,
            "volume": part.volume,
            "area": part.area,
            "center_of_mass": part.center_of_mass,
            "pieces": part.n_pieces,
            "whole_cells": part.whole_cells,
            "cut_cells": part.cut_cells,
            "notes": list(part.notes),
        },
    )
    tell(part, writing)


def tell(text: Any, writing: OutputRequest, *, parts: Sequence[Path] = (), holds: str = "") -> None:
    """Print what is said of a result, if anything, and the line of its file, or of the `parts` it consists of; unless `quiet`.

    holds: what the file holds, in words.
    """
    if writing.quiet:
        return
    if str(text):
        print(text)
    if writing.output is not None:
        print(describe_file(writing.output, writing.begun, parts, holds))


def describe_file(path: Path, begun: float, parts: Sequence[Path] = (), holds: str = "") -> str:
    """The line that tells a file or its parts, the size, and the time that passed since `begun` on the monotonic clock.

    holds: what the file holds, in words.
    """
    size = sum(part.stat().st_size for part in parts or [path])
    unit, scale = next((u, s) for u, s in (("MB", 1e6), ("kB", 1e3), ("bytes", 1.0)) if size >= s or s == 1.0)
    count = f" in {len(parts)} files" if len(parts) > 1 else ""
    count += f", {holds}" if holds else ""
    return f"wrote       {path}, {size / scale:.3g} {unit}{count}, after {time.monotonic() - begun:.1f} s in all"


def make_and_write(title: str, make: Callable[[Progress], Any], writing: OutputRequest) -> None:
    """Make a model, write it and its certificate (that of an exchanger with its domains) as JSON, and print its summary."""
    with report_unmet_request(writing.report):
        with progress_bar(title, writing.quiet, writing.progress) as progress:
            model = make(progress)
            file = write_model(model, writing, progress)
        figures = model.to_dict() if hasattr(model, "domains") else model.certificate.to_dict()
        write_report(writing.report, figures | describe_mesh(file))
    tell(summarise(model, verbose=writing.verbose), writing, holds=file.summary())


def summarise(model: Any, *, verbose: bool) -> str:
    """What is said of a result: its certificate in plain words, or every figure with its bound."""
    certificate = model.certificate
    if hasattr(model, "domains"):  # the table of an exchanger tells what its notes tell of channels and faces
        notes = tuple(note for note in certificate.notes if not note.startswith(("on body ", "channel ")))
        text = f"{replace(certificate, notes=notes).summary(verbose=verbose)}\n{model.summary()}"
    else:
        text = str(certificate.summary(verbose=verbose))
    return speak_in_options(text, RENAMED_KEYWORDS)
