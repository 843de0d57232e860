"""One run of `tpmscad infill`: its command from settings, its progress, its end. Nothing here needs FreeCAD.

Settings are texts as a user types them, and empty where nothing is asked for: the program checks them, and what it refuses comes
back in its own words. The program runs in a folder of its own, where it finds the body and leaves its files.

The workbench runs in FreeCAD's Python, which may be as old as 3.8.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BODY_FILE, FILLED_FILE, REPORT_FILE = "body.step", "filled.step", "filled.json"
KEEP_FILE, CLEAR_FILE, STRUTS_FILE = "keep.step", "clear.step", "struts.toml"
"""Names in the folder of a run."""

SAVED_SUFFIXES = (".step", ".3mf", ".stl")
"""Formats that a filled body is saved in."""

STRUTS_WORD, RECIPE_WORD = " struts", "recipe"
"""What the names of cells of struts end in here, since diamond is a surface, too; and the name for a field of a recipe."""

STRUTS_RECIPE = """tol = {tol:.9g}
domain = [{low}, {high}]

[field]
kind = "translate"
vector = {low}
of = {{ kind = "strut_lattice", structure = "{structure}", cell = {cell}, cells = {cells}, diameter = {diameter:.9g} }}
"""

WALLS = ("thickness", "porosity", "volume-fraction", "offset")
"""What may define the wall, as options of the command."""

HOST_VARIABLES = ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "PYTHONDONTWRITEBYTECODE", "QT_PLUGIN_PATH", "APPDIR")
"""Variables by which bundles of FreeCAD lead Python and Qt to their own files; another Python breaks with them."""

GRACE_SECONDS = 2.0
"""Time that a cancelled program has to end by itself; a long operation of the kernel does not hear an interrupt."""

SURFACES_SECONDS = 120.0
"""Time for the list of structures, which takes half a second of processor time."""

HOLES = re.compile(r"(?:holes|bosses)\s+[-+.\d]+")
"""The surroundings of round holes among what is kept: holes 3."""

_FACE_NAME = re.compile(r"\bFace(\d+)\b")


class Refusal(Exception):
    """What was asked for cannot be done; the message is for the user and names the remedy."""


class Cancelled(Exception):
    """The run was cancelled."""


@dataclass(frozen=True)
class FillSettings:
    """What a body is filled with, as texts; lengths in mm.

    `surface` is the name of a surface or a core, a cell of struts ("octet struts"), or "recipe" for the field of the TOML file
    `recipe`. `wall` is one of `WALLS`, `wall_value` its value; of struts the thickness is their diameter. `open_faces` holds
    names of faces (Face3) and selectors (>Z), with commas between. `keep` and `clear` hold names of bodies of the document, and
    "holes 3" for all round holes with 3 mm around them, with commas between. `more` are further options of the command, written
    as in a shell.
    """

    surface: str = "gyroid"
    kind: str = "sheet"
    cell: str = "10"
    wall: str = "thickness"
    wall_value: str = "1"
    skin: str = ""
    open_faces: str = ""
    tol: str = ""
    more: str = ""
    recipe: str = ""
    keep: str = ""
    clear: str = ""

    def to_json(self) -> str:
        """The settings as text, for a property of a document object."""
        return json.dumps(vars(self))

    @classmethod
    def from_json(cls, text: str) -> FillSettings:
        """The settings of `to_json`."""
        return cls(**json.loads(text))


@dataclass(frozen=True)
class Filled:
    """What a run has made: the STEP file, the summary of the certificate, the certificate as JSON, and warnings."""

    step: Path
    summary: str
    report: str
    warnings: tuple[str, ...] = ()

    @property
    def certificate(self) -> dict[str, Any]:
        """The certificate as plain values."""
        values: dict[str, Any] = json.loads(self.report)
        return values


def find_program(given: str = "") -> list[str]:
    """The words that start tpmscad: a program, or a Python that has it. Without a path, tpmscad is looked for on PATH."""
    program = os.path.expanduser(given.strip()) or "tpmscad"
    found = shutil.which(program)
    if found is None:
        where = f"{program} is no program" if given.strip() else "tpmscad is not on PATH"
        raise Refusal(
            f"{where}: install tpmscad in a virtual environment, and give the path of its program tpmscad, or of its python, in "
            "Edit > Preferences > tpmscad"
        )
    path = os.path.abspath(found)
    return [path, "-m", "tpmscad"] if os.path.basename(path).lower().startswith("python") else [path]


def number_faces(open_faces: str) -> str:
    """Names of faces as their numbers, which FreeCAD counts from 1 and tpmscad from 0; the rest as it is."""
    return _FACE_NAME.sub(lambda match: str(int(match[1]) - 1), open_faces)


def read_number(text: str, field: str) -> float:
    """A number above zero of the form; Refusal that names the field."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise Refusal(f"{field} {text!r}: give a number above zero, in mm and without its unit")
    return value


