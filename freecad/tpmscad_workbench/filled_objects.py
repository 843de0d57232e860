"""Bodies of a FreeCAD document to STEP files, and filled bodies back to document objects. Needs FreeCAD, but not its windows.

`fill` is the whole way, for macros:

    from freecad.tpmscad_workbench import filled_objects, infill_run
    filled_objects.fill(body, infill_run.FillSettings(surface="gyroid", cell="8", wall_value="1", skin="1.5"))
"""

from __future__ import annotations

import shlex
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import FreeCAD
import Part

from freecad.tpmscad_workbench.infill_run import (
    BODY_FILE,
    CLEAR_FILE,
    KEEP_FILE,
    STRUTS_FILE,
    STRUTS_WORD,
    Filled,
    FillRun,
    FillSettings,
    Refusal,
    build_command,
    find_program,
    number_faces,
    read_passive,
    save_command,
    write_struts,
)

PREFERENCES = "User parameter:BaseApp/Preferences/Mod/tpmscad"
"""The group of parameters; its text `Program` is the path of tpmscad, or of a python that has it."""

GROUP = "tpmscad"
"""The group of an object's properties."""

PROPERTIES = {
    "Body": ("App::PropertyLinkGlobal", "The body that is filled."),
    "Certificate": ("App::PropertyStringList", "What tpmscad measured on the solid, in words."),
    "ReadBack": ("App::PropertyString", "What FreeCAD's own kernel finds of the solid."),
    "Command": ("App::PropertyString", "The command that made the solid from the body's STEP file."),
    "Settings": ("App::PropertyString", "What was asked for, as JSON; the panel begins with it."),
    "Report": ("App::PropertyString", "Every figure of the certificate, as JSON."),
    "Cavities": ("App::PropertyVectorList", "The middles of closed cavities, in which powder or resin stays."),
    "Mass": ("App::PropertyFloat", "Grams: the volume times the density."),
    "SolidFile": ("App::PropertyFileIncluded", "The STEP file that tpmscad wrote, kept in the document."),
    "BodyFile": ("App::PropertyFileIncluded", "The body as it was filled."),
    "KeepFile": ("App::PropertyFileIncluded", "The bodies that were kept solid."),
    "ClearFile": ("App::PropertyFileIncluded", "The bodies that were kept empty."),
    "StrutsFile": ("App::PropertyFileIncluded", "The recipe of struts."),
}
"""The properties of a filled body: type and meaning."""

INPUT_FILES = {"BodyFile": BODY_FILE, "KeepFile": KEEP_FILE, "ClearFile": CLEAR_FILE, "StrutsFile": STRUTS_FILE}
"""The files that a run reads, by the property that keeps each."""

DENSITY, DEFAULT_DENSITY = "Density", 1.0
"""The one property that is edited, and its first value, g/cm3."""

SAME_PLACE = 1e-6
"""Distance of the centres of a face before and after the file, in diagonals of the body, up to which it is the same face."""

SAME_VOLUME = 1e-4
"""Relative difference of FreeCAD's volume from the certificate's that is told as a warning; 1e-9 was measured."""


def read_program() -> list[str]:
    """The words that start tpmscad, by the preferences."""
    return find_program(FreeCAD.ParamGet(PREFERENCES).GetString("Program", ""))


def is_filled(thing: Any) -> bool:
    """Whether a document object is a body that was filled."""
    return hasattr(thing, "Settings") and getattr(thing, "Body", None) is not None


def placed_shape(body: Any) -> Any:
    """The shape of a body in coordinates of the document; Refusal if it holds no solid."""
    shape = Part.getShape(body)
    if shape.isNull() or not shape.Solids:
        raise Refusal(f"{body.Label} holds no solid: select a body, not a sketch, a surface or a mesh")
    if hasattr(body, "getGlobalPlacement"):
        shape = shape.copy()
        shape.Placement = body.getGlobalPlacement()
    elif any(parent.isDerivedFrom("App::Part") for parent in body.InList):  # a link of FreeCAD 0.20
        raise Refusal(f"the place of {body.Label} within its part is not known: select what it links to")
    return shape


def is_face_of(body: Any, thing: Any) -> bool:
    """Whether the faces of a selected object are those of the body: itself, or the last feature of a body of PartDesign."""
    names = [owner.Name for owner in (body, getattr(body, "Tip", None)) if owner is not None]
    return thing.Document.Name == body.Document.Name and thing.Name in names


def export_body(body: Any, open_faces: str, folder: Path) -> None:
    """Write the STEP file of a body, in coordinates of the document, for a run in a folder.

    Refusal if it holds no solid, or if a face that is named would have another number in the file.
    """
    placed = placed_shape(body)
    path = str(folder / BODY_FILE)
    placed.exportStep(path)
    if number_faces(open_faces) == open_faces:
        return
    if len(placed.Solids) > 1:
        raise Refusal(
            f"{body.Label} holds {len(placed.Solids)} solids, whose faces the file counts one solid at a time: name openings by "
            "selectors such as >Z, or fill one solid"
        )
    written = Part.Shape()
    written.read(path)
    near = SAME_PLACE * placed.BoundBox.DiagonalLength
    apart = [(a.CenterOfMass - b.CenterOfMass).Length for a, b in zip(placed.Faces, written.Faces)]
    if len(written.Faces) != len(placed.Faces) or max(apart) > near:
        raise Refusal(
            f"the STEP file of {body.Label} counts its faces in another order: name openings by selectors such as >Z"
        )


