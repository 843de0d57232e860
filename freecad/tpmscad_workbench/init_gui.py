"""The workbench and its page of preferences, which FreeCAD registers as its windows open."""

from __future__ import annotations

from pathlib import Path

import FreeCADGui

FOLDER = Path(__file__).parent
ICONS = FOLDER / "icons"


class TpmscadWorkbench(FreeCADGui.Workbench):  # type: ignore[misc] # FreeCAD has no types
    """A toolbar and a menu with two commands."""

    MenuText = "tpmscad"
    ToolTip = "Fill bodies with gyroids and other minimal surfaces, as exact solids"
    Icon = str(ICONS / "tpmscad.svg")

    def Initialize(self) -> None:
        """Register the commands, when the workbench is first opened."""
        from freecad.tpmscad_workbench import fill_panel

        fill_panel.add_commands(str(ICONS / "tpmscad-fill.svg"), str(ICONS / "tpmscad.svg"))
        commands = [fill_panel.COMMAND, fill_panel.SAVE_COMMAND]
        self.appendToolbar("tpmscad", commands)
        self.appendMenu("tpmscad", commands)

    def GetClassName(self) -> str:
        """The kind of workbench, in FreeCAD's words."""
        return "Gui::PythonWorkbench"


FreeCADGui.addIconPath(str(ICONS))
FreeCADGui.addPreferencePage(str(FOLDER / "preferences.ui"), "tpmscad")
FreeCADGui.addWorkbench(TpmscadWorkbench())
