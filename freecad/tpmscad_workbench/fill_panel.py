"""The command and its panel: a form over one run, whose progress a timer asks for."""

from __future__ import annotations

import functools
import shutil
import tempfile
from pathlib import Path
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from freecad.tpmscad_workbench import filled_objects
from freecad.tpmscad_workbench.infill_run import (
    HOLES,
    RECIPE_WORD,
    SAVED_SUFFIXES,
    STRUTS_WORD,
    WALLS,
    Cancelled,
    FillRun,
    FillSettings,
    Refusal,
    list_structures,
    name_field,
)

COMMAND, SAVE_COMMAND = "Tpmscad_Fill", "Tpmscad_Save"

POLL_MILLISECONDS = 200

FIELDS = {
    "recipe": (
        "Recipe",
        "A TOML file whose field fills the body; `tpmscad template solidify` prints one",
        "a .toml file",
    ),
    "cell": ("Cell", "Edge length of the cell in mm, or three with commas between", "mm"),
    "skin": ("Skin", "Thickness of a solid wall along the boundary in mm", "none"),
    "open_faces": (
        "Openings",
        "Plane faces without a skin: Face3, or >Z for those at the top; with commas between",
        "none",
    ),
    "keep": (
        "Keep solid",
        "Bodies of the document, and holes 3 for 3 mm round every round hole, with commas between",
        "none",
    ),
    "clear": (
        "Keep empty",
        "Bodies of the document with commas between",
        "none",
    ),
    "tol": ("Tolerance", "Greatest deviation from the surface in mm", "cell / 1000"),
    "more": ("Options", "Further options of `tpmscad infill`, as --phase 0,0,0.25", "none"),
}
"""Texts of the settings: label, hint, and what stands in the field while it is empty."""

BUTTON_WIDTH = 60
"""Pixels, so that texts beside buttons fit in the narrow column."""

TOLD = ("met", "not met", "solid", "size", "deviation", "warning")
"""First words of the lines of a certificate that the panel shows; the property Certificate has all."""

BUTTON_HINTS = {
    "open_faces": "Take the faces that are selected in the model",
    "keep": "Take the bodies that are selected in the tree",
    "clear": "Take the bodies that are selected in the tree",
    "recipe": "Choose the file",
}
"""What the buttons beside the texts do."""

NEEDS_BODY = "select one body, and close the panel that is open, to fill it"
NEEDS_FILLED = "select one body that was filled with a lattice to save it"
"""Why the commands cannot run."""


class FillCommand:
    """Opens the panel for the selected body, or for a filled one with the settings it was made with."""

    def __init__(self, icon: str) -> None:
        self._icon = icon

    def GetResources(self) -> dict[str, str]:
        """What menu and toolbar show."""
        return {
            "MenuText": "Fill with a lattice...",
            "ToolTip": "Fill the selected body with a lattice, or a filled one anew",
            "Pixmap": self._icon,
        }

    def Activated(self) -> None:
        """Open the panel, or say what is missing: a grey command could not."""
        chosen = FreeCADGui.Selection.getSelection()
        if len(chosen) != 1 or FreeCADGui.Control.activeDialog():
            say(NEEDS_BODY)
            return
        FreeCADGui.Control.showDialog(FillPanel(chosen[0]))


class SaveCommand:
    """Saves the selected filled body by the program that made it."""

    def __init__(self, icon: str) -> None:
        self._icon = icon

    def GetResources(self) -> dict[str, str]:
        """What menu and toolbar show."""
        return {
            "MenuText": "Save the filled body as...",
            "ToolTip": "Save the selected filled body as STEP, 3MF or STL by tpmscad itself",
            "Pixmap": self._icon,
        }

    def Activated(self) -> None:
        """Ask for the file and open the panel of the run."""
        chosen = FreeCADGui.Selection.getSelection()
        if len(chosen) != 1 or not filled_objects.is_filled(chosen[0]) or FreeCADGui.Control.activeDialog():
            say(NEEDS_FILLED)
            return
        kinds = ";;".join(f"{suffix[1:].upper()} (*{suffix})" for suffix in SAVED_SUFFIXES)
        window = FreeCADGui.getMainWindow()
        path, kind = QtGui.QFileDialog.getSaveFileName(window, "Save the filled body", f"{chosen[0].Label}.step", kinds)
        if path:
            target = Path(path) if Path(path).suffix else Path(path).with_suffix(f".{kind.split()[0].lower()}")
            FreeCADGui.Control.showDialog(SavePanel(chosen[0], target))