def find_bodies(document: Any, names: Sequence[str], field: str) -> list[Any]:
    """The objects with these labels or names; Refusal that names the field."""
    found: list[Any] = []
    for name in names:
        these = document.getObjectsByLabel(name) or [one for one in [document.getObject(name)] if one is not None]
        if len(these) != 1:
            wrong = f"{len(these)} bodies are" if these else "no body is"
            raise Refusal(
                f"{field}: {wrong} called {name!r} in this document; select bodies in the tree and press Bodies"
            )
        found += these
    return found


def start(body: Any, settings: FillSettings, program: list[str], folder: Path) -> FillRun:
    """Write the body, and what is kept and cleared, to a folder and start the run there."""
    command = build_command(program, settings)
    for file in INPUT_FILES.values():
        if (folder / file).exists():
            (folder / file).unlink()
    for field, text, file in (("keep", settings.keep, KEEP_FILE), ("clear", settings.clear, CLEAR_FILE)):
        names = read_passive(text)[1]
        if names:
            shapes = [placed_shape(one) for one in find_bodies(body.Document, names, field)]
            Part.makeCompound([solid for shape in shapes for solid in shape.Solids]).exportStep(str(folder / file))
    if settings.surface.endswith(STRUTS_WORD):
        box = placed_shape(body).BoundBox
        write_struts(settings, (box.XMin, box.YMin, box.ZMin), (box.XMax, box.YMax, box.ZMax), folder)
    export_body(body, settings.open_faces, folder)
    return FillRun(command, folder)


def start_saving(filled: Any, target: Path, folder: Path) -> FillRun | None:
    """Save a filled body: a copy of its own STEP file at once (None), or a run that makes it anew in another format."""
    command = save_command(shlex.split(filled.Command), target)
    if target.suffix.lower() == ".step":
        shutil.copyfile(filled.SolidFile, str(target))
        return None
    for name, file in INPUT_FILES.items():
        if getattr(filled, name):
            shutil.copyfile(getattr(filled, name), str(folder / file))
    return FillRun(command, folder)


def save(filled: Any, target: str) -> None:
    """Save a filled body as .step, .3mf or .stl, by tpmscad itself; Refusal if it cannot be made."""
    with tempfile.TemporaryDirectory(prefix="tpmscad-") as name:
        run = start_saving(filled, Path(target).absolute(), Path(name))
        if run is not None:
            run.wait()


def find_cavities(shape: Any) -> list[tuple[Any, float]]:
    """The middle and the volume of each closed cavity of the solids of a shape, largest first."""
    found = []
    for solid in shape.Solids:
        outer = solid.OuterShell
        shells = [shell for shell in solid.Shells if not shell.isSame(outer)]
        found += [(shell.BoundBox.Center, abs(shell.Volume)) for shell in shells]
    return sorted(found, key=lambda one: -one[1])


def store(body: Any, settings: FillSettings, run: FillRun, filled: Filled, target: Any = None) -> Any:
    """The object of a filled body in the body's document, a new one or `target`, within one step of undo."""
    shape = Part.Shape()
    shape.read(str(filled.step))
    document = body.Document
    document.openTransaction("Fill with a lattice")
    if target is None:
        target = document.addObject("Part::Feature", "Filled")
        target.Label = f"{body.Label} filled"
        for name, (kind, meaning) in PROPERTIES.items():
            target.addProperty(kind, name, GROUP, meaning)
            target.setEditorMode(name, 1)  # shown, not edited
        target.addProperty("App::PropertyFloat", DENSITY, GROUP, "Density of the material, g/cm3.")
        target.Density = DEFAULT_DENSITY
        target.setExpression("Mass", "Shape.Volume / 1 mm^3 * Density / 1000")
    target.Shape = shape
    target.Body = body
    target.Certificate = [*filled.summary.splitlines(), *(f"warning {line}" for line in filled.warnings)]
    target.ReadBack = describe(shape, float(filled.certificate["volume"]))
    target.Command = shlex.join(run.command)
    target.Settings = settings.to_json()
    target.Report = filled.report
    target.Cavities = [centre for centre, _ in find_cavities(shape)]
    target.SolidFile = str(filled.step)
    for name, file in INPUT_FILES.items():
        path = filled.step.parent / file
        setattr(target, name, str(path) if path.exists() else "")
    if getattr(body, "ViewObject", None) is not None:
        body.ViewObject.Visibility = False
    target.recompute()
    document.commitTransaction()
    return target


def describe(shape: Any, volume: float) -> str:
    """What FreeCAD's kernel finds of a solid, and WARNING before it if that is not what the certificate says."""
    apart = abs(shape.Volume / volume - 1.0)
    valid = shape.isValid()
    text = f"{'valid' if valid else 'not valid'}, {len(shape.Solids)} solid(s), volume {shape.Volume:.9g} mm3"
    text += f", {apart:.1g} from the certificate's"
    return text if valid and apart <= SAME_VOLUME else f"WARNING: {text}"


def fill(
    body: Any,
    settings: FillSettings,
    report: Callable[[str, float], None] | None = None,
) -> Any:
    """The document object of a body filled with a lattice; Refusal with the remedy if it cannot be made.

    Parameters
    ----------
    body : document object
        What has a shape with a solid.
    settings : FillSettings
    report : function of a stage and the part of it that is done, optional

    Returns
    -------
    document object
        A Part::Feature with the properties of `PROPERTIES`.
    """
    with tempfile.TemporaryDirectory(prefix="tpmscad-") as name:
        run = start(body, settings, read_program(), Path(name))
        return store(body, settings, run, run.wait(report), None)
