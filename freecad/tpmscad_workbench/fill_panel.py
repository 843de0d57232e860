"""The command and its panel: a form over one run, whose progress a timer asks for."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from freecad.tpmscad_workbench import filled_objects
from freecad.tpmscad_workbench.infill_run import WALLS, Cancelled, FillRun, FillSettings, Refusal, list_surfaces

COMMAND = "Tpmscad_Fill"

POLL_MILLISECONDS = 200

FIELDS = {
    "cell": ("Cell", "Edge length of the cell in mm, or three with commas between"),
    "skin": ("Skin", "Thickness of a solid wall along the boundary in mm; empty: none"),
    "open_faces": ("Openings", "Plane faces without a skin: Face3, or >Z for those at the top; with commas between"),
    "tol": ("Tolerance", "Greatest deviation from the surface in mm; empty: a thousandth of the cell"),
    "more": ("Further options", "Options of `tpmscad infill`, as --phase 0,0,0.25"),
}
"""Texts of the settings: label and hint."""


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

    def IsActive(self) -> bool:
        """Whether one object is selected, and no other panel is open."""
        return len(FreeCADGui.Selection.getSelection()) == 1 and not FreeCADGui.Control.activeDialog()

    def Activated(self) -> None:
        """Open the panel."""
        FreeCADGui.Control.showDialog(FillPanel(FreeCADGui.Selection.getSelection()[0]))


def add_command(icon: str) -> None:
    """Register the command with the path of its icon."""
    FreeCADGui.addCommand(COMMAND, FillCommand(icon))


class FillPanel:
    """The form of the settings, with the progress and the messages of one run."""

    def __init__(self, selected: Any) -> None:
        self._target = selected if filled_objects.is_filled(selected) else None
        self._body = selected.Body if self._target else selected
        self._run: FillRun | None = None
        self._folder = Path(tempfile.mkdtemp(prefix="tpmscad-"))
        self._timer = QtCore.QTimer()
        self._timer.setInterval(POLL_MILLISECONDS)
        self._timer.timeout.connect(self._tick)
        self._build()
        self._show(FillSettings.from_json(selected.Settings) if self._target else FillSettings())

    def _build(self) -> None:
        """The widgets."""
        self.form = QtGui.QWidget()
        self.form.setWindowTitle(f"Fill {self._body.Label}")
        rows = QtGui.QFormLayout(self.form)
        self._surface, self._kind, self._wall = QtGui.QComboBox(), QtGui.QComboBox(), QtGui.QComboBox()
        self._kind.addItems(["sheet", "skeletal"])
        self._wall.addItems(WALLS)
        self._wall_value = QtGui.QLineEdit()
        self._texts = {name: QtGui.QLineEdit() for name in FIELDS}
        self._take = QtGui.QPushButton("Selected faces")
        self._take.clicked.connect(self.take_selected_faces)
        self._start = QtGui.QPushButton("Fill")
        self._start.clicked.connect(self.start_or_cancel)
        self._bar, self._message = QtGui.QProgressBar(), QtGui.QLabel()
        self._bar.hide()
        self._message.setWordWrap(True)
        self._message.setTextInteractionFlags(QtCore.Qt.TextSelectableByMouse)
        wall = QtGui.QHBoxLayout()
        wall.addWidget(self._wall)
        wall.addWidget(self._wall_value, 1)
        rows.addRow("Surface", self._surface)
        rows.addRow("Kind", self._kind)
        for name, (label, hint) in FIELDS.items():
            self._texts[name].setToolTip(hint)
            self._texts[name].setPlaceholderText(hint.partition(";")[2].strip())
            rows.addRow(label, self._texts[name])
            if name == "cell":
                rows.addRow("Wall", wall)
            if name == "open_faces":
                rows.addRow("", self._take)
        for widget in (self._surface, self._kind, self._wall, self._wall_value, *self._texts.values()):
            widget.setMinimumWidth(40)  # the column of panels is narrow
        for widget in (self._start, self._bar, self._message):
            rows.addRow(widget)

    def _show(self, settings: FillSettings) -> None:
        """Fill the form."""
        surfaces = {settings.surface: settings.surface}
        try:
            surfaces = list_surfaces(filled_objects.read_program(), self._folder)
        except Refusal as refusal:
            self._tell(str(refusal), wrong=True)
        for name, title in surfaces.items():
            self._surface.addItem(title, name)
        self._surface.setCurrentIndex(max(0, self._surface.findData(settings.surface)))
        self._kind.setCurrentIndex(self._kind.findText(settings.kind))
        self._wall.setCurrentIndex(self._wall.findText(settings.wall))
        self._wall_value.setText(settings.wall_value)
        for name, text in self._texts.items():
            text.setText(getattr(settings, name))

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
        self._texts["open_faces"].setText(", ".join(names))
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

    def _tick(self) -> None:
        """Show the progress, and the result at the end."""
        run = self._run
        if run is None:
            return
        ended = run.poll()
        self._bar.setRange(0, 100 if run.done else 0)  # moves to and fro while no fraction is known
        self._bar.setValue(round(100 * run.done))
        self._bar.setFormat(f"{run.stage} %p%")
        if not ended:
            return
        self._timer.stop()
        self._run = None
        try:
            self._target = filled_objects.store(self._body, self._settings, run, run.result(), self._target)
            self._tell("\n".join([*self._target.Certificate, f"in FreeCAD: {self._target.ReadBack}"]))
        except Refusal as refusal:
            self._tell(str(refusal), wrong=True)
        except Cancelled:
            self._tell("cancelled")
        self._start.setText("Fill anew" if self._target else "Fill")
        self._bar.hide()

    def _tell(self, text: str, wrong: bool = False) -> None:
        """Show a message, and what is wrong in red; that goes to the report view, too."""
        self._message.setStyleSheet("color: #c01c28" if wrong else "")
        self._message.setText(text)
        if wrong:
            FreeCAD.Console.PrintError(f"tpmscad: {text}\n")

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
