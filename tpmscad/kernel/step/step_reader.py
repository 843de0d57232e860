"""Reading of STEP files with OCCT: every solid, placed copies included."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from OCP.IFSelect import IFSelect_RetDone
from OCP.Interface import Interface_Static
from OCP.Message import Message
from OCP.StepBasic import StepBasic_Product
from OCP.STEPConstruct import STEPConstruct_UnitContext
from OCP.STEPControl import STEPControl_Reader
from OCP.StepGeom import StepGeom_GeomRepContextAndGlobUnitAssCtxAndGlobUncertaintyAssCtx as GeometricContext
from OCP.StepRepr import StepRepr_NextAssemblyUsageOccurrence as AssemblyUsage
from OCP.StepRepr import StepRepr_RepresentationItem
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import READ_TRIANGLE_SUFFIXES, TRIANGLE_SUFFIXES
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.kernel.occt.exploration import faces_of, solids_of
from tpmscad.kernel.step.long_arcs import CircularEdges, find_circular_edges, turn_arcs
from tpmscad.kernel.step.sphere_seams import Frames, find_clear_frames, turn_spheres

PART21_MAGIC = b"ISO-10303-21;"

NO_NAME = "NONE"
"""What several programs write where a face has no name."""

SHAPE_FIX_MODES = (
    "FixSelfIntersectionMode",
    "FixIntersectingWiresMode",
    "FixLoopWiresMode",
    "FixNotchedEdgesMode",
    "FixTailMode",
    "FixSplitFaceMode",
    "FixSmallMode",
    "FixSmallAreaWireMode",
    "FixOrientationMode",
    "FixFaceOrientationMode",
    "FixShellOrientationMode",
    "FixSameParameterMode",
    "FixEdgeSameParameterMode",
)
"""Shape healing modes of OCCT's reader, which take more than half of its time. Modes that create pcurves, seams and degenerate
edges are not among them: a STEP file may omit these, but OCCT requires them."""


MAX_NAMED_SOLIDS = 100
"""Solids whose names are looked up: OCCT looks through all of the file for each."""

FITTING_PRECISION = 1e-7
"""Millimetres: OCCT's own confusion, below which edges and faces count as one."""

UNIT_NAMES = {1e-3: "micrometre", 1.0: "millimetre", 10.0: "centimetre", 1e3: "metre", 25.4: "INCH", 304.8: "FOOT"}
"""Names of units of length by their length in mm."""

MESH_REMEDY = " (it is a mesh of triangles: export the part as .step to check, measure or draw it)"
"""What to do with a file of triangles where a STEP file is read."""


@dataclass(frozen=True, slots=True, eq=False)
class StepContent:
    """Content of a file: all roots as one shape, its solids in file order, its length units and product names.

    face_names: of the faces of each solid, in the order of `faces_of`, if they were asked for; "" where the file names none.
    accuracy: the largest uncertainty of lengths that the file states, mm. is_assembly: parts are placed in others by the file.
    solid_names: the solids' own names, "" where the file names none; none in an assembly, where several have one.
    """

    shape: TopoDS_Shape
    solids: tuple[TopoDS_Solid, ...]
    units: tuple[str, ...]
    products: tuple[str, ...]
    face_names: tuple[tuple[str, ...], ...] = ()
    accuracy: float | None = None
    is_assembly: bool = False
    solid_names: tuple[str, ...] = ()

    @property
    def wrapped(self) -> TopoDS_Shape:
        """The shape, under the name that build123d and CadQuery use."""
        return self.shape


