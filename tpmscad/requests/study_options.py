"""The arguments of files, pictures, slices, meshes and print checks, which results, functions and commands share.

As in `lattice_options`: each is declared once, and the command line reads this module without NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.shared_arguments import ProgressKeyword, Schema
from tpmscad.api.shared_kinds import (
    ANYTHING,
    COUNT,
    DIRECTION,
    EXECUTOR,
    FLAG,
    FRACTION,
    NOT_NEGATIVE,
    NUMBER,
    OVERHANG,
    PATH,
    PICTURE_SIZE,
    POSITIVE,
    TEXT,
    TEXTS,
    VIEW,
)
from tpmscad.requests.lattice_options import InfillOptions

if TYPE_CHECKING:
    from concurrent.futures import Executor

Source = Annotated[
    Any,
    ANYTHING,
    "A result of this package, a build123d, CadQuery or TopoDS shape, or the path of a STEP file, with valid closed solids.",
]


@dataclass(frozen=True)
class StepFileOptions:
    """The file that a function reads."""

    path: Annotated[str | Path, PATH, "The STEP file."]


@dataclass(frozen=True)
class ExportOptions:
    """The arguments of `FluidDomains.export`."""

    path: Annotated[
        str | Path,
        PATH,
        "The file to write, complete and verified, or absent. ``.step`` and ``.stp``: exact, with names, colours, units and "
        "validation properties. ``.brep``: exact, OCCT's own. ``.stl``, ``.3mf``, ``.glb``: a closed triangle mesh for each "
        "solid; 3MF and GLB with names and colours. GLB is in metres with y up, as glTF demands; the others are in mm.",
    ]
    _: KW_ONLY
    deviation: Annotated[
        float | None,
        NUMBER.described_as(example="0.02"),
        "Greatest distance between a mesh and the solid, mm; by default the certificate's `tol`, or 1/5000 of the diagonal if "
        "that is more.",
    ] = None
    angle: Annotated[
        float | None,
        NUMBER.described_as(example="20"),
        "Greatest angle between neighbouring facets of a mesh, degrees; 20 by default.",
    ] = None
    schema: Schema = "ap242"


@dataclass(frozen=True)
class StepExportOptions:
    """The arguments of `Model.export_step`."""

    path: Annotated[str | Path, PATH, "The file to write. It is complete and verified, or absent."]
    _: KW_ONLY
    instanced: Annotated[
        bool,
        FLAG,
        "Store one cell and place it once for each cell of the lattice, as touching solids of an assembly; more than 64 come in "
        "rows, layers and a block. `tpmscad.export_instances` writes such a file without making the whole lattice.",
    ] = False
    schema: Schema = "ap242"
    verify: Annotated[
        str | None,
        choice_of("kernel"),
        "Let the kernel read the whole file and check every face of it, however large; without it, a large file's text is "
        "compared number for number with the solid, and the kernel reads a face of each class of congruent faces.",
    ] = None


@dataclass(frozen=True)
class ModelExportOptions(ExportOptions, StepExportOptions):
    """The arguments of `Model.export`."""


PictureView = Annotated[
    str | Sequence[float],
    VIEW,
    "'iso', 'front', 'back', 'left', 'right', 'top', 'bottom', or the direction from the part to the eye, also as 'x,y,z'.",
]
PictureSection = Annotated[
    Any,
    ANYTHING,
    "Planes that cut the part open: 'z=5', 'z' for the middle, 'x=0,y=0' for a quarter, or a point (3,) and the normal (3,) of "
    "the side that is taken away. Of several planes, what lies in front of all is taken away. Cuts through solids are filled.",
]
PictureDimensions = Annotated[tuple[int, int], PICTURE_SIZE, "Width and height in pixels."]


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    """How a picture is drawn."""

    view: PictureView = "iso"
    section: PictureSection = None
    size: PictureDimensions = (1200, 900)
    color_by: Annotated[
        str | None,
        TEXT.described_as(example='"piece"'),
        "A colour for each solid or domain ('piece'); for each group of faces ('tag': surface +, surface -, cap, body); the "
        "orthogonal distance to the reference surface, as the certificate measures it ('deviation'); or the mean curvature, half "
        "the sum of the principal curvatures, positive where the solid is convex ('curvature'). By default the domains of an "
        "exchanger have their colours, a STEP file has those that it holds, and anything else has one.",
    ] = None


@dataclass(frozen=True)
class ModelPictureOptions(PictureOptions):
    """The arguments of `Model.render`."""

    path: Annotated[str | Path, PATH, "The PNG file to write. It is complete or absent."]


@dataclass(frozen=True, kw_only=True)
class PiecesPictureOptions(PictureOptions):
    """How a picture of several pieces is drawn."""

    hide: Annotated[
        str | Sequence[str], TEXTS.described_as(example='"skin"'), "Names of pieces to leave out, such as 'wall'."
    ] = ()


@dataclass(frozen=True)
class DomainsPictureOptions(PiecesPictureOptions, ModelPictureOptions):
    """The arguments of `FluidDomains.render`."""


@dataclass(frozen=True)
class RenderOptions(PiecesPictureOptions):
    """The arguments of `render`."""

    source: Annotated[
        Any,
        ANYTHING,
        "A result of this package, a build123d, CadQuery or TopoDS shape, or the path of a STEP file. Of homogenised properties "
        "the surface is drawn whose radius along a direction is Young's modulus there.",
    ]
    path: Annotated[str | Path, PATH, "The PNG file to write. It is complete or absent."]


@dataclass(frozen=True)
class RenderStepOptions(PiecesPictureOptions, StepFileOptions):
    """The arguments of `render_step`."""

    picture: Annotated[str | Path, PATH.described_as(example='"part.png"'), "The PNG file to write."]


LayerHeight = Annotated[
    float,
    POSITIVE,
    "Height of a layer, mm; layers begin at the lowest point of the part and are cut in their middle.",
]
ChordError = Annotated[
    float | None,
    POSITIVE.described_as(example="0.01"),
    "Greatest distance of a chord from the exact contour, mm; by default a quarter of the height.",
]


@dataclass(frozen=True)
class SliceOptions:
    """How layers are cut."""

    height: LayerHeight
    chord_error: ChordError = None


@dataclass(frozen=True)
class SliceStepOptions(SliceOptions, StepFileOptions):
    """The arguments of `slice_step`."""


@dataclass(frozen=True)
class ModelSliceOptions(SliceOptions):
    """The arguments of `Model.slices`."""

    executor: Annotated[
        Executor | None,
        EXECUTOR,
        "Cuts batches of 125 layers; by default a process for each core from eight batches on. The result is the same.",
    ] = None


@dataclass(frozen=True)
class InfillLayersOptions(InfillOptions):
    """The arguments of `infill_layers`."""

    _: KW_ONLY
    height: LayerHeight
    chord_error: ChordError = None
    executor: Annotated[
        Executor | None,
        EXECUTOR,
        "Makes batches of layers; by default a process for each core from eight batches on. The result is the same. Batches "
        "with a thickness that cannot be pickled are made in this process.",
    ] = None


@dataclass(frozen=True)
class InfillTrianglesOptions(InfillOptions):
    """The arguments of `infill_triangles`."""

    _: KW_ONLY
    deviation: Annotated[
        float | None,
        POSITIVE.described_as(example="0.01"),
        "Greatest distance of the triangles from the patches and from the body's faces, mm; by default a hundredth of the "
        "smallest cell edge, or `tol` of a field.",
    ] = None


@dataclass(frozen=True)
class TrianglesFileOptions:
    """The arguments of `TriangulatedInfill.write`."""

    path: Annotated[
        str | Path,
        PATH,
        "The file to write, complete and verified, or absent: ``.stl``, ``.3mf`` or ``.glb``.",
    ]


@dataclass(frozen=True)
class TrianglesPictureOptions:
    """The arguments of `TriangulatedInfill.render`."""

    path: Annotated[str | Path, PATH, "The PNG file to write. It is complete or absent."]
    _: KW_ONLY
    view: PictureView = "iso"
    section: PictureSection = None
    size: PictureDimensions = (1200, 900)


@dataclass(frozen=True, kw_only=True)
class PrintOptions:
    """What a part is checked for before printing."""

    min_wall: Annotated[
        float | None,
        POSITIVE.described_as(example="0.3"),
        "Least wall, mm. Without a limit, a figure is measured but not judged.",
    ] = None
    min_gap: Annotated[
        float | None,
        POSITIVE.described_as(example="0.3"),
        "Least gap, mm, between sides of one solid or between two solids.",
    ] = None
    max_overhang: Annotated[
        float | None,
        OVERHANG,
        "Greatest angle, degrees, between a face that looks down and the build direction: 0 is a vertical wall, 90 a ceiling.",
    ] = None
    build_direction: Annotated[
        str | Sequence[float], DIRECTION, "'x', '-x', 'y', ..., or a vector, from the build plate upwards."
    ] = "z"


@dataclass(frozen=True)
class CheckPrintOptions(PrintOptions):
    """The arguments of `check_print`."""

    source: Source


@dataclass(frozen=True)
class MeshOptions:
    """The arguments of `Model.mesh` and `FluidDomains.mesh`."""

    size: Annotated[
        float,
        POSITIVE.described_as(example="0.5"),
        "Mean length of the elements' edges, mm: the same everywhere, but shorter where faces or edges are shorter, and where "
        "`per_turn` asks for it.",
    ]
    order: Annotated[int, COUNT, "2: elements of 10 nodes with curved edges; 1: of 4 nodes with straight ones."] = 2
    periodic: Annotated[
        bool,
        FLAG,
        "Give opposite sides of the part's box the same nodes, to the last bit. The box has to cut the same faces on both sides, "
        "as around whole cells of a lattice.",
    ] = False
    _: KW_ONLY
    per_turn: Annotated[
        int | None,
        COUNT.described_as(example="12"),
        "Elements along a full turn of curvature at least: elements are smaller than `size` where the surface curves more.",
    ] = None
    progress: ProgressKeyword = None


@dataclass(frozen=True)
class MeshStepOptions(MeshOptions, StepFileOptions):
    """The arguments of `mesh_step`."""

    path: Annotated[
        str | Path,
        PATH,
        "The file to read: .step, .stp or .brep. Each solid is a group of elements under its name in the file. Facets are in "
        "groups named as the faces in the STEP file ('cap X+'); without such a name, 'surface', and 'surface X+' to 'surface Z-' "
        "where they are planar and face along an axis. Solids of a BREP file that share faces share the nodes there; those of a "
        "STEP file share none.",
    ]


@dataclass(frozen=True)
class HomogenizeOptions:
    """The arguments of `homogenize`."""

    surface: Annotated[
        str | Any,
        TEXT.or_else(ANYTHING),
        "A surface of the catalogue, or a kind of struts, of which a cell of edge 1 is made; a periodic field, of which one "
        "period is made; or a model whose box repeats, as one of ``tpmscad.lattice(...)`` with whole cells.",
    ]
    _: KW_ONLY
    volume_fraction: Annotated[
        float | None,
        FRACTION,
        "Volume of the solid over that of the cell. With a name, give exactly one of `volume_fraction` and `porosity`. Of a "
        "field phi they make the sheet -c <= phi <= c, or with `kind` 'skeletal' the solid phi <= c; without them its solid is "
        "phi < 0. A model takes neither.",
    ] = None
    porosity: Annotated[float | None, FRACTION, "Void fraction of the cell, 1 - volume fraction."] = None
    kind: Annotated[
        str, choice_of("sheet", "skeletal"), "A wall, or the solid on one side of the surface; with a name."
    ] = "sheet"
    reference: Annotated[
        str | None,
        choice_of("minimal", "nodal"),
        "The minimal surface, or the trigonometric one of its name, as in `tpmscad.lattice`; with a name.",
    ] = None
    youngs_modulus: Annotated[
        float, POSITIVE.described_as(example="1.0"), "Young's modulus of the solid, in any unit."
    ] = 1.0
    poisson_ratio: Annotated[
        float, NOT_NEGATIVE.described_as(example="0.3"), "Poisson's ratio of the solid, from 0 to 0.49."
    ] = 0.3
    elements: Annotated[
        str | None,
        choice_of("hexahedra", "tetrahedra"),
        "Hexahedra straight from the patches (see `Model.hexahedra`), which need fewer unknowns, have the symmetry of the cell "
        "and need no gmsh, where the lattice is one of whole walls; tetrahedra of gmsh else. By default hexahedra where "
        "possible.",
    ] = None
    size: Annotated[
        float | None,
        POSITIVE.described_as(example="0.05"),
        "Mean edge length of the tetrahedra of the finer mesh, model units; the coarser has 1.35 times as long ones. By default "
        "0.8 of the mean thickness of the wall, and at most 0.09 of the cell.",
    ] = None
    progress: ProgressKeyword = None
