"""Persistence diagrams and barcodes of a field in dimensions 0, 1 and 2.

The sublevel filtration {f <= c} grows with c. A topological feature is born at the value of f at which it appears and dies at
the value at which it merges with an older one or is filled. Since f < 0 is solid, the features alive at level 0 are those of the
solid: connected components (dimension 0), tunnels, i.e. independent loops (dimension 1), and enclosed cavities (dimension 2).
The pairs are computed by gudhi on the cubical complex whose vertices are the samples (porous blending, section 2.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import call_for_array, read_value, validate_call
from tpmscad.api.shared_kinds import ANYTHING, BOX, CELL_COUNTS, DIMENSIONS, FLAG, NOT_NEGATIVE, VALUES
from tpmscad.errors import InvalidRequest
from tpmscad.memory_limit import require_memory
from tpmscad.topology.voxels import Convention

DEFAULT_SAMPLES = 64
"""Samples along the longest edge of the domain if no resolution is given."""

ALL_DIMENSIONS = (0, 1, 2)

FEATURE_NAMES = ("components", "tunnels", "cavities")
"""Features of dimensions 0, 1 and 2, as the legends of the figures name them."""

COLOURS = ("tab:blue", "tab:red", "tab:green")
"""Colours of dimensions 0, 1 and 2 in the figures."""


@dataclass(frozen=True, slots=True, eq=False)
class PersistenceDiagram:
    """Births and deaths of the topological features of a field, by dimension.

    - `dimensions`: the dimensions computed, ascending.
    - `births`, `deaths`: one array (n,) of field values for each of them, in the order in which the filtration meets the births.
      Features that never die have death +inf in a sublevel filtration and -inf in a superlevel one.
    - `sublevel`: True for {f <= c} with rising c, False for {f >= c} with falling c, the filtration of the void.
    """

    dimensions: tuple[int, ...]
    births: tuple[Array, ...]
    deaths: tuple[Array, ...]
    sublevel: bool = True

    def pairs(self, dimension: int) -> Array:
        """Return the (birth, death) pairs of one dimension.

        Parameters
        ----------
        dimension : {0, 1, 2}
            0 for components, 1 for tunnels, 2 for cavities.

        Returns
        -------
        ndarray, shape (n, 2)
            Births and deaths, in values of the field.

        Raises
        ------
        InvalidRequest
            If the diagram does not contain the dimension.
        """
        if dimension not in self.dimensions:
            raise InvalidRequest(
                f"the diagram has no dimension {dimension}: it was computed for {', '.join(map(str, self.dimensions))}; "
                "give the dimensions to persistence_diagram"
            )
        place = self.dimensions.index(dimension)
        return np.stack([self.births[place], self.deaths[place]], axis=-1)

    def alive_at(self, level: float = 0.0) -> PersistenceDiagram:
        """Return the features that exist at one level.

        Parameters
        ----------
        level : float
            Value of the field; 0 is the surface of the solid.

        Returns
        -------
        PersistenceDiagram
            The features with birth <= level < death, or birth >= level > death in a superlevel filtration. Their numbers are
            the Betti numbers of the solid, or of the void, at the level.

        Examples
        --------
        >>> import numpy as np
        >>> from tpmscad import topology
        >>> x, y, z = np.meshgrid(*[np.linspace(-1, 1, 33)] * 3, indexing="ij")
        >>> ring = np.hypot(np.hypot(x, y) - 0.6, z) - 0.2
        >>> alive = topology.persistence_diagram(ring).alive_at(0.0)
        >>> [len(alive.pairs(dimension)) for dimension in (0, 1, 2)]
        [1, 1, 0]
        """
        sign = 1 if self.sublevel else -1
        pairs = list(zip(self.births, self.deaths, strict=True))
        alive = [(sign * b <= sign * level) & (sign * level < sign * d) for b, d in pairs]
        births, deaths = (
            tuple(each[keep] for each, keep in zip(values, alive, strict=True)) for values in (self.births, self.deaths)
        )
        return PersistenceDiagram(self.dimensions, births, deaths, self.sublevel)

    def plot_diagram(self, ax: Any = None) -> Any:
        """Draw the persistence diagram: deaths over births, one colour per dimension.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; by default those of a new figure.

        Returns
        -------
        matplotlib.axes.Axes
            The axes. Grey lines mark the diagonal and level 0; triangles are features that never die.

        Raises
        ------
        InvalidRequest
            If matplotlib is not installed.
        """
        ax = _make_axes(ax)
        low, high, margin, forever = self._value_range(0.05)
        ax.plot([low, high], [low, high], color="0.7", linewidth=1)
        ax.axhline(0.0, color="0.85", linewidth=1)
        ax.axvline(0.0, color="0.85", linewidth=1)
        for dimension, births, deaths in zip(self.dimensions, self.births, self.deaths, strict=True):
            finite = np.isfinite(deaths)
            colour, label = COLOURS[dimension], f"{FEATURE_NAMES[dimension]} ({len(births)})"
            ax.scatter(births[finite], deaths[finite], s=12, color=colour, alpha=0.6, linewidths=0, label=label)
            ax.scatter(births[~finite], np.full((~finite).sum(), forever), s=30, color=colour, marker="^")
        ax.set(xlabel="birth", ylabel="death", xlim=(low - 2 * margin, high + 2 * margin))
        ax.set(ylim=(low - 2 * margin, high + 2 * margin), aspect="equal")
        ax.legend()
        return ax

    def plot_barcode(self, ax: Any = None) -> Any:
        """Draw the barcode: one horizontal bar from birth to death for each feature, grouped by dimension.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; by default those of a new figure.

        Returns
        -------
        matplotlib.axes.Axes
            The axes. A grey line marks level 0; bars of features that never die end at the frame.

        Raises
        ------
        InvalidRequest
            If matplotlib is not installed.
        """
        ax = _make_axes(ax)
        low, high, margin, forever = self._value_range(0.1)
        first = 0
        for dimension, births, deaths in zip(self.dimensions, self.births, self.deaths, strict=True):
            rows = first + np.arange(len(births))
            ends = np.where(np.isfinite(deaths), deaths, forever)
            label = f"{FEATURE_NAMES[dimension]} ({len(births)})"
            ax.hlines(rows, births, ends, color=COLOURS[dimension], linewidth=1.5, label=label)
            first += len(births)
        ax.axvline(0.0, color="0.7", linewidth=1)
        ax.set(xlabel="field value", ylabel="feature", xlim=(low - margin, high + margin), ylim=(-1, max(first, 1)))
        ax.legend()
        return ax

    def _value_range(self, margin_fraction: float) -> tuple[float, float, float, float]:
        """Least and greatest finite value of births and deaths and 0, never an empty interval; a margin, and infinity's place."""
        values = np.concatenate([np.zeros(1), *self.births, *self.deaths])
        values = values[np.isfinite(values)]
        low, high = float(values.min()), float(values.max())
        low, high = (low, high) if low < high else (low - 1.0, high + 1.0)
        margin = margin_fraction * (high - low)
        return low, high, margin, high + margin if self.sublevel else low - margin


