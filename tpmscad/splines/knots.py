"""Knot vectors, knot insertion, and what follows from it: splitting, restriction, degree elevation, common spaces.

None of these changes the surface, up to round-off. The control nets of parts of one surface share the poles of their
common border bit for bit, and so do parts of two surfaces with a common border.

Sources: W. Boehm, Inserting new knots into B-spline curves, Computer-Aided Design 12 (1980), 199-201; L. Piegl, W. Tiller,
The NURBS Book (1997), chapter 5.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.basis import apply_span_bases, bernstein_elevation_matrix, design_matrix, knot_domain
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

COMMON_KNOT_RTOL = 1e-12
"""Of the domain: knots of two surfaces that agree within it are one; they differ by round-off of their scaling."""


def bezier_knots(degree: int, domain: tuple[float, float] = (0.0, 1.0)) -> Array:
    """Knot vector of one polynomial span.

    Parameters
    ----------
    degree : int
        Polynomial degree.
    domain : tuple of float, optional
        Ends of the span.

    Returns
    -------
    ndarray, shape (2 degree + 2,)
        Both ends with multiplicity degree + 1.

    Examples
    --------
    >>> from tpmscad.splines import bezier_knots
    >>> bezier_knots(2)
    array([0., 0., 0., 1., 1., 1.])
    """
    return np.repeat(np.array(domain, float), degree + 1)


def uniform_knots(
    spans: int, degree: int, smoothness: int | None = None, domain: tuple[float, float] = (0.0, 1.0)
) -> Array:
    """Clamped knot vector of equal spans.

    Parameters
    ----------
    spans : int
        Number of spans.
    degree : int
        Polynomial degree.
    smoothness : int, optional
        The spline is C^smoothness at inner knots; degree - 1 by default.
    domain : tuple of float, optional
        Ends of the domain.

    Returns
    -------
    ndarray
        Knots with repetition.

    Examples
    --------
    >>> from tpmscad.splines import uniform_knots
    >>> uniform_knots(2, 2)
    array([0. , 0. , 0. , 0.5, 1. , 1. , 1. ])
    """
    repeats = 1 if smoothness is None else degree - smoothness
    inner = np.linspace(*domain, spans + 1)[1:-1]
    return np.concatenate(
        [np.repeat(domain[0], degree + 1), np.repeat(inner, repeats), np.repeat(domain[1], degree + 1)]
    )


def greville_abscissae(knots: Array, degree: int) -> Array:
    """Averages of `degree` consecutive knots, one per pole: (n,)."""
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(len(knots) - degree - 1)])


KNOT_RTOL = 1e-9
"""Of an interval: knots that are nearer to its ends are its ends; a span between them would have no length."""


def knots_within(knots: Array, low: float, high: float) -> tuple[Array, IntArray]:
    """The distinct knots (n,) inside an interval, but for those at its ends, and their multiplicities."""
    values, counts = np.unique(knots, return_counts=True)
    tiny = KNOT_RTOL * (high - low)
    inside = (values > low + tiny) & (values < high - tiny)
    return values[inside], counts[inside]


def insert_knot(poles: Array, knots: Array, degree: int, t: float, times: int = 1) -> tuple[Array, Array]:
    """Insert a knot into a B-spline without changing it (Boehm's algorithm).

    Parameters
    ----------
    poles : ndarray, shape (N, ...)
        Control points along the first axis.
    knots : ndarray, shape (N + degree + 1,)
        Knot vector with repetition.
    degree : int
        Polynomial degree.
    t : float
        The new knot, strictly inside the domain.
    times : int, optional
        How often it is inserted.

    Returns
    -------
    poles : ndarray, shape (N + times, ...)
        Control points of the refined knot vector.
    knots : ndarray, shape (N + times + degree + 1,)
        The refined knot vector.

    Raises
    ------
    ValueError
        If t lies outside the domain or its multiplicity would exceed the degree.

    Notes
    -----
    W. Boehm, Inserting new knots into B-spline curves, Computer-Aided Design 12 (1980). `scipy.interpolate.insert` does the same
    with other round-off; here two surfaces with equal border poles keep equal border poles, bit for bit.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import bezier_knots, insert_knot
    >>> insert_knot(np.array([[0.0], [1.0]]), bezier_knots(1), 1, 0.25)[0].ravel()
    array([0.  , 0.25, 1.  ])
    """
    for _ in range(times):
        k = int(np.searchsorted(knots, t, side="right")) - 1
        multiplicity = int(np.count_nonzero(knots == t))
        low, high = knot_domain(knots, degree)
        if not low < t < high or multiplicity >= degree:
            raise ValueError(
                f"a knot at {t} can't be inserted: it must lie inside ({low}, {high}) with a multiplicity below the degree "
                f"{degree}, and has multiplicity {multiplicity}"
            )
        i = np.arange(k - degree + 1, k - multiplicity + 1)
        ratio = ((t - knots[i]) / (knots[i + degree] - knots[i])).reshape(-1, *(1,) * (poles.ndim - 1))
        mixed = (1 - ratio) * poles[i - 1] + ratio * poles[i]
        poles = np.concatenate([poles[: k - degree + 1], mixed, poles[k - multiplicity :]])
        knots = np.insert(knots, k + 1, t)
    return poles, knots


def bezier_rows(knots: Array, degree: int, parts: int = 1) -> tuple[Array, Array]:
    """Ends (n + 1,) of the spans, each cut into equal parts, and matrices (n, degree + 1, N) to their Bezier poles."""
    low, high = knot_domain(knots, degree)
    breaks = np.unique(knots[(knots >= low) & (knots <= high)])
    ends = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * np.arange(parts) / parts).ravel(), breaks[-1])
    rows, fine = np.eye(len(knots) - degree - 1), knots
    for t in ends[1:-1].tolist():
        rows, fine = insert_knot(rows, fine, degree, t, degree - int(np.count_nonzero(fine == t)))
    first = np.searchsorted(fine, ends[:-1], side="right") - 1 - degree
    return ends, rows[first[:, None] + np.arange(degree + 1)]


def bezier_pieces(surface: BSplineSurface, parts: int = 1) -> tuple[Array, Array, Array]:
    """Ends of the spans along u and v, each cut into equal parts, and their Bezier poles (m, n, p + 1, q + 1, D)."""
    u, rows = bezier_rows(surface.knots_u, surface.degree_u, parts)
    v, columns = bezier_rows(surface.knots_v, surface.degree_v, parts)
    return u, v, apply_span_bases(rows, surface.poles, columns)


def bezier_curve(poles: Array) -> BSplineCurve:
    """The Bezier curve of poles (p + 1, D) over [0, 1]."""
    return BSplineCurve(poles, _unit_knots(len(poles) - 1), len(poles) - 1)


def bezier_surface(poles: Array) -> BSplineSurface:
    """The Bezier patch of poles (p + 1, q + 1, D) over the unit square."""
    p, q = poles.shape[0] - 1, poles.shape[1] - 1
    return BSplineSurface(poles, _unit_knots(p), _unit_knots(q), p, q)


@cache
def _unit_knots(degree: int) -> Array:
    """The knots of a Bezier curve, which all curves of the degree share."""
    knots = bezier_knots(degree)
    knots.flags.writeable = False
    return knots


def split_surface(surface: BSplineSurface, direction: int, t: float) -> tuple[BSplineSurface, BSplineSurface]:
    """Split a surface along a parameter line.

    Parameters
    ----------
    surface : BSplineSurface
        The surface.
    direction : int
        0 splits at u = t, 1 splits at v = t.
    t : float
        Parameter strictly inside the domain.

    Returns
    -------
    low, high : BSplineSurface
        The parts below and above t, each on its part of the domain.

    Raises
    ------
    ValueError
        If t lies outside the domain.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, split_surface
    >>> knots = bezier_knots(1)
    >>> square = BSplineSurface(np.array([[[0.0, 0], [0, 1]], [[1, 0], [1, 1]]]), knots, knots, 1, 1)
    >>> split_surface(square, 0, 0.25)[0].domain
    ((0.0, 0.25), (0.0, 1.0))
    """
    poles, knots, degree = _direction_arrays(surface, direction)
    multiplicity = int(np.count_nonzero(knots == t))
    poles, knots = insert_knot(poles, knots, degree, t, degree - multiplicity)
    first = int(np.searchsorted(knots, t))
    border = first - 1  # the pole that the surface at t interpolates
    low = _replace_direction(surface, direction, poles[: border + 1], np.append(knots[: first + degree], t), degree)
    high = _replace_direction(surface, direction, poles[border:], np.insert(knots[first:], 0, t), degree)
    return low, high


def restrict_surface(surface: BSplineSurface, u: tuple[float, float], v: tuple[float, float]) -> BSplineSurface:
    """Restrict a surface to a rectangle of its domain.

    Parameters
    ----------
    surface : BSplineSurface
        The surface.
    u, v : tuple of float
        Intervals in its domain.

    Returns
    -------
    BSplineSurface
        The surface on u x v.

    Raises
    ------
    ValueError
        If an interval is empty or leaves the domain.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, restrict_surface
    >>> knots = bezier_knots(1)
    >>> square = BSplineSurface(np.array([[[0.0, 0], [0, 1]], [[1, 0], [1, 1]]]), knots, knots, 1, 1)
    >>> restrict_surface(square, (0.25, 0.5), (0.0, 1.0)).poles[:, 0, 0]
    array([0.25, 0.5 ])
    """
    for direction, (low, high) in enumerate((u, v)):
        start, end = surface.domain[direction]
        if not start <= low < high <= end:
            raise ValueError(f"[{low}, {high}] is not an interval in [{start}, {end}]")
        if low > start:
            surface = split_surface(surface, direction, low)[1]
        if high < end:
            surface = split_surface(surface, direction, high)[0]
    return surface


def elevate_degree(surface: BSplineSurface, degree_u: int, degree_v: int) -> BSplineSurface:
    """Elevate the degrees of a surface of one span (a Bezier surface).

    Parameters
    ----------
    surface : BSplineSurface
        A surface of one span in u and in v.
    degree_u, degree_v : int
        The new degrees, not below the old ones.

    Returns
    -------
    BSplineSurface
        The same surface with (degree_u + 1) x (degree_v + 1) poles.

    Raises
    ------
    ValueError
        If the surface has several spans or a degree would fall.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, elevate_degree
    >>> knots = bezier_knots(1)
    >>> square = BSplineSurface(np.array([[[0.0, 0], [0, 1]], [[1, 0], [1, 1]]]), knots, knots, 1, 1)
    >>> elevate_degree(square, 2, 1).poles[:, 0, 0]
    array([0. , 0.5, 1. ])
    """
    for direction, degree in ((0, degree_u), (1, degree_v)):
        poles, knots, old = _direction_arrays(surface, direction)
        if len(poles) != old + 1 or degree < old:
            raise ValueError(
                f"degree {old} with {len(poles)} poles can't be elevated to {degree}: one span, upwards only"
            )
        elevated = np.einsum("ij,j...->i...", bernstein_elevation_matrix(old, degree), poles)
        surface = _replace_direction(
            surface, direction, elevated, bezier_knots(degree, knot_domain(knots, old)), degree
        )
    return surface


def map_to_unit_square(surface: BSplineSurface) -> BSplineSurface:
    """The same surface with knots scaled to [0, 1] along both parameters."""
    knots = []
    for direction in (0, 1):
        _, t, degree = _direction_arrays(surface, direction)
        low, high = knot_domain(t, degree)
        scaled = (t - low) / (high - low)
        scaled[t == high] = 1.0
        knots.append(scaled)
    return BSplineSurface(surface.poles, knots[0], knots[1], surface.degree_u, surface.degree_v)


def turn_surface(
    surface: BSplineSurface, reverse_u: bool = False, reverse_v: bool = False, swap: bool = False
) -> BSplineSurface:
    """The surface with parameters reversed on their domain, then swapped."""
    poles, knots, degrees = surface.poles, [surface.knots_u, surface.knots_v], (surface.degree_u, surface.degree_v)
    for direction, reverse in enumerate((reverse_u, reverse_v)):
        if reverse:
            low, high = surface.domain[direction]
            knots[direction] = (low + high) - knots[direction][::-1]
            poles = np.flip(poles, direction)
    turned = BSplineSurface(np.ascontiguousarray(poles), knots[0], knots[1], *degrees)
    if not swap:
        return turned
    return BSplineSurface(np.ascontiguousarray(poles.swapaxes(0, 1)), knots[1], knots[0], degrees[1], degrees[0])


def to_common_space(first: BSplineSurface, second: BSplineSurface) -> tuple[BSplineSurface, BSplineSurface]:
    """Two surfaces over one domain in the least spline space that holds both: degrees raised, knots merged.

    Parameters
    ----------
    first, second : BSplineSurface
        Surfaces with clamped knots of one domain. Inner knots that agree within `COMMON_KNOT_RTOL` of it are one.

    Returns
    -------
    first, second : BSplineSurface
        The same surfaces, up to round-off, with the same knots and degrees.

    Raises
    ------
    ValueError
        If the domains differ.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, to_common_space
    >>> line, parabola = bezier_knots(1), bezier_knots(2)
    >>> flat = BSplineSurface(np.array([[[0.0, 0], [0, 1]], [[1, 0], [1, 1]]]), line, line, 1, 1)
    >>> bent = BSplineSurface(np.zeros((3, 2, 2)), parabola, line, 2, 1)
    >>> to_common_space(flat, bent)[0].poles[:, 0, 0].round(12)
    array([0. , 0.5, 1. ])
    """
    if first.domain != second.domain:
        raise ValueError(f"surfaces over {first.domain} and {second.domain} have no common spline space")
    for direction in (0, 1):
        parts = [_direction_arrays(surface, direction) for surface in (first, second)]
        degree = max(part[2] for part in parts)
        knots = _merge_knots([part[1:] for part in parts], degree)
        at = greville_abscissae(knots, degree)
        collocation = design_matrix(knots, degree, at)
        nets = [
            np.linalg.solve(collocation, np.tensordot(design_matrix(t, p, at), poles, axes=1).reshape(len(at), -1))
            for poles, t, p in parts
        ]
        first, second = (
            _replace_direction(
                surface, direction, np.asarray(net, float).reshape(len(at), *part[0].shape[1:]), knots, degree
            )
            for surface, net, part in zip((first, second), nets, parts, strict=True)
        )
    return first, second


def _merge_knots(spaces: list[tuple[Array, int]], degree: int) -> Array:
    """The clamped knots of a degree at which a spline is as rough as the roughest of the spaces, given as knots and degree."""
    low, high = knot_domain(*spaces[0])
    inner = [np.unique(t[p + 1 : -p - 1], return_counts=True) for t, p in spaces]
    values, repeats = (
        np.concatenate([v for v, _ in inner]),
        np.concatenate([degree - (p - n) for (_, n), (_, p) in zip(inner, spaces, strict=True)]),
    )
    order = np.argsort(values)
    values, repeats = values[order], repeats[order]
    group = np.cumsum(np.diff(values, prepend=-np.inf) > COMMON_KNOT_RTOL * (high - low)) - 1
    times = np.zeros(group.max(initial=-1) + 1, int)
    np.maximum.at(times, group, repeats)
    merged = values[np.searchsorted(group, np.arange(len(times)))]
    return np.concatenate([np.repeat(low, degree + 1), np.repeat(merged, times), np.repeat(high, degree + 1)])


def _direction_arrays(surface: BSplineSurface, direction: int) -> tuple[Array, Array, int]:
    """Poles with the chosen direction first, its knots and its degree."""
    if direction == 0:
        return surface.poles, surface.knots_u, surface.degree_u
    return surface.poles.swapaxes(0, 1), surface.knots_v, surface.degree_v


def _replace_direction(
    surface: BSplineSurface, direction: int, poles: Array, knots: Array, degree: int
) -> BSplineSurface:
    """The surface with new poles (chosen direction first), and new knots and degree along that direction."""
    if direction == 0:
        return BSplineSurface(poles.copy(), knots, surface.knots_v, degree, surface.degree_v)
    return BSplineSurface(poles.swapaxes(0, 1).copy(), surface.knots_u, knots, surface.degree_u, degree)
