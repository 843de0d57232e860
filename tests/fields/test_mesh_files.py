"""Files of triangles are read as they are meant, or refused with counts and a remedy."""

from __future__ import annotations

import itertools
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.mesh_files import CORE, PRODUCTION, SCHEMAS
from tpmscad.fields.data.triangle_mesh import read_triangle_mesh

pytest.importorskip("trimesh")

CORNERS = np.array(list(itertools.product((0, 10), repeat=3)))
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
FACETS = np.array([CORNERS[list(t)] for t in TRIANGLES], float)
AT_20 = 'transform="1 0 0 0 1 0 0 0 1 20 0 0"'
RELATIONS = "http://schemas.openxmlformats.org/package/2006/relationships"


def make_mesh(inner: str = "") -> str:
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in CORNERS)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in TRIANGLES)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles>{inner}</mesh>"


BEAM = '<b:beam v1="0" v2="7"/>'
BEAMS = f'<b:beamlattice radius="1"><b:beams>{BEAM * 3}</b:beams></b:beamlattice>'
CUBE, WITH_BEAMS = (f'<object id="1">{make_mesh(inner)}</object>' for inner in ("", BEAMS))
ITEM, SECOND = '<item objectid="1"/>', f'<item objectid="1" {AT_20}/>'
PAIR = f'<object id="2"><components><component objectid="1"/><component objectid="1" {AT_20}/></components></object>'
OTHER = f'<model xmlns="{CORE}" unit="centimeter"><resources>{CUBE}</resources><build/></model>'
SUPPORT = f'<object id="2" type="support">{make_mesh()}</object>'
LOOP = '<object id="1"><components><component objectid="1"/></components></object>'


def write_3mf(objects: str, items: str, stated: str = "", **others: str) -> Callable[[Path], None]:
    spaces = f'xmlns="{CORE}" xmlns:b="{SCHEMAS}beamlattice/2017/02" xmlns:p="{PRODUCTION}" xmlns:m="{SCHEMAS}material/2015/02"'
    top = f"<model {spaces} {stated}><resources>{objects}</resources><build>{items}</build></model>"
    relation = f'<Relationship Target="/3D/top.model" Id="r" Type="{SCHEMAS}2013/01/3dmodel"/>'

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("_rels/.rels", f'<Relationships xmlns="{RELATIONS}">{relation}</Relationships>')
            for name, text in {"top": top, **others}.items():
                archive.writestr(f"3D/{name}.model", text)

    return write


