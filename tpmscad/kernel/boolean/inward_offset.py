"""Inward offset of a CAD body by OCCT in a child process, within limits of time.

OCCT offsets free-form faces too, but for some bodies it does not return, or ends the process with a segmentation fault. Each
shell is offset by itself, because OCCT refuses a solid with cavities: the outer shell inwards, the others into the material.
"""

from __future__ import annotations

from collections.abc import Sequence

from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepClass3d import BRepClass3d
from OCP.BRepOffset import BRepOffset_MakeOffset, BRepOffset_Skin
from OCP.GeomAbs import GeomAbs_Arc, GeomAbs_Intersection
from OCP.TopAbs import TopAbs_FORWARD, TopAbs_SHELL
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.child_process import ChildFailure, call_in_child
from tpmscad.kernel.occt.construction import make_compound, make_solid
from tpmscad.kernel.occt.exploration import faces_of, list_subshapes, solids_of

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

OPERATION = "offset by the skin"

JOIN_TOLERANCE = 1e-6
"""Model units: largest gap between neighbouring offset faces."""

CPU_LIMIT = 20
"""Seconds of CPU for one offset; a lofted part of some ten faces takes less than one."""

TIME_LIMIT = 60.0
"""Seconds on the clock for one offset, for a machine that is busy with other work or has no limit of CPU time."""

JOINS = {"arc": GeomAbs_Arc, "mitre": GeomAbs_Intersection}
"""How offset faces are joined round a concave edge: by a tube, or extended to their intersection."""


def offset_by_occt(
    body: TopoDS_Solid, skin: float, open_faces: Sequence[TopoDS_Face], join: str, seconds: float = TIME_LIMIT
) -> tuple[TopoDS_Solid, ...]:
    """Solids of the body offset inwards by `skin`, with open faces held fixed; `join` is a key of JOINS.

    Raises KernelError if OCCT finds no offset, crashes, or does not answer within the time limit.
    """
    numbers = [i for i, face in enumerate(faces_of(body)) if any(face.IsSame(o) for o in open_faces)]
    try:
        found = call_in_child(_offset_body, convert.shape_to_bytes(body), skin, numbers, join, seconds=seconds)
    except ChildFailure as failure:
        raise KernelError(OPERATION, f"the kernel {failure.reason} ({join})", body) from None
    if found is None:
        raise KernelError(OPERATION, f"the kernel found no offset at {skin:g} ({join})", body)
    return tuple(solids_of(convert.shape_from_bytes(found)))


def _offset_body(content: bytes, skin: float, open_faces: Sequence[int], join: str) -> bytes | None:
    """What the child does: the offset of a body in bytes, with open faces by their numbers; None if OCCT finds none."""
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT, CPU_LIMIT + 1))
    body = convert.as_solid(solids_of(convert.shape_from_bytes(content))[0].Oriented(TopAbs_FORWARD))
    faces = faces_of(body)
    try:
        found = _offset_all_shells(body, skin, [faces[i] for i in open_faces], join)
    except Exception:  # OCCT's exceptions have no common base class
        return None
    return convert.shape_to_bytes(make_compound(solids_of(found)))


def _offset_shell(shell: TopoDS_Solid, distance: float, open_faces: Sequence[TopoDS_Face], join: str) -> TopoDS_Shape:
    """The solid of one shell with its faces moved outwards by `distance`."""
    maker = BRepOffset_MakeOffset()
    maker.Initialize(shell, distance, JOIN_TOLERANCE, BRepOffset_Skin, False, False, JOINS[join], False)
    for face in open_faces:
        maker.SetOffsetOnFace(face, 0.0)
    maker.MakeOffsetShape()
    if not maker.IsDone() or not solids_of(maker.Shape()):
        raise KernelError(OPERATION, "no offset of a shell")
    return maker.Shape()


def _offset_all_shells(body: TopoDS_Solid, skin: float, open_faces: Sequence[TopoDS_Face], join: str) -> TopoDS_Shape:
    """The outer shell offset inwards, without the cavities offset outwards."""
    outer = BRepClass3d.OuterShell_s(body)
    result = _offset_shell(make_solid([outer]), -skin, open_faces, join)
    for shell in list_subshapes(body, TopAbs_SHELL):
        if not shell.IsSame(outer):
            cavity = make_solid([convert.as_shell(shell.Reversed())])
            held = [face for face in open_faces if any(own.IsSame(face) for own in faces_of(cavity))]
            grown = _offset_shell(cavity, skin, held, join)
            result = BRepAlgoAPI_Cut(result, grown).Shape()
    return result