def read_step(
    path: str | os.PathLike[str],
    *,
    healed: bool = True,
    with_face_names: bool = False,
    with_clear_seams: bool = False,
    turned_arcs: Collection[int] = (),
    require_solid: bool = True,
) -> StepContent:
    """Read a STEP file in mm, whatever its unit, with the shape healing of OCCT's reader or without it.

    with_clear_seams: turn the frames of spheres with edges on their seams, as `sphere_seams` says. A file that is checked is
    read without, as other programs on OCCT read it. turned_arcs: circular edges that are given the other sense, see `long_arcs`.
    OCCT looks through all of the file for the name of each face, 16 ms in one of 5000 faces: 86 s for all of them.
    Raises InvalidRequest if the file does not exist, is no STEP file, cannot be parsed, or if it holds no solid and
    `require_solid`. The file must be one that this process wrote; others may crash OCCT (see `isolated_reader`).
    """
    path = require_step_file(Path(path))
    reader = _translate(path, healed, {}, turned_arcs)
    if with_clear_seams and (frames := find_clear_frames(reader, reader.OneShape())):
        reader = _translate(path, healed, frames, turned_arcs)
    shape = reader.OneShape()
    solids = tuple(solids_of(shape))
    if not solids and require_solid:
        raise missing_solid(path)
    names = tuple(_face_names(reader, solid) for solid in solids) if with_face_names else ()
    is_assembly = _is_assembly(reader)
    return StepContent(
        shape,
        solids,
        _length_units(reader),
        _product_names(reader),
        names,
        _stated_accuracy(reader),
        is_assembly,
        () if is_assembly else tuple(_entity_name(reader, solid) for solid in solids[:MAX_NAMED_SOLIDS]),
    )


def list_circular_edges(
    path: str | os.PathLike[str], find_suspects: Callable[[TopoDS_Shape], Iterable[TopoDS_Face]]
) -> CircularEdges:
    """The circular edges of a STEP file, given what finds the faces of its shape under suspicion; errors as `read_step`."""
    reader = _translate(require_step_file(Path(path)), True, {}, ())
    shape = reader.OneShape()
    return find_circular_edges(reader, faces_of(shape), find_suspects(shape))


def _translate(path: Path, healed: bool, frames: Frames, turned_arcs: Collection[int]) -> STEPControl_Reader:
    """The reader of a file with its shapes, with other frames of some of its spheres and the other sense of some arcs."""
    reader = STEPControl_Reader()
    with silence_occt(), fine_precision():
        if reader.ReadFile(encode_file_name(path)) != IFSelect_RetDone:
            raise unreadable_file(path)
        if not healed:  # after reading the file, which resets them
            reader.SetShapeFixParameters(convert.string_map({f"FixShape.{mode}": "0" for mode in SHAPE_FIX_MODES}))
        turn_spheres(reader, frames)
        turn_arcs(reader, turned_arcs)
        if reader.TransferRoots() == 0:
            raise missing_solid(path)
    return reader


def require_step_file(path: Path) -> Path:
    """The path; InvalidRequest if there is no such file, or it is not a STEP file."""
    return require_file(path, "STEP", PART21_MAGIC)


def require_file(path: Path, kind: str, magic: bytes) -> Path:
    """The path; InvalidRequest if there is no such file, or its first kilobyte lacks the mark of its kind."""
    if not path.is_file():
        raise InvalidRequest(f"there is no file {path}")
    with path.open("rb") as file:
        if magic not in file.read(1024):
            remedy = MESH_REMEDY if path.suffix.lower() in {*TRIANGLE_SUFFIXES, *READ_TRIANGLE_SUFFIXES} else ""
            raise InvalidRequest(f"{path} is not a {kind} file: it does not begin with {magic.decode()}{remedy}")
    return path


def unreadable_file(path: Path) -> InvalidRequest:
    """The error of a STEP file whose text OCCT cannot parse."""
    return InvalidRequest(
        f"{path} is a damaged file: its text breaks off or cannot be parsed; export it again from the program that made it"
    )


def missing_solid(path: Path) -> InvalidRequest:
    """The error of a STEP file without solids."""
    return InvalidRequest(f"{path} holds no solid: export the part as a solid, not as surfaces, curves or a mesh")


