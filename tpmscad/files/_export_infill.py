"""A filled body of any number of cells in one STEP file: whole cells are stored once, what the body cuts layer by layer.

Whole cells are placed copies of one solid. The rest of the body is filled by itself, a layer of cells at a time, and equal layers
are stored once. Time, memory and the size of the file go with the cells that the body cuts. The parts touch at the sides of
cells but are solids of their own; for one solid there is `infill`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, triple
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_options
from tpmscad.api.shared_arguments import Schema
from tpmscad.api.shared_kinds import COUNT, EXECUTOR, PATH
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.file_suffixes import STEP_SUFFIXES
from tpmscad.files.checked_write import KERNEL_READ_LIMIT, make_volume_check
from tpmscad.files.infill_parts import (
    CellLayers,
    MadePart,
    choose_corner,
    divide_body,
    divide_body_in_columns,
    make_part,
    measure_volume,
    plan_part,
    write_shapes,
)
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.cell_regions import make_box
from tpmscad.kernel.boolean.cut_faces import SKIN
from tpmscad.kernel.boolean.hollow_body import subtract_voids
from tpmscad.kernel.export.file_check import write_excerpt
from tpmscad.kernel.occt.convert import as_solid, transform_shape
from tpmscad.kernel.step.entity_table import EntityTable
from tpmscad.kernel.step.joined_files import PlacedProduct, write_cells, write_group, write_joined_step
from tpmscad.kernel.step.part21 import find_schema
from tpmscad.kernel.step.product_entities import write_assembly, write_validation_properties
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.parallel import run_as_completed
from tpmscad.requests.lattice_options import InfillOptions
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.requests.named_matter import resolve_named_matter
from tpmscad.result_display import fit_lines, tabulate_summary
from tpmscad.results.certificate import Certificate
from tpmscad.results.loose_pieces import KEEP
from tpmscad.rigid_motion import Motion
from tpmscad.solids.matter.lattice_block import check_wall_thickness
from tpmscad.solids.skins.offset_skin import erode_body
from tpmscad.solids.tiled_body import TILE_CORNERS, read_tiled_body
from tpmscad.stage_timer import StageTimer

INSTEAD = "export the solid, infill(...).export_step(path), or write it by infill_triangles(...) or infill_layers(...)"
"""What can be made where no cell is a copy of another."""


MAX_COPIES = 100_000
"""Solids in one file; OCCT takes 0.2 ms to place and measure each, and CAD systems far longer to draw them."""

DIVISION_RTOL = 1e-7
"""Relative difference allowed between a body's volume and that of its cells and cut layers."""