def read_passive(text: str) -> tuple[str, list[str]]:
    """What `keep` or `clear` names: the surroundings of holes in the words of the option, and names of bodies."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    holes = [part for part in parts if HOLES.fullmatch(part)]
    if len(holes) > 1:
        raise Refusal(f"{', '.join(holes)}: give one width for all holes")
    width = read_number(holes[0].split()[1], "width round holes") if holes else 0.0
    return f"bosses,{width:g}" if holes else "", [part for part in parts if part not in holes]


def write_struts(settings: FillSettings, low: Sequence[float], high: Sequence[float], folder: Path) -> None:
    """Write the recipe of struts that cover a box, anchored at the origin, as lattices are."""
    parts = settings.cell.split(",")
    if len(parts) not in (1, 3):
        raise Refusal(f"cell {settings.cell!r}: give one number, or three with commas between")
    cell = [read_number(part, "cell") for part in (parts if len(parts) == 3 else parts * 3)]
    if settings.wall != "thickness":
        raise Refusal(f"wall: struts take a thickness, their diameter, and no {settings.wall}")
    diameter = read_number(settings.wall_value, "wall thickness")
    first = [math.floor(a / c) - 1 for a, c in zip(low, cell)]
    cells = [math.ceil(b / c) + 1 - f for b, c, f in zip(high, cell, first)]
    begin = [f * c for f, c in zip(first, cell)]
    end = [a + n * c for a, n, c in zip(begin, cells, cell)]
    text = STRUTS_RECIPE.format(
        tol=read_number(settings.tol, "tolerance") if settings.tol.strip() else min(cell) / 1000,
        low=begin,
        high=end,
        structure=settings.surface[: -len(STRUTS_WORD)],
        cell=cell,
        cells=cells,
        diameter=diameter,
    )
    (folder / STRUTS_FILE).write_text(text, encoding="utf-8")


def name_field(text: str, fields: Sequence[str]) -> str:
    """The field of the form that a refusal is about: the one whose option or name the text has first, or none."""
    found = {name: re.search(rf"(?:--|\b){re.sub('_', '[-_ ]', name)}\b", text) for name in fields}
    named = {name: match.start() for name, match in found.items() if match}
    return min(named, key=named.__getitem__) if named else ""


def build_command(program: Sequence[str], settings: FillSettings) -> list[str]:
    """The words of a run in its folder.

    A value is joined to its option, so that a text with a minus is no option.
    """
    surface, of_field = settings.surface, {"kind": settings.kind}
    if surface == RECIPE_WORD:
        surface, of_field = os.path.abspath(os.path.expanduser(settings.recipe.strip())), {}
        if not os.path.isfile(surface):
            raise Refusal(
                f"recipe {settings.recipe!r} is no file: choose one; `tpmscad template solidify` prints an example"
            )
    elif surface.endswith(STRUTS_WORD):
        surface, of_field = STRUTS_FILE, {}
    else:
        of_field.update({"cell": settings.cell, settings.wall: settings.wall_value})
    passive = {}
    for name, text, file in (("keep", settings.keep, KEEP_FILE), ("clear", settings.clear, CLEAR_FILE)):
        holes, bodies = read_passive(text)
        passive[name] = ",".join([*([file] if bodies else []), *([holes] if holes else [])])
    options = {
        **of_field,
        **passive,
        "skin": settings.skin,
        "open-faces": number_faces(settings.open_faces),
        "tol": settings.tol,
    }
    given = [f"--{name}={value.strip()}" for name, value in options.items() if value.strip()]
    try:
        more = shlex.split(settings.more)
    except ValueError as error:
        raise Refusal(f"further options {settings.more!r}: {error}; close the quotation") from None
    files = [f"--output={FILLED_FILE}", f"--report={REPORT_FILE}", "--progress=lines"]
    return [*program, "infill", BODY_FILE, surface, *given, *more, *files]


def make_environment(environment: Mapping[str, str], folder: Path) -> dict[str, str]:
    """The variables for another Python than FreeCAD's, whose temporary files go to the folder of the run.

    A bundle's libraries (LD_LIBRARY_PATH below APPDIR) are left out, the user's own stay.
    """
    kept = {name: value for name, value in environment.items() if name not in HOST_VARIABLES}
    bundle = environment.get("APPDIR")
    if bundle and "LD_LIBRARY_PATH" in kept:
        folders = [path for path in kept["LD_LIBRARY_PATH"].split(os.pathsep) if not path.startswith(bundle)]
        kept["LD_LIBRARY_PATH"] = os.pathsep.join(folders)
        if not folders:
            del kept["LD_LIBRARY_PATH"]
    return {**kept, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder)), "PYTHONIOENCODING": "utf-8"}


def list_structures(program: Sequence[str], folder: Path) -> dict[str, dict[str, str]]:
    """The titles of what bodies are filled with by their names: the program's surfaces, cores and struts, and a recipe."""
    try:
        answer = subprocess.run(
            [*program, "surfaces", "--names"],
            env=make_environment(os.environ, folder),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=SURFACES_SECONDS,
        )
        listed = json.loads(answer.stdout)
        struts = {f"{name}{STRUTS_WORD}": title for name, title in listed["struts"].items()}
        return {**listed, "struts": struts, "recipes": {RECIPE_WORD: "Field of a recipe"}}
    except (OSError, ValueError, KeyError, TypeError, subprocess.TimeoutExpired) as error:
        said = answer.stderr.strip() if isinstance(error, ValueError) else ""
        raise Refusal(
            f"{program[0]} does not list its structures ({said or error}): give the program tpmscad, or a python that has it, "
            "in Edit > Preferences > tpmscad"
        ) from None


