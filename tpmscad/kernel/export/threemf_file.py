"""3MF (core specification 1.3): a zip archive with the meshes as XML, in millimetres, with names and colours.

Each part is one object of the build. Its groups of faces are materials of the core specification; the object has the colour of
its first group, and triangles of other groups name theirs.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from numpy.typing import NDArray

from tpmscad._typing import Colour
from tpmscad.atomic_file import atomic_write
from tpmscad.errors import KernelError
from tpmscad.fields.data.threemf_files import CORE, MODEL_PATH, parse_model
from tpmscad.kernel.export.mesh_parts import MeshPart, check_read_meshes

CONTENT_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
RELATIONSHIPS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    f'<Relationship Target="/{MODEL_PATH}" Id="rel0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
FIXED_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the archive's members: equal models write equal bytes."""


BATCH = 200_000
"""Vertices or triangles whose text is made at a time."""

MAX_PARSED_TRIANGLES = 3_000_000
"""Triangles up to which a file is read back as XML; of larger ones, the archive's checksums are compared."""


def write_3mf(parts: Sequence[MeshPart], path: Path, title: str) -> None:
    """Write the meshes as named objects, in mm; the file is read back and checked before it gets its name."""
    with atomic_write(path) as aside:
        write_model_archive(aside, format_model(parts, title))
        with zipfile.ZipFile(aside) as archive:
            if sum(len(part.mesh.triangles) for part in parts) <= MAX_PARSED_TRIANGLES:
                objects = parse_model(archive.read(MODEL_PATH)).objects.values()
                check_read_meshes([of.arrays() for of in objects], parts, path)
            elif archive.testzip() is not None:
                raise KernelError("export", f"{path.name} reads back with other bytes than were written")


def format_model(parts: Sequence[MeshPart], title: str) -> Iterator[str]:
    """The XML of the model, piece by piece: materials and one object for each mesh, and the build of them all."""
    yield (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en-US" xmlns="{CORE}">'
        f'<metadata name="Title">{escape_text(title)}</metadata><metadata name="Application">tpmscad</metadata>\n'
        "<resources>"
    )
    for number, part in enumerate(parts):
        materials, thing = 2 * number + 1, 2 * number + 2
        bases = "".join(
            f'<base name={quoteattr(label)} displaycolor="{_hex(colour)}"/>' for label, colour in part.groups
        )
        yield f'<basematerials id="{materials}">{bases}</basematerials>'
        yield f'<object id="{thing}" type="model" name={quoteattr(part.name)} pid="{materials}" pindex="0"><mesh>\n<vertices>'
        for points in _batches(part.mesh.points):
            yield "".join([f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in points.tolist()])
        yield "</vertices>\n<triangles>"
        ends = ["/>", *(f' pid="{materials}" p1="{group}"/>' for group in range(1, len(part.groups)))]
        for triangles, groups in zip(_batches(part.mesh.triangles), _batches(part.group), strict=True):
            yield "".join(
                [
                    f'<triangle v1="{a}" v2="{b}" v3="{c}"{ends[g]}'
                    for (a, b, c), g in zip(triangles.tolist(), groups.tolist(), strict=True)
                ]
            )
        yield "</triangles></mesh></object>\n"
    items = "".join(f'<item objectid="{2 * number + 2}"/>' for number in range(len(parts)))
    yield f"</resources><build>{items}</build></model>\n"


def _batches(rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
    for start in range(0, len(rows), BATCH):
        yield rows[start : start + BATCH]


def _hex(colour: Colour) -> str:
    """Colour as #RRGGBB."""
    return "#" + "".join(f"{round(255 * c):02X}" for c in colour)


def write_model_archive(path: Path, model: Iterable[str]) -> None:
    """Write an archive whose model is the pieces of XML one after the other."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, pieces in (
            ("[Content_Types].xml", [CONTENT_TYPES]),
            ("_rels/.rels", [RELATIONSHIPS]),
            (MODEL_PATH, model),
        ):
            member = zipfile.ZipInfo(name, FIXED_DATE)
            member.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(member, "w", force_zip64=True) as file:
                for piece in pieces:
                    file.write(piece.encode())


def escape_text(text: str) -> str:
    """Text of an XML element."""
    return quoteattr(text)[1:-1]