@validate_call()
def persistence_diagram(
    field_or_values: Annotated[
        Any, ANYTHING, "A function of points (..., 3), the result of `tpmscad.blend`, or samples."
    ],
    domain: Annotated[
        Sequence[Sequence[float]] | None,
        BOX,
        "Box in which a function is sampled, in model units. By default the domain of a blend, or one period of a "
        "periodic field.",
    ] = None,
    resolution: Annotated[
        int | Sequence[int] | None,
        CELL_COUNTS.described_as(example="40"),
        "Samples along the longest edge, or along each axis, ends included. By default the resolution of a blend, or "
        "64.",
    ] = None,
    dimensions: Annotated[
        Sequence[int], DIMENSIONS, "0 for connected components, 1 for tunnels, 2 for cavities."
    ] = ALL_DIMENSIONS,
    *,
    sublevel: Annotated[
        bool, FLAG, "True for the filtration {f <= c} of the solid, False for {f >= c}, that of the void."
    ] = True,
    convention: Annotated[
        Convention,
        choice_of("vertices", "top_cells", "strict"),
        "Cubical complex of the samples: as vertices, or as cubes; see `tpmscad.topology.CONNECTIVITY`.",
    ] = "vertices",
    min_persistence: Annotated[
        float, NOT_NEGATIVE, "Features with ``abs(death - birth) <= min_persistence`` are left out."
    ] = 0.0,
) -> PersistenceDiagram:
    """Compute the persistence diagram of a field, a blend result or an array of samples.

    Returns
    -------
    PersistenceDiagram
        Births and deaths by dimension.

    Raises
    ------
    InvalidRequest
        If the samples are not a finite three-dimensional array, or the domain, resolution or dimensions are invalid.

    Notes
    -----
    The box is no torus: a tunnel that crosses the faces of a periodic box is counted as far as the box contains it. Matrix
    reduction takes seconds for 100^3 samples; `compute_persistence` computes dimensions 0 and 2 much faster.
    P. Wagner, C. Chen, E. Vucini, Efficient computation of persistent homology for cubical data (2012).

    Examples
    --------
    >>> from tpmscad import fields, topology
    >>> ball = fields.sphere((0, 0, 0), 1.0)
    >>> diagram = topology.persistence_diagram(ball, ((-2, -2, -2), (2, 2, 2)), 33)
    >>> diagram.pairs(0)
    array([[-1., inf]])
    """
    chosen = tuple(sorted(set(dimensions)))
    if not chosen or not set(chosen) <= set(ALL_DIMENSIONS):
        raise InvalidRequest(f"dimensions {tuple(dimensions)!r}: choose from 0 (components), 1 (tunnels), 2 (cavities)")
    # gudhi takes 0.2 s to import, which callers of the union-find sweeps do not need
    from tpmscad.topology.gudhi_complex import gudhi_diagram

    values = _sample(field_or_values, domain, resolution)
    sign = 1.0 if sublevel else -1.0
    births, deaths = [], []
    for pairs in gudhi_diagram(sign * values, chosen, convention):
        keep = pairs.death - pairs.birth > min_persistence
        births.append(sign * pairs.birth[keep])
        deaths.append(sign * pairs.death[keep])
    return PersistenceDiagram(chosen, tuple(births), tuple(deaths), sublevel)