def say(text: str) -> None:
    """Tell in the report view, and in a message that waits for nobody, why a command does nothing."""
    FreeCAD.Console.PrintWarning(f"tpmscad: {text}\n")
    window = FreeCADGui.getMainWindow()
    QtGui.QMessageBox(QtGui.QMessageBox.Information, "tpmscad", text, QtGui.QMessageBox.Ok, window).show()


def add_commands(fill_icon: str, save_icon: str) -> None:
    """Register the commands with the paths of their icons."""
    FreeCADGui.addCommand(COMMAND, FillCommand(fill_icon))
    FreeCADGui.addCommand(SAVE_COMMAND, SaveCommand(save_icon))


class RunPanel:
    """What panels of a run share: a temporary folder, the timer, the button Close."""

    def __init__(self) -> None:
        self._run: FillRun | None = None
        self._folder = Path(tempfile.mkdtemp(prefix="tpmscad-"))
        self._timer = QtCore.QTimer()
        self._timer.setInterval(POLL_MILLISECONDS)
        self._timer.timeout.connect(self._tick)
        self._bar, self._message = QtGui.QProgressBar(), QtGui.QLabel()
        self._message.setWordWrap(True)
        self._message.setTextInteractionFlags(QtCore.Qt.TextSelectableByMouse)

    def _tick(self) -> None:
        """Show the progress, and the result at the end."""
        run = self._run
        if run is None:
            return
        ended = run.poll()
        self._bar.setRange(0, 100 if run.done else 0)  # moves to and fro while no fraction is known
        self._bar.setValue(round(100 * run.done))
        self._bar.setFormat(f"{run.stage} %p%")
        if ended:
            self._timer.stop()
            self._run = None
            self._bar.hide()
            self._finish(run)

    def _finish(self, run: FillRun) -> None:
        """Take the result."""
        raise NotImplementedError

    def getStandardButtons(self) -> int:
        """The button Close, as a number in every version of Qt."""
        close = QtGui.QDialogButtonBox.Close
        try:
            return int(close)
        except TypeError:
            return int(close.value)

    def reject(self) -> bool:
        """Close the panel, and end a run that is going on."""
        self._timer.stop()
        if self._run is not None:
            self._run.kill()
        shutil.rmtree(self._folder, ignore_errors=True)
        FreeCADGui.Control.closeDialog()
        return True


class SavePanel(RunPanel):
    """The progress of saving a filled body."""

    def __init__(self, filled: Any, target: Path) -> None:
        super().__init__()
        self._saved = target
        self.form = QtGui.QWidget()
        self.form.setWindowTitle(f"Save {filled.Label}")
        rows = QtGui.QVBoxLayout(self.form)
        for widget in (self._message, self._bar):
            rows.addWidget(widget)
        self._message.setText(f"{target.name} is being made")
        try:
            self._run = filled_objects.start_saving(filled, target, self._folder)
        except (Refusal, OSError) as error:
            self._show_end(str(error), wrong=True)
            return
        if self._run is None:
            self._show_end(self._describe())
        else:
            self._timer.start()

    def _finish(self, run: FillRun) -> None:
        """Say what was saved."""
        try:
            run.result()
            self._show_end(self._describe())
        except (Refusal, Cancelled) as refusal:
            self._show_end(str(refusal), wrong=True)

    def _describe(self) -> str:
        """The file and its size."""
        return f"saved {self._saved.name}, {self._saved.stat().st_size / 1e6:.1f} MB, by tpmscad"

    def _show_end(self, text: str, wrong: bool = False) -> None:
        """Show the last message."""
        self._bar.hide()
        self._message.setStyleSheet("color: #c01c28" if wrong else "")
        self._message.setText(text)


MAX_PLACES = 6
"""Closed cavities whose places the panel lists."""


