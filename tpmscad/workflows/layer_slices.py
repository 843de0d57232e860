"""Slices of a solid for layered manufacturing: the contours of every layer, straight from the exact faces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import kernel
from tpmscad._typing import Array
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.public_calls import public

MAX_LAYERS = 100_000
"""Layers of one part: 3 m at 0.03 mm. More are taken for a mistake of units."""

DEFAULT_CHORD_ERROR_FRACTION = 0.25
"""Default chord error in layer heights: the steps between layers are coarser anyway."""


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: its lower and upper height in mm, and its contours.

    A contour is an array (n, 2) of points in mm whose last point joins the first; outer contours run counter-clockwise, holes
    clockwise. area and perimeter (mm2, mm) are those of the exact contour in the middle of the layer, not of the polygons.
    """

    bottom: float
    top: float
    contours: tuple[Array, ...]
    area: float
    perimeter: float

    @property
    def middle(self) -> float:
        """The height at which the part is cut, mm."""
        return 0.5 * (self.bottom + self.top)


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
        """Areas of the layers times their heights, mm3: the volume of the part to the error of the midpoint rule."""
        return float(sum(layer.area * (layer.top - layer.bottom) for layer in self.layers))

    @property
    def n_contours(self) -> int:
        """Number of contours of all layers."""
        return sum(len(layer.contours) for layer in self.layers)

    @property
    def n_points(self) -> int:
        """Number of points of all contours."""
        return sum(len(contour) for layer in self.layers for contour in layer.contours)

    @public()
    def write(self, path: str | Path) -> None:
        """Write the layers to a file, by its suffix.

        Parameters
        ----------
        path : str or Path
            `.svg` (a group for each layer), `.cli` (Common Layer Interface 2.0, ASCII, mm) or `.3mf` (slice extension).

        Raises
        ------
        InvalidRequest
            If the suffix is another one, or the folder does not exist.

        Examples
        --------
        >>> slices = tpmscad.lattice("gyroid", cell=10, thickness=1).slices(0.1)  # doctest: +SKIP
        >>> slices.write("gyroid.cli")  # doctest: +SKIP
        """
        target = validate_output_path(path, tuple(kernel.LAYER_WRITERS))
        kernel.LAYER_WRITERS[target.suffix.lower()](self.layers, target, self.name)

    def __repr__(self) -> str:
        first, last = self.layers[0], self.layers[-1]
        return (
            f"{self.name}: {len(self)} layers of {first.top - first.bottom:.6g} mm, z = {first.bottom:.6g} to {last.top:.6g}, "
            f"{self.n_contours} contours, {self.n_points} points, chord error {self.chord_error:g} mm"
        )


def slice_shape(shape: Any, name: str, height: float, chord_error: float | None, bounds: Sequence[float]) -> Slices:
    """Slices of the solids of a shape between the two heights `bounds`, cut in the middle of each layer.

    The last layer is thinner where the height does not divide that of the part. Raises InvalidRequest if there would be too
    many layers, and KernelError if OCCT cannot triangulate the shape.
    """
    bottom, top = bounds
    count = max(1, int(np.ceil((top - bottom) / height - 1e-9)))
    if count > MAX_LAYERS:
        raise InvalidRequest(
            f"height = {height:g} makes {count} layers of a part {top - bottom:g} mm high; {MAX_LAYERS} is the limit: heights "
            "are in mm"
        )
    chord_error = DEFAULT_CHORD_ERROR_FRACTION * height if chord_error is None else chord_error
    edges = np.append(bottom + height * np.arange(count), top)
    found = kernel.slice_solids(shape, 0.5 * (edges[:-1] + edges[1:]), chord_error)
    contours = np.split(found.points, found.starts[1:-1])
    first = np.searchsorted(found.layer, np.arange(count + 1))
    layers = tuple(
        Layer(
            float(edges[i]),
            float(edges[i + 1]),
            tuple(contours[first[i] : first[i + 1]]),
            float(found.areas[i]),
            float(found.perimeters[i]),
        )
        for i in range(count)
    )
    return Slices(name, layers, chord_error, found.unresolved)
