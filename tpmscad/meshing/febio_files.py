"""FEBio input files: nodes, elements, node sets, surfaces, and one material, for the module `solid`.

Source: FEBio User's Manual, version 4, section 3.6 "Mesh section" (format 4.0).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from xml.sax.saxutils import quoteattr

from tpmscad._typing import IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.meshing.inp_files import drop_inner_nodes
from tpmscad.meshing.mesh_arrays import MeshArrays, split

FEBIO_KINDS: Mapping[str, str] = MappingProxyType(
    {
        **{"tetra": "tet4", "tetra10": "tet10", "hexahedron": "hex8", "hexahedron20": "hex20"},
        **{"triangle": "tri3", "triangle6": "tri6", "quad": "quad4", "quad8": "quad8"},
    }
)
"""Name of each kind of element and facet; the order of nodes is VTK's."""

HEAD = """\
<?xml version="1.0" encoding="ISO-8859-1"?>
<febio_spec version="4.0">
<Module type="solid"/>
<Material>
<material id="1" name="solid" type="neo-Hookean"><density>1</density><E>1</E><v>0.3</v></material>
</Material>
<Mesh>
"""


def write_feb(mesh: MeshArrays, path: Path) -> None:
    """Write a mesh as an input of FEBio with a placeholder of a material; hexahedra of 27 nodes as those of 20."""
    plainer = drop_inner_nodes(mesh)
    with (
        atomic_write(path) as aside,
        aside.open("w", encoding="ascii", newline="\n", errors="xmlcharrefreplace") as file,
    ):
        file.write(HEAD)
        file.writelines(line + "\n" for line in _mesh_lines(plainer))
        domains = "".join(f'<SolidDomain name="{kind}" mat="solid"/>' for kind in plainer.cells)
        file.write(f"</Mesh>\n<MeshDomains>{domains}</MeshDomains>\n</febio_spec>\n")


def _mesh_lines(mesh: MeshArrays) -> Iterator[str]:
    """Nodes, elements by kind, and sets, numbered from 1."""
    yield f"<Nodes name={quoteattr(mesh.name)}>"
    for number, point in enumerate(mesh.points.tolist(), 1):
        yield f'<node id="{number}">{",".join(f"{x:.13g}" for x in point)}</node>'
    yield "</Nodes>"
    first = 1
    for kind, nodes in mesh.cells.items():
        yield f'<Elements type="{FEBIO_KINDS[kind]}" name="{kind}">'
        yield from _format_numbered("elem", nodes, first)
        yield "</Elements>"
        first += len(nodes)
    for name, chosen in mesh.node_sets.items():
        yield f"<NodeSet name={quoteattr(name)}>{','.join(map(str, (chosen + 1).tolist()))}</NodeSet>"
    for name, numbers in mesh.cell_groups.items():
        yield f"<ElementSet name={quoteattr(name)}>{','.join(map(str, (numbers + 1).tolist()))}</ElementSet>"
    for name, rows in mesh.facet_groups.items():
        yield f"<Surface name={quoteattr(name)}>"
        first = 1
        for (kind, nodes), own in zip(mesh.facets.items(), split(mesh.facets, rows), strict=True):
            yield from _format_numbered(FEBIO_KINDS[kind], nodes[own], first)
            first += len(own)
        yield "</Surface>"


def _format_numbered(tag: str, nodes: IntArray, first: int) -> Iterator[str]:
    """An element of XML for each row of nodes."""
    for number, row in enumerate((nodes + 1).tolist(), first):
        yield f'<{tag} id="{number}">{",".join(map(str, row))}</{tag}>'
