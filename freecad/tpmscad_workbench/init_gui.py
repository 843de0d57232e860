"""The workbench and its page of preferences, which FreeCAD registers as its windows open."""

from __future__ import annotations

from pathlib import Path

import FreeCADGui

FOLDER = Path(__file__).parent
ICONS = FOLDER / "icons"


class TpmscadWorkbench(FreeCADGui.Workbench):  # type: ignore[misc] # FreeCAD has no types
    """A toolbar and a menu with one command."""

    MenuText = "tpmscad"
    ToolTip = "Fill bodies with gyroids and other minimal surfaces, as exact solids"
    Icon = str(ICONS / "tpmscad.svg")

    def Initialize(self) -> None:
        """Register the command, when the workbench is first opened."""
        from freecad.tpmscad_workbench import fill_panel

        fill_panel.add_command(str(ICONS / "tpmscad-fill.svg"))
        self.appendToolbar("tpmscad", [fill_panel.COMMAND])
        self.appendMenu("tpmscad", [fill_panel.COMMAND])

    def GetClassName(self) -> str:
        """The kind of workbench, in FreeCAD's words."""
        return "Gui::PythonWorkbench"


FreeCADGui.addIconPath(str(ICONS))
FreeCADGui.addPreferencePage(str(FOLDER / "preferences.ui"), "tpmscad")
FreeCADGui.addWorkbench(TpmscadWorkbench())