@contextmanager
def fine_precision() -> Iterator[None]:
    """Fit pcurves that a STEP file omits within FITTING_PRECISION of its edges; a STEP reader must exist.

    OCCT would fit them within the uncertainty that the file states, .01 mm say, and so make most of the gaps between edges and
    faces itself. The setting is global and is put back.
    """
    before = Interface_Static.IVal_s("read.precision.mode"), Interface_Static.RVal_s("read.precision.val")
    Interface_Static.SetIVal_s("read.precision.mode", 1)
    Interface_Static.SetRVal_s("read.precision.val", FITTING_PRECISION)
    try:
        yield
    finally:
        Interface_Static.SetIVal_s("read.precision.mode", before[0])
        Interface_Static.SetRVal_s("read.precision.val", before[1])


@contextmanager
def silence_occt() -> Iterator[None]:
    """Suppress the messages that OCCT's translators print to standard output."""
    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)


def _length_units(reader: STEPControl_Reader) -> tuple[str, ...]:
    """Names of the length units of the file, which OCCT reads as mm if it states none.

    OCCT names those of the roots; parts of an assembly may have others, of which it takes account.
    """
    length, angle, solid_angle = (convert.string_sequence() for _ in range(3))
    reader.FileUnits(length, angle, solid_angle)
    names = [name for i in range(1, length.Length() + 1) if (name := length.Value(i).ToCString())]
    factors = sorted({round(units.LengthFactor(), 9) for units in _list_units(reader)})
    if names and len(factors) > len(names):
        known = {name.lower() for name in names}
        every = (UNIT_NAMES.get(factor, f"{factor:g} mm") for factor in factors)
        names += [name for name in every if name.lower() not in known]
    return tuple(names)


def _list_units(reader: STEPControl_Reader) -> Iterator[STEPConstruct_UnitContext]:
    """The units of each context of geometry in a file, with its uncertainty."""
    model = reader.StepModel()
    for context in (model.Value(i) for i in range(1, model.NbEntities() + 1)):
        if isinstance(context, GeometricContext):
            units = STEPConstruct_UnitContext()
            units.ComputeFactors(context.GlobalUnitAssignedContext())
            units.ComputeTolerance(context.GlobalUncertaintyAssignedContext())
            yield units


def _stated_accuracy(reader: STEPControl_Reader) -> float | None:
    """The largest uncertainty of lengths that a file states, mm; None if it states none."""
    stated = [
        float(units.Uncertainty() * units.LengthFactor()) for units in _list_units(reader) if units.HasUncertainty()
    ]
    return max(stated, default=None)


def _is_assembly(reader: STEPControl_Reader) -> bool:
    """Whether parts are placed in others by a file."""
    model = reader.StepModel()
    return any(isinstance(model.Value(i), AssemblyUsage) for i in range(1, model.NbEntities() + 1))


def _face_names(reader: STEPControl_Reader, solid: TopoDS_Solid) -> tuple[str, ...]:
    """Names of the faces of a solid, in the order of `faces_of`."""
    return tuple(_entity_name(reader, face) for face in faces_of(solid))


def _entity_name(reader: STEPControl_Reader, shape: TopoDS_Shape) -> str:
    """The name of the entity of which a solid or a face was made."""
    entity = reader.WS().TransferReader().EntityFromShapeResult(shape.Located(TopLoc_Location()), 1)
    name = entity.Name() if isinstance(entity, StepRepr_RepresentationItem) else None
    text = "" if name is None else str(name.ToCString())
    return "" if text == NO_NAME else text


def _product_names(reader: STEPControl_Reader) -> tuple[str, ...]:
    """Names of the products of the file.

    OCCT's query by type crashes on entities that it does not know (`tests/kernel/test_kernel_defects.py`); the loop over all
    entities takes 0.5 us each.
    """
    model = reader.StepModel()
    entities = (model.Value(i) for i in range(1, model.NbEntities() + 1))
    return tuple(entity.Name().ToCString() for entity in entities if isinstance(entity, StepBasic_Product))