@dataclass(frozen=True, slots=True, repr=False)
class InfillFile:
    """A STEP file of a filled body in cells and layers.

    Attributes
    ----------
    path : Path
        The file.
    whole_cells : int
        Copies of the whole cell; its solid is stored once.
    layers, stored_layers : int
        Layers of cells that the body cuts, and how many of them are stored, as others are translates of these.
    parts : int
        Solids that a CAD system shows.
    faces : int
        Faces that the file stores.
    volume, area : float
        Of all parts together, mm3 and mm2; the area includes the sides in which parts touch.
    size : int
        Bytes of the file.
    certificates : tuple of Certificate
        Of the solids that the file stores.
    """

    path: Path
    whole_cells: int
    layers: int
    stored_layers: int
    parts: int
    faces: int
    volume: float
    area: float
    size: int
    certificates: tuple[Certificate, ...]

    @property
    def deviation(self) -> float:
        """Greatest orthogonal deviation of the stored solids from the surface, mm."""
        return max(certificate.max_deviation for certificate in self.certificates)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in a report."""
        return {
            "file": self.path.name,
            "whole_cells": self.whole_cells,
            "layers": self.layers,
            "stored_layers": self.stored_layers,
            "parts": self.parts,
            "faces": self.faces,
            "volume": self.volume,
            "area": self.area,
            "bytes": self.size,
            "deviation": self.deviation,
            "certificates": [certificate.to_dict() for certificate in self.certificates],
        }

    def summary(self) -> str:
        """The file in a few lines."""
        return "\n".join(
            [
                f"{self.path.name}: {self.parts} touching solids, volume {self.volume:.9g} mm3",
                f"whole cells  {self.whole_cells} copies of one",
                f"cut layers   {self.layers}, of which {self.stored_layers} are stored and the others copies",
                f"stored       {self.faces} faces, {self.size / 1e6:.1f} MB",
                f"deviation    {self.deviation:.3g} mm at most, {len(self.certificates)} certificates met",
            ]
        )

    def __repr__(self) -> str:
        return fit_lines([self.summary()], ".to_dict()")

    def _repr_html_(self) -> str:
        return tabulate_summary(self.summary())


@dataclass(frozen=True)
class InfillFileOptions(InfillOptions):
    """The arguments of `export_infill`."""

    path: Annotated[
        str | Path, PATH, "The file to write, ``.step`` or ``.stp``. It is complete and verified, or absent."
    ]
    _: KW_ONLY
    loose: Annotated[
        str,
        choice_of("drop", "keep"),
        "All pieces are kept: one that is loose in a cell or a layer touches the next one.",
    ] = KEEP
    slab: Annotated[
        int,
        COUNT,
        "Cells of a layer of what the body cuts. Thicker layers are fewer, but more cells are stored.",
    ] = 1
    executor: Annotated[
        Executor | None,
        EXECUTOR,
        "Makes and writes the parts: a process pool, or on a cluster with a common file system Dask's "
        "``Client.get_executor()``. By default this process, one after the other.",
    ] = None
    schema: Schema = "ap242"
    verify: Annotated[
        str | None,
        choice_of("kernel"),
        "Let the kernel read the whole file, however large. Without it the text of a large file is compared number for number "
        "with the files of its parts, and the kernel reads a face of each shell at its places.",
    ] = None


@validate_options(InfillFileOptions, 'export_infill(body, "gyroid", "part.step", cell=1, thickness=0.12, skin=0.3)')
def export_infill(options: InfillFileOptions) -> InfillFile:
    """Fill a CAD body with a lattice and write it as an assembly of whole cells and cut layers, in one STEP file.

    A whole cell is stored once, and placed wherever a cell lies wholly in the body. What the body leaves of the other cells is
    filled a layer of cells at a time; layers that are translates of each other, as in a box or a cylinder, are stored once. The
    cells of a core reach from end to end of a body, as in a panel, and what is left is one layer. A skin is one further part.
    Nothing is written if a part misses the request.

    Returns
    -------
    InfillFile
        The file, its parts, volume and area, and the certificates of the solids that it stores.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out, drops loose pieces, keeps or clears solids, has no equal cells (a field other than a
        core, a map), or places more than 100,000 solids.
    NotMet
        If a part misses the request.
    TrimmingError, KernelError
        If a part cannot be made, or the file does not hold it.

    Examples
    --------
    >>> file = tpmscad.export_infill("rod.step", "gyroid", "filled.step", cell=1, thickness=0.12)  # doctest: +SKIP
    >>> print(file)  # doctest: +SKIP
    """
    if options.loose != KEEP:
        raise InvalidRequest("a piece that is loose in a layer may touch the next one: leave loose out")
    if options.keep is not None or options.clear is not None:
        raise InvalidRequest(
            "`keep` and `clear` are for one solid, not for cells and layers: leave them out, or export the solid, "
            "infill(...).export_step(path)"
        )
    target, schema = validate_output_path(options.path, STEP_SUFFIXES), options.schema
    find_schema(schema)
    stages = StageTimer(options.progress)
    tiled = read_tiled_body(resolve_named_matter(options), INSTEAD, stages, copies=True)
    if not isinstance(tiled.body, CadBody):
        raise InvalidRequest("a mesh has no exact faces to be cut: fill it with infill(...), or infill_triangles(...)")
    filling, back = tiled.filling, Motion(tiled.turn.T, np.zeros(3))
    assert isinstance(filling, LatticeRequest | CoreField)
    if isinstance(filling, LatticeRequest):
        check_wall_thickness(filling)
    shapes: list[Any] = [tiled.body.shape]
    skin: tuple[Any, ...] = ()
    if options.skin is not None:
        with stages("offset"):
            deep = erode_body(tiled.body, options.skin, tiled.openings).parts
            shapes = [part.shape for part in deep]
            skin = tuple(as_solid(transform_shape(s, back)) for s in subtract_voids(tiled.body, shapes, tiled.openings))
    shapes = [as_solid(transform_shape(shape, back)) for shape in shapes]
    with stages("divide"):
        if isinstance(filling, CoreField):
            rectangle = filling.cells.rectangle
            corners = filling.origin[:2] + TILE_CORNERS[:, :2] * rectangle
            layers = divide_body_in_columns(shapes, corners, rectangle)
            if not len(layers.whole):
                raise InvalidRequest(
                    f"no cell of the {filling.structure} core ends in two planes of the body across its axis, so that none is a "
                    f"copy of another: {INSTEAD}"
                )
        else:
            cell = np.array(filling.cell)
            low = choose_corner(shapes, cell, (TILE_CORNERS + filling.phase) * cell)
            layers = divide_body(shapes, low, cell, options.slab)
        n_copies = len(layers.whole) + len(layers.layers)
        if n_copies > MAX_COPIES:
            raise InvalidRequest(
                f"{len(layers.whole)} whole cells and {len(layers.layers)} layers are more than the {MAX_COPIES} parts that "
                "readers take: enlarge the cell, or do without the solid: infill_layers(...), infill_triangles(...)"
            )
        _check_division(layers, shapes)
    name, tol = tiled.name, tiled.tol
    with tempfile.TemporaryDirectory(prefix=".parts-", dir=target.parent) as folder:
        aside = Path(folder).resolve()
        tasks = []
        if len(layers.whole):
            box = make_box(layers.low, layers.low + layers.cell)
            tasks.append(plan_part(f"{name} cell", [box], filling, tol, schema, aside / "cell.step"))
        originals = [number for number, (_, original, _) in enumerate(layers.layers) if original == number]
        for number in originals:
            solids = layers.layers[number][2]
            tasks.append(
                plan_part(f"{name} layer {number + 1}", solids, filling, tol, schema, aside / f"layer-{number}.step")
            )
        made: list[MadePart | None] = [None] * len(tasks)
        with stages("fill") as report:
            for n, (k, part) in enumerate(
                run_as_completed(options.executor, make_part, [(task,) for task in tasks]), 1
            ):
                made[k] = part
                report(n / len(tasks))
        cell_part = made[0] if len(layers.whole) else None
        of_original = dict(zip(originals, made[1:] if len(layers.whole) else made, strict=True))
        skin_part = write_shapes(skin, aside / "skin.step", schema, f"{name} skin", SKIN) if skin else None
        with stages("write"):
            return _join(options, target, layers, tiled.turn, name, cell_part, of_original, skin_part)


def _check_division(layers: CellLayers, shapes: Sequence[Any]) -> None:
    """KernelError unless whole cells and cut layers make up the body."""
    volume, divided = measure_volume(shapes), layers.volume
    if abs(divided - volume) > DIVISION_RTOL * volume:
        raise KernelError(
            "division into cells",
            f"whole cells and layers have a volume of {divided:.9g}, the body {volume:.9g}: use another slab, or infill(...)",
        )


def _join(
    options: InfillFileOptions,
    target: Path,
    layers: CellLayers,
    turn: Array,
    name: str,
    cell_part: MadePart | None,
    of_original: dict[int, MadePart | None],
    skin_part: MadePart | None,
) -> InfillFile:
    """Join the files of the parts."""
    stored = [part for part in (cell_part, *of_original.values(), skin_part) if part is not None]
    if not any(part.certificates for part in stored):
        raise InvalidRequest("no lattice lies in the body: shift it by phase, or make the cell smaller")
    index = {id(part): k for k, part in enumerate(stored)}
    copies: list[tuple[MadePart, str, tuple[float, float, float]]] = []
    for first, original, _ in layers.layers:
        part = of_original[original]
        if part is not None:
            shift = np.zeros(3)
            shift[layers.axis] = (first - layers.layers[original][0]) * layers.cell[layers.axis]
            copies.append((part, f"cut layer {len(copies) + 1}", triple(shift.tolist())))
    if skin_part is not None:
        copies.append((skin_part, "skin", (0.0, 0.0, 0.0)))

    def write_assemblies(section: Any, setting: Any, products: Sequence[Any]) -> None:
        placed = [PlacedProduct(products[index[id(part)]], part.file.mass, label, at) for part, label, at in copies]
        if cell_part is not None:
            one = PlacedProduct(products[index[id(cell_part)]], cell_part.file.mass, "cell")
            placed.insert(0, write_cells(section, setting, one, layers.whole, layers.cell))
        whole = write_group(section, setting, name, placed)
        if not np.array_equal(turn, np.eye(3)):
            product = write_assembly(
                section, setting, f"{name} turned", [whole.product], [name], turn[None], np.zeros((1, 3))
            )
            centroid = triple((turn @ np.array(whole.mass.centroid)).tolist())
            write_validation_properties(section, setting, product, replace(whole.mass, centroid=centroid))

    n_cells = len(layers.whole)
    counts = [(cell_part, n_cells)] if cell_part is not None else []
    counts += [(part, 1) for part, *_ in copies]
    volume = sum(n * part.file.mass.volume for part, n in counts)
    parts = sum(n * part.solids for part, n in counts)
    write_joined_step(
        target,
        [part.file for part in stored],
        write_assemblies,
        schema=options.schema,
        verify=partial(_verify, volume=volume, parts=parts, whole=options.verify == "kernel"),
    )
    return InfillFile(
        target,
        n_cells,
        len(layers.layers),
        len([part for part in of_original.values() if part is not None]),
        parts,
        sum(part.faces for part in stored),
        volume,
        sum(n * part.file.mass.area for part, n in counts),
        target.stat().st_size,
        tuple(certificate for part in stored for certificate in part.certificates),
    )


def _verify(written: Path, table: EntityTable, *, volume: float, parts: int, whole: bool) -> None:
    """KernelError unless the kernel reads all of a small file with its volume, or an excerpt of a large one with all solids."""
    if whole or written.stat().st_size <= KERNEL_READ_LIMIT:
        make_volume_check(volume, DIVISION_RTOL)(written)
        return
    shells = np.array([keyword == "CLOSED_SHELL" for keyword in table.keywords()])[table.template]
    first_faces = table.values[table.start[:-1][shells]]
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "excerpt.step"
        write_excerpt(written, table, first_faces, part)
        found = len(read_step(part, healed=False).solids)
    if found != parts:
        raise KernelError("export_step", f"of {parts} solids the kernel reads {found}")
