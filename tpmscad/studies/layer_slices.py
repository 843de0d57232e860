"""Slices of a solid for layered manufacturing: the contours of every layer, straight from the exact faces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import PATH
from tpmscad.atomic_file import validate_output_path
from tpmscad.brep.sections.layer_contours import LayerSection
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import LAYER_WRITERS, load_writer
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.export.layer_files import Layer
from tpmscad.kernel.slicing.contours import triangulate_for_slices

MAX_LAYERS = 100_000
"""Layers of one part: 3 m at 0.03 mm. More are taken for a mistake of units."""

VOLUME_RTOL = 2e-7
"""Relative error that the fourth-order rule over smooth layers may add to the sum of all volumes, as estimated."""

SECTIONS_OF_ROUGH_LAYER = 3
"""Sections of a layer in which the area has a kink: nodes of Gauss and Legendre, one of them in the middle."""

DEFAULT_CHORD_ERROR_FRACTION = 0.25
"""Default chord error in layer heights: the steps between layers are coarser anyway."""

JUMP_REL_TOL = 1e-8
"""In heights of the part: horizontal faces that are nearer to each other, or to a plane between layers, lie in it."""

HEIGHT_DIGITS = 7
"""Of the lowest and the highest point: the kernel's boxes of STEP files are exact to about 1e-7 mm."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Slices:
    """The layers of a part from the bottom up; a sequence of `Layer`.

    Attributes
    ----------
    name : str
        Name of the part, as files store it.
    layers : tuple of Layer
        From the bottom up.
    chord_error : float
        Greatest distance of a chord from the exact contour, mm.
    unresolved : int
        Chords that could not be kept within the error, beside points where the surface is horizontal; 0 as a rule.
    """

    name: str
    layers: tuple[Layer, ...]
    chord_error: float
    unresolved: int

    def __len__(self) -> int:
        return len(self.layers)

    def __getitem__(self, index: int) -> Layer:
        return self.layers[index]

    def __iter__(self) -> Iterator[Layer]:
        return iter(self.layers)

    @property
    def volume(self) -> float:
        """Volume of all layers, mm3, integrated from areas of exact sections: that of the part."""
        return float(sum(layer.volume for layer in self.layers))

    @property
    def n_contours(self) -> int:
        """Number of contours of all layers."""
        return sum(len(layer.contours) for layer in self.layers)

    @property
    def n_points(self) -> int:
        """Number of points of all contours."""
        return sum(len(contour) for layer in self.layers for contour in layer.contours)

    @validate_call()
    def write(
        self,
        path: Annotated[
            str | Path,
            PATH,
            "`.svg` (a group for each layer), `.cli` (Common Layer Interface 2.0, ASCII, mm) or `.3mf` (slice "
            "extension).",
        ],
    ) -> None:
        """Write the layers to a file, by its suffix.

        Raises
        ------
        InvalidRequest
            If the suffix is another one, or the folder does not exist.

        Examples
        --------
        >>> slices = tpmscad.lattice("gyroid", cell=10, thickness=1).slices(0.1)  # doctest: +SKIP
        >>> slices.write("gyroid.cli")  # doctest: +SKIP
        """
        target = validate_output_path(path, tuple(LAYER_WRITERS))
        load_writer(LAYER_WRITERS, target.suffix.lower())(self.layers, target, self.name)

    def __repr__(self) -> str:
        first, last = self.layers[0], self.layers[-1]
        return (
            f"{self.name}: {len(self)} layers of {first.top - first.bottom:.6g} mm, z = {first.bottom:.6g} to {last.top:.6g}, "
            f"{self.n_contours} contours, {self.n_points} points, chord error {self.chord_error:g} mm"
        )


def slice_shape(
    shape: Any,
    name: str,
    height: float,
    chord_error: float | None,
    bounds: Sequence[float],
    executor: Executor | None = None,
) -> Slices:
    """Slices of solids between the two heights `bounds`, cut in the middle of each layer.

    The last layer is thinner where the height does not divide that of the part. Raises InvalidRequest if there would be too
    many layers, and KernelError if OCCT cannot triangulate the shape.
    """
    edges = divide_into_layers(height, bounds)
    error = choose_chord_error(height, chord_error)
    if isinstance(shape, OcctSolids):
        shape = shape.shape
    faces = triangulate_for_slices(shape if isinstance(shape, BrepSolids) else [shape], error)
    found = faces.cut(0.5 * (edges[:-1] + edges[1:]), executor)
    cuts = divide_at_jumps(edges, faces.jumps)
    volumes = _integrate_layers(edges, cuts, found.areas, lambda levels: faces.measure_areas(levels, executor))
    return collect_layers(name, edges, error, found, volumes, found.unresolved)