def write_stl(facets: np.ndarray, stated: int) -> Callable[[Path], None]:
    records = np.zeros(len(facets), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    records["v"] = facets
    return lambda path: path.write_bytes(b"x".ljust(80, b"\0") + struct.pack("<I", stated) + records.tobytes()) and None


def write_text_stl(*solids: np.ndarray, lines: int | None = None) -> Callable[[Path], None]:
    text = ""
    for number, facets in enumerate(solids):
        corners = ("".join(f"vertex {x} {y} {z}\n" for x, y, z in facet) for facet in facets)
        inner = "".join(f"facet normal 0 0 0\nouter loop\n{each}endloop\nendfacet\n" for each in corners)
        text += f"solid solid{number}\n{inner}endsolid solid{number}\n"
    return lambda path: path.write_text("".join(text.splitlines(keepends=True)[:lines])) and None


def write_obj(more: str = "", faces: bool = True) -> Callable[[Path], None]:
    quads = [f"f {a + 1} {b + 1} {c + 1} {d + 1}" for a, b, c, d in QUADS]
    lines = [*(f"v {x} {y} {z}" for x, y, z in CORNERS), *(quads * faces), more, ""]
    return lambda path: path.write_text("\n".join(lines)) and None


def write_ply(faces: int | None = 6, more: str = "", data: str = "", held: int = 6) -> Callable[[Path], None]:
    listed = "" if faces is None else f"element face {faces}\nproperty list uchar int vertex_indices\n"
    places = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\nelement vertex 8\n{places}{listed}{more}end_header\n"
    rows = [*map(tuple, CORNERS.tolist()), *((4, *quad) for quad in (() if faces is None else QUADS[:held]))]
    return lambda path: path.write_text(head + "".join(" ".join(map(str, row)) + "\n" for row in rows) + data) and None


EDGE = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
STRIP = "element tristrips 1\nproperty list int int vertex_indices\n"
ELSEWHERE = f'<item objectid="1" p:path="/3D/other.model" {AT_20}/>'
READ = {
    "part.3mf": (write_3mf(CUBE, ITEM), 1000.0, 10.0, ""),
    "inch.3mf": (write_3mf(CUBE, ITEM, 'unit="inch"'), 254.0**3, 254.0, "inch: converted"),
    "twice.3mf": (write_3mf(CUBE, ITEM + SECOND), 2000.0, 30.0, ""),
    "parts.3mf": (write_3mf(CUBE + PAIR, '<item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 0"/>'), 16000.0, 60.0, ""),
    "mirrored.3mf": (write_3mf(CUBE, '<item objectid="1" transform="-1 0 0 0 1 0 0 0 1 9 0 0"/>'), 1000.0, 9.0, ""),
    "elsewhere.3mf": (write_3mf(CUBE, ELSEWHERE, 'requiredextensions="p"', other=OTHER), 1e6, 120.0, ""),
    "colours.3mf": (write_3mf(CUBE, ITEM, 'requiredextensions="m"'), 1000.0, 10.0, ""),
    "beams.3mf": (write_3mf(WITH_BEAMS, ITEM), 1000.0, 10.0, "3 beams of the beam lattice extension are not read"),
    "support.3mf": (
        write_3mf(CUBE + SUPPORT, f'{ITEM}<item objectid="2" {AT_20}/>'), 1000.0, 10.0, "1 of its 2 items, marked as support"
    ),
    "kept.3mf": (
        write_3mf(CUBE, f'{ITEM}<item objectid="1" printable="0" {AT_20}/>'), 1000.0, 10.0, "marked as not printable"
    ),
    "binary.stl": (write_stl(FACETS, 12), 1000.0, 10.0, ""),
    "text.stl": (write_text_stl(FACETS, FACETS + 20), 2000.0, 30.0, ""),
    "lines.obj": (write_obj("l 1 2 3\np 1"), 1000.0, 10.0, "1 lines and 1 points bound nothing"),
    "edges.ply": (write_ply(more=EDGE, data="0 1\n"), 1000.0, 10.0, "1 of the element 'edge'"),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_file_holds_what_it_says_in_millimetres(name: str, tmp_path: Path) -> None:
    write, volume, width, words = READ[name]
    write(tmp_path / name)
    mesh = read_triangle_mesh(tmp_path / name)
    assert (mesh.volume, mesh.vertices[:, 0].max()) == pytest.approx((volume, width))
    assert any(words in note for note in mesh.notes) if words else not mesh.notes


REQUIRED = "which it requires .* triangles alone"
REFUSED = {
    "required.3mf": (
        write_3mf(WITH_BEAMS, ITEM, 'requiredextensions="b"'),
        "3 beams of the beam lattice extension, which it requires .* with fields.beams, or save the shape as triangles alone",
    ),
    "vendor.3mf": (
        write_3mf(CUBE, ITEM, 'xmlns:v="http://vendor/x" requiredextensions="m v"'), f"extension 'http://vendor/x', {REQUIRED}"
    ),
    "unknown.3mf": (write_3mf(CUBE, ITEM, 'requiredextensions="zz"'), f"extension 'zz', {REQUIRED}"),
    "nothing.3mf": (write_3mf(CUBE, ""), "no triangles in its build: 0 items of 1 objects"),
    "no_object.3mf": (write_3mf(CUBE, '<item objectid="7"/>'), "object 7 of '3d/top.model', which it does not hold"),
    "loop.3mf": (write_3mf(LOOP, ITEM), "among its own components"),
    "no_part.3mf": (write_3mf(CUBE, ELSEWHERE), "the part '3d/other.model', which it does not hold"),
    "leagues.3mf": (write_3mf(CUBE, ITEM, 'unit="league"'), "unit 'league', which is none of"),
    "part_in_leagues.3mf": (
        write_3mf(CUBE, ELSEWHERE, other=OTHER.replace("centimeter", "league")), "unit 'league', which is none of"
    ),
    "no_archive.3mf": (lambda path: path.write_bytes(b"no"), "no archive"),
    "more.stl": (write_stl(FACETS, 20), "states 20 triangles and holds 12 in 684 bytes"),
    "fewer.stl": (write_stl(np.concatenate([FACETS, FACETS + 20]), 12), "states 12 triangles and holds 24"),
    "cut.stl": (write_text_stl(FACETS, FACETS + 20, lines=140), "begins 2 solids and ends 1"),
    "surface.obj": (write_obj("cstype bspline\nsurf 0 1 0 1 1 2 3 4\nend"), "1 free-form surface .*polygons, or as STEP"),
    "points.obj": (write_obj(faces=False), "8 vertices and no face"),
    "absent.obj": (write_obj("f 1 2 50"), "it is damaged"),
    "points.ply": (write_ply(None), "8 vertices, 0 faces; .*fields.scattered"),
    "strips.ply": (write_ply(None, STRIP, "8 0 1 2 3 -1 4 6 5\n"), "1 of the element 'tristrips'"),
    "cut.ply": (write_ply(6, held=4), "states 14 .* holds 12 lines"),
    "a.glb": (lambda path: path.write_bytes(b"glTF"), "choose one of .stl, .obj, .ply, .3mf"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_of_which_a_part_would_be_lost_is_refused_with_counts(name: str, tmp_path: Path) -> None:
    write, words = REFUSED[name]
    write(tmp_path / name)
    with pytest.raises(InvalidRequest, match=f"{name}.*{words}"):
        read_triangle_mesh(tmp_path / name)