BYTES_PER_SAMPLE = 500
"""Of a persistence diagram: its cubical complex has eight cells for each sample."""


def _sample(source: Any, domain: Any, resolution: Any) -> Array:
    """Samples of a function, a blend result (an object with field, domain and resolution) or an array."""
    if not callable(source) and callable(getattr(source, "field", None)):
        domain = source.domain if domain is None else domain
        resolution = source.resolution if resolution is None else resolution
        source = source.field
    if not callable(source):
        if domain is not None or resolution is not None:
            raise InvalidRequest("an array of samples has its own grid: leave out domain and resolution")
        array: Array = read_value("field_or_values", VALUES, source)
        return array
    low, high = _sampling_box(source, domain)
    counts = _sample_counts(high - low, resolution)
    require_memory(math.prod(counts), BYTES_PER_SAMPLE, f"a diagram of {counts} samples", "use a coarser resolution")
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    on_grid = getattr(source, "on_grid", None)
    if on_grid is not None:
        values = call_for_array("the field", on_grid, *axes)
    else:
        values = call_for_array("the field", source, np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    if values.shape != counts:
        raise InvalidRequest(
            f"the field gave shape {values.shape} for points of shape {counts}: one value for each is needed"
        )
    return values


def _sampling_box(field: Any, domain: ArrayLike | None) -> tuple[Array, Array]:
    """Corners of the domain, by default of one period."""
    if domain is None:
        periods = getattr(field, "periods", lambda: None)()
        if periods is None or min(periods) <= 0:
            raise InvalidRequest(
                "the field is not periodic along every axis: give the box to sample, domain=((x0, y0, z0), (x1, y1, z1))"
            )
        return np.zeros(3), np.array(periods)
    low, high = np.asarray(domain, float)
    return low, high


def _sample_counts(extent: Array, resolution: Any) -> tuple[int, ...]:
    """Samples along each axis."""
    if resolution is None or np.ndim(resolution) == 0:
        longest = DEFAULT_SAMPLES if resolution is None else int(resolution)
        counts = tuple(int(n) for n in np.maximum(2, np.rint(longest * extent / extent.max())))
    else:
        longest, counts = 2, tuple(int(n) for n in resolution)
    if longest < 2 or len(counts) != 3 or min(counts) < 2:
        raise InvalidRequest(f"resolution {resolution!r}: give at least 2 samples along each of the three axes")
    return counts


def _make_axes(ax: Any) -> Any:
    """The given axes, or those of a new figure."""
    if ax is not None:
        return ax
    try:
        # an extra: figures are not needed to compute diagrams
        from matplotlib import pyplot
    except ImportError as error:
        raise InvalidRequest("figures need matplotlib: pip install 'tpmscad[plot]'") from error
    return pyplot.subplots(layout="constrained")[1]