class FillPanel(RunPanel):
    """The form of the settings, with the progress and the messages of one run."""

    def __init__(self, selected: Any) -> None:
        self._target = selected if filled_objects.is_filled(selected) else None
        self._body = selected.Body if self._target else selected
        super().__init__()
        self._build()
        self._show(FillSettings.from_json(selected.Settings) if self._target else FillSettings())

    def _build(self) -> None:
        """The widgets."""
        self.form = QtGui.QWidget()
        self.form.setWindowTitle(f"Fill {self._body.Label}")
        self._rows = rows = QtGui.QFormLayout(self.form)
        self._surface, self._kind, self._wall = QtGui.QComboBox(), QtGui.QComboBox(), QtGui.QComboBox()
        self._kind.addItems(["sheet", "skeletal"])
        self._wall.addItems(WALLS)
        self._wall_value = QtGui.QLineEdit()
        self._texts = {name: QtGui.QLineEdit() for name in FIELDS}
        self._take = QtGui.QPushButton("Faces")
        self._take.clicked.connect(self.take_selected_faces)
        self._bodies = {name: QtGui.QPushButton("Bodies") for name in ("keep", "clear")}
        for name, button in self._bodies.items():
            button.clicked.connect(functools.partial(self.take_selected_bodies, name))
        self._browse = QtGui.QPushButton("File")
        self._browse.clicked.connect(self.choose_recipe)
        self._surface.currentIndexChanged.connect(self._show_what_counts)
        self._start = QtGui.QPushButton("Fill")
        self._start.clicked.connect(self.start_or_cancel)
        self._bar.hide()
        self._labels: dict[str, Any] = {}
        rows.addRow("Structure", self._surface)
        rows.addRow("Kind", self._kind)
        buttons = {"open_faces": self._take, "recipe": self._browse, **self._bodies}
        for name, (label, hint, empty) in FIELDS.items():
            self._texts[name].setToolTip(hint)
            self._texts[name].setPlaceholderText(empty)
            line = QtGui.QHBoxLayout()
            line.addWidget(self._texts[name], 1)
            if name in buttons:
                line.addWidget(buttons[name])
                buttons[name].setMaximumWidth(BUTTON_WIDTH)
                buttons[name].setToolTip(BUTTON_HINTS[name])
            self._labels[name] = QtGui.QLabel(label)
            rows.addRow(self._labels[name], line)
            if name == "cell":
                rows.addRow("Wall", self._wall)
                rows.addRow("", self._wall_value)
        for widget in (self._surface, self._kind, self._wall, self._wall_value, *self._texts.values()):
            widget.setMinimumWidth(40)  # the column of panels is narrow
        for place, widget in enumerate((self._start, self._bar, self._message)):
            rows.insertRow(place, widget)  # above the settings, in sight however low the window is

    def _show(self, settings: FillSettings) -> None:
        """Fill the form."""
        structures = {"surfaces": {settings.surface: settings.surface}}
        try:
            structures = list_structures(filled_objects.read_program(), self._folder)
        except Refusal as refusal:
            self._tell(str(refusal), wrong=True)
        self._surface.setSizeAdjustPolicy(QtGui.QComboBox.AdjustToMinimumContentsLengthWithIcon)
        self._have_kinds = set(structures["surfaces"])
        for titles in structures.values():
            for name, title in titles.items():
                self._surface.addItem(title, name)
        self._surface.setCurrentIndex(max(0, self._surface.findData(settings.surface)))
        self._kind.setCurrentIndex(self._kind.findText(settings.kind))
        self._wall.setCurrentIndex(self._wall.findText(settings.wall))
        self._wall_value.setText(settings.wall_value)
        for name in self._texts:
            self._write(name, getattr(settings, name))
        self._show_what_counts()

    def _show_what_counts(self) -> None:
        """Grey out the fields that the structure does not have, and say why."""
        name = str(self._surface.currentData())
        is_recipe, is_struts = name == RECIPE_WORD, name.endswith(STRUTS_WORD)
        why = "" if not is_recipe else "the recipe says so"
        for widget in (self._wall_value, self._texts["cell"]):
            widget.setEnabled(not is_recipe)
        for widget in (self._labels["recipe"], self._texts["recipe"], self._browse):
            widget.setVisible(is_recipe)
        self._wall.setEnabled(not (is_recipe or is_struts))
        self._wall.setToolTip(
            why or ("of struts the thickness is their diameter" if is_struts else "What defines the wall")
        )
        self._kind.setEnabled(name in self._have_kinds)
        if not self._kind.isEnabled():
            self._kind.setCurrentIndex(0)
        self._kind.setToolTip("" if self._kind.isEnabled() else "kinds are those of surfaces alone")
        if is_struts:
            self._wall.setCurrentIndex(0)

    def choose_recipe(self) -> None:
        """Ask for the TOML file."""
        path, _ = QtGui.QFileDialog.getOpenFileName(self.form, "Recipe of a field", "", "TOML (*.toml)")
        if path:
            self._texts["recipe"].setText(path)

    def take_selected_bodies(self, field: str, *_: Any) -> None:
        """Write the labels of the selected bodies, but the one that is filled, into a field."""
        chosen = [
            one
            for one in FreeCADGui.Selection.getSelection()
            if one.Name not in (self._body.Name, self._target and self._target.Name)
        ]
        if not chosen:
            self._tell(f"{FIELDS[field][0]}: no other body is selected: select bodies in the tree", wrong=True)
            return
        holes = [part.strip() for part in self._texts[field].text().split(",") if HOLES.fullmatch(part.strip())]
        self._write(field, ", ".join([*(one.Label for one in chosen), *holes]))
        self._tell("")

    def _write(self, field: str, text: str) -> None:
        """Write a text into a field, its beginning in sight, and whole under the pointer."""
        self._texts[field].setText(text)
        self._texts[field].setCursorPosition(0)
        self._texts[field].setToolTip(f"{FIELDS[field][1]}\n{text}" if text else FIELDS[field][1])

    def read(self) -> FillSettings:
        """The settings in the form."""
        return FillSettings(
            surface=self._surface.currentData(),
            kind=self._kind.currentText(),
            wall=self._wall.currentText(),
            wall_value=self._wall_value.text(),
            **{name: text.text() for name, text in self._texts.items()},
        )

    def take_selected_faces(self) -> None:
        """Write the names of the faces that are selected in the model into the openings."""
        chosen = FreeCADGui.Selection.getSelectionEx()
        names = [name for one in chosen for name in one.SubElementNames if name.startswith("Face")]
        others = {one.Object.Label for one in chosen if not filled_objects.is_face_of(self._body, one.Object)}
        if others or not names:
            wrong = f"faces of {', '.join(sorted(others))} are" if others else "no face is"
            self._tell(f"{wrong} selected: select plane faces of {self._body.Label} in the model", wrong=True)
            return
        self._write("open_faces", ", ".join(names))
        self._tell("")

    def start_or_cancel(self) -> None:
        """Start a run, or ask the one that is going on to end."""
        if self._run is not None:
            self._run.cancel()
            self._tell("cancelling")
            return
        self._settings = self.read()
        try:
            self._run = filled_objects.start(self._body, self._settings, filled_objects.read_program(), self._folder)
        except Refusal as refusal:
            self._tell(str(refusal), wrong=True)
            return
        self._start.setText("Cancel")
        self._bar.show()
        self._tell("")
        self._timer.start()

    def _finish(self, run: FillRun) -> None:
        """Show the result."""
        try:
            self._target = filled_objects.store(self._body, self._settings, run, run.result(), self._target)
            places = [f"closed cavity at {p.x:.4g}, {p.y:.4g}, {p.z:.4g}" for p in self._target.Cavities]
            if len(places) > MAX_PLACES:
                places[MAX_PLACES:] = [f"and {len(places) - MAX_PLACES} more: see the property Cavities"]
            mass = f"mass {self._target.Mass:.4g} g of {self._target.Density:g} g/cm3"
            told = [" ".join(line.split()) for line in self._target.Certificate if line.startswith(TOLD)]
            self._tell("\n".join([*told, *places, mass, f"in FreeCAD: {self._target.ReadBack}"]))
        except Refusal as refusal:
            self._tell(str(refusal), wrong=True)
        except Cancelled:
            self._tell("cancelled")
        self._start.setText("Fill anew" if self._target else "Fill")

    def _tell(self, text: str, wrong: bool = False) -> None:
        """Show a message; what is wrong is red, as is the field that it is about, and goes to the report view, too."""
        about = name_field(text, [*FIELDS, "wall", *WALLS, "kind"]) if wrong else ""
        edits = {**self._texts, **dict.fromkeys(("wall", *WALLS), self._wall_value), "kind": self._kind}
        for edit in edits.values():
            edit.setStyleSheet("border: 1px solid #c01c28" if edit is edits.get(about) else "")
        label = FIELDS[about][0] if about in FIELDS else "Kind" if about == "kind" else "Wall"
        text = f"{label}: {text}" if about else text
        self._message.setStyleSheet("color: #c01c28" if wrong else "")
        self._message.setText(text)
        if wrong:
            FreeCAD.Console.PrintError(f"tpmscad: {text}\n")