def save_command(command: Sequence[str], target: Path) -> list[str]:
    """The words of a run that writes the same solid to another file."""
    if target.suffix.lower() not in SAVED_SUFFIXES:
        raise Refusal(f"{target.name} ends in {target.suffix!r}: give it a name ending in {', '.join(SAVED_SUFFIXES)}")
    return [f"--output={target}" if word == f"--output={FILLED_FILE}" else word for word in command]


class FillRun:
    """A program that runs in its folder; `poll` it now and then.

    Attributes
    ----------
    command : list of str
    stage : str
        What is going on, in a word.
    done : float
        The part of the stage that is done, 0 if it is not known.
    """

    def __init__(self, command: Sequence[str], folder: Path) -> None:
        self.command, self.stage, self.done = list(command), "start", 0.0
        self._folder = folder
        self._other_lines: list[str] = []
        self._cancelled_at: float | None = None
        with open(folder / "stdout.txt", "wb") as out, open(folder / "stderr.txt", "wb") as err:
            try:
                self._process = subprocess.Popen(
                    self.command,
                    cwd=str(folder),
                    env=make_environment(os.environ, folder),
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                    start_new_session=os.name == "posix",  # a group, which is ended with its children
                )
            except OSError as error:
                raise Refusal(f"{self.command[0]} does not start: {error.strerror}") from None
        self._bytes_read, self._part = 0, b""

    def poll(self) -> bool:
        """Read the progress; whether the program has ended."""
        ended = self._process.poll() is not None
        self._read_messages(ended)
        if not ended and self._cancelled_at is not None and time.monotonic() - self._cancelled_at > GRACE_SECONDS:
            self._signal(kill=True)
        return ended

    def cancel(self) -> None:
        """Ask the program to end; `poll` until it has."""
        if self._cancelled_at is None and self._process.poll() is None:
            self._cancelled_at = time.monotonic()
            self._signal(kill=False)

    def kill(self) -> None:
        """End the program at once."""
        if self._process.poll() is None:
            self._cancelled_at = time.monotonic()
            self._signal(kill=True)
            self._process.wait()

    def wait(self, report: Callable[[str, float], None] | None = None) -> Filled:
        """The result, once there is one; `report` is called with stage and fraction as they change."""
        told = None
        try:
            while not self.poll():
                if report is not None and told != (self.stage, self.done):
                    told = (self.stage, self.done)
                    report(*told)
                time.sleep(0.1)
        except BaseException:  # of `report`, or an interrupt from the keyboard
            self.kill()
            raise
        return self.result()

    def result(self) -> Filled:
        """What was made, after the end; Refusal with the program's own words, or Cancelled."""
        status = self._process.wait()
        if self._cancelled_at is not None and status != 0:
            raise Cancelled("cancelled")
        if status != 0:
            said = [line for line in self._other_lines if line.startswith("tpmscad: ")] or self._other_lines[-3:]
            text = "\n".join(line.replace("tpmscad: ", "", 1) for line in said)
            raise Refusal(text or f"{self.command[0]} ended with status {status} and no word")
        summary = (self._folder / "stdout.txt").read_text(encoding="utf-8")
        lines = [line for line in summary.splitlines() if not line.startswith("wrote ")]
        report = (self._folder / REPORT_FILE).read_text(encoding="utf-8")
        return Filled(self._folder / FILLED_FILE, "\n".join(lines), report, tuple(self._other_lines))

    def _read_messages(self, ended: bool) -> None:
        """Take the new lines of standard error: steps, and others. The last one may be incomplete until the end."""
        with open(self._folder / "stderr.txt", "rb") as messages:
            messages.seek(self._bytes_read)
            added = messages.read()
        self._bytes_read += len(added)
        *lines, self._part = (self._part + added).split(b"\n")
        if ended:
            lines, self._part = [*lines, self._part], b""
        for line in (line.decode("utf-8", "replace").strip() for line in lines):
            try:
                step = json.loads(line)
                self.stage, self.done = str(step["stage"]), float(step["done"])
            except (ValueError, KeyError, TypeError):
                if line:
                    self._other_lines.append(line)

    def _signal(self, kill: bool) -> None:
        """Interrupt the program and its children, or kill them."""
        if os.name != "posix":
            self._process.kill()
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL if kill else signal.SIGINT)