def divide_into_layers(height: float, bounds: Sequence[float]) -> Array:
    """Heights (n + 1,) between the layers of a part; the last layer may be thinner. InvalidRequest if there are too many."""
    digits = HEIGHT_DIGITS - int(np.ceil(np.log10(bounds[1] - bounds[0])))
    bottom, top = (np.round(np.asarray(bounds, float), digits) + 0.0).tolist()  # 0 is never negative
    count = max(1, int(np.ceil((top - bottom) / height - 1e-9)))
    if count > MAX_LAYERS:
        raise InvalidRequest(
            f"height = {height:g} makes {count} layers of a part {top - bottom:g} mm high; {MAX_LAYERS} is the limit: heights "
            "are in mm"
        )
    return np.append(bottom + height * np.arange(count), top)


def divide_at_jumps(edges: Array, jumps: Array) -> Array:
    """Heights between layers (n + 1,) and those inside of layers at which areas jump (m,), ascending."""
    tol = JUMP_REL_TOL * float(edges[-1] - edges[0])
    inside = np.unique(np.rint(jumps / tol)) * tol
    at = np.clip(np.searchsorted(edges, inside), 1, len(edges) - 1)
    return np.union1d(edges, inside[(inside > edges[at - 1] + tol) & (inside < edges[at] - tol)])


def choose_chord_error(height: float, chord_error: float | None) -> float:
    """The chord error asked for, or the default for layers of a height."""
    return DEFAULT_CHORD_ERROR_FRACTION * height if chord_error is None else chord_error


def collect_layers(
    name: str,
    edges: Array,
    chord_error: float,
    sections: Iterable[LayerSection],
    volumes: Array,
    unresolved: int = 0,
) -> Slices:
    """The layers between consecutive heights (n + 1,), with their sections and volumes (n,)."""
    rows = zip(edges[:-1].tolist(), edges[1:].tolist(), sections, volumes.tolist(), strict=True)
    layers = tuple(
        Layer(bottom, top, tuple(contours), area, length, volume)
        for bottom, top, (contours, area, length), volume in rows
    )
    return Slices(name, layers, chord_error, unresolved)


def _integrate_layers(edges: Array, cuts: Array, areas: Array, measure_areas: Callable[[Array], Array]) -> Array:
    """Volumes (n,) between consecutive heights (n + 1,) from the areas in the middles (n,), and others that are measured.

    Where the area is smooth, the midpoint rule with the second difference of the areas is of fourth order. Where planes touch a
    face or an edge the area has a kink, which the fourth difference shows: such a layer is divided. Where it jumps, at heights
    among the `cuts`, both parts are.
    Source of 17/5760: the next term of the midpoint rule in central differences.
    """
    heights, middles = np.diff(edges), 0.5 * (cuts[:-1] + cuts[1:])
    owner, parts = np.searchsorted(edges, middles) - 1, np.diff(cuts)
    second, rough = np.full(len(areas), np.inf), np.full(len(areas), np.inf)
    second[1:-2] = np.diff(areas[:-1], 2)  # the last layer may be thinner
    rough[2:-3] = np.abs(np.diff(areas[:-1], 4)) * heights[2:-3] * 17.0 / 5760.0
    rough[np.bincount(owner) > 1] = np.inf
    order = np.argsort(rough, kind="stable")
    smooth = np.zeros(len(areas), bool)
    smooth[order[np.cumsum(rough[order]) <= VOLUME_RTOL * float(heights @ areas)]] = True
    volumes = heights * (areas + np.where(smooth, second, 0.0) / 24.0)
    due = np.flatnonzero(~smooth[owner])
    nodes, weights = np.polynomial.legendre.leggauss(SECTIONS_OF_ROUGH_LAYER)
    levels = middles[due, None] + 0.5 * parts[due, None] * nodes
    known = (np.bincount(owner) == 1)[owner[due], None] & (np.abs(nodes) < 1e-12)  # the middles of whole layers
    sections = np.where(known, areas[owner[due], None], 0.0)
    sections[~known] = measure_areas(levels[~known])
    volumes[~smooth] = np.bincount(owner[due], 0.5 * parts[due] * (sections @ weights), len(areas))[~smooth]
    return np.asarray(volumes)
