"""Trivariate B-splines as coordinate maps: design domains of free form for lattices and fields.

The spline maps the box of its knots, the *domain*, to the model. Its Jacobian determinant is proved positive by Bernstein
coefficients (`tpmscad.splines.jacobian_bounds`), so that it is one-to-one near every point. As a whole it is one-to-one if
no point of the boundary has a second preimage: the number of preimages changes at the image of the boundary only. That is
tested on a grid.

Source of the application: porous scaffolds that are built in the unit cube and mapped to a trivariate B-spline solid, as in
figure 13 of the porous-blending paper.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from tpmscad._typing import Array, triple
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import CONTROL_NET, DEGREES, KNOTS
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.splines.bspline_volume import BSplineVolume
from tpmscad.splines.jacobian_bounds import bound_jacobian
from tpmscad.splines.knots import bezier_knots

EDGE_SAMPLES = 9
"""Samples along each axis for the mean lengths of a domain."""

SAMPLES_PER_SPAN = 4
"""Samples along each span of knots at which the map is tested for a second preimage."""

NEAREST_SAMPLES = 24
"""Samples nearest to the image of a boundary point from which a second preimage is sought."""

STARTS_PER_SAMPLE = 2
"""The nearest of them that are no neighbours of the point in the domain: Newton's method starts there."""

NEWTON_STEPS = 8
"""Newton steps to a preimage."""

SAME_IMAGE_FRACTION = 1e-6
"""Distance, in extents of the image, within which a preimage has converged."""

SAME_PREIMAGE_FRACTION = 1e-3
"""Preimages nearer than this fraction of the domain are one; its boundary may touch itself within this fraction."""

CLOSED_TOL_FRACTION = 1e-12
"""A spline closes along an axis if both ends agree to this fraction of its extent, with two derivatives."""


@dataclass(frozen=True, slots=True, repr=False)
class SplineMap(Map):
    """A trivariate B-spline as a coordinate map: what `trivariate` and `between` make.

    Attributes
    ----------
    least_jacobian : float
        A proved lower bound of the Jacobian determinant on the domain: positive.
    closed : (bool, bool, bool)
        Along which axes the ends of the domain meet, so that a lattice closes there.
    face_error : float
        Greatest measured distance, in model units, of the ends of the map from the two faces that it was made between; 0 for
        a map of given poles.
    """

    volume: BSplineVolume = field(kw_only=True)
    least_jacobian: float = field(kw_only=True)
    closed: tuple[bool, bool, bool] = field(kw_only=True)
    face_error: float = field(kw_only=True, default=0.0)

    @property
    def domain(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The corners of the domain, the box of parameters that the spline maps: lower and upper."""
        (u0, u1), (v0, v1), (w0, w1) = self.volume.domain
        return (u0, v0, w0), (u1, v1, w1)

    def mean_edges(self) -> Array:
        """Return the mean lengths, in model units, of the domain's edges along its three axes: (3,)."""
        grid = [np.linspace(*ends, EDGE_SAMPLES) for ends in self.volume.domain]
        points = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
        lengths = np.linalg.norm(self.volume.images(points)[1], axis=1).mean(axis=0)
        return np.asarray(lengths * np.ptp(self.volume.domain, axis=1))

    def __repr__(self) -> str:
        """The lengths of the domain along its axes, and a number of cells that makes them about cubic."""
        edges = self.mean_edges()
        cells = np.maximum(1, np.rint(edges / edges.min())).astype(int)
        lengths, each = (" x ".join(f"{edge:.4g}" for edge in of) for of in (edges, edges / cells))
        return (
            f"{self.name}: {lengths} mm along its axes on average; cells={tuple(cells.tolist())} are about cubic, {each} mm, and "
            "so are multiples"
        )

    def over_block(self, size: Array) -> Map:
        """Return the map of a lattice whose block of cells fills the domain.

        Parameters
        ----------
        size : ndarray, shape (3,)
            Edges of the block, in model units.

        Returns
        -------
        Map
            The map of the block, scaled to the domain.
        """
        low, high = (np.array(corner) for corner in self.domain)
        return BlockMap.over(self.volume, self.closed, low, (high - low) / size, self.name)

    def images_and_jacobians(self, points: Array, scale: float) -> tuple[Array, Array]:
        """Return images (..., 3) and exact Jacobians (..., 3, 3) of points (..., 3) of the domain."""
        return _evaluate(self.volume, self.closed, points)


@dataclass(frozen=True, slots=True)
class BlockMap(Map):
    """A trivariate B-spline of a block of cells: the block is first scaled by `factor` (3,) to the domain, from `low` (3,).

    Along the axes that are `closed` it repeats after the length of the domain.
    """

    volume: BSplineVolume = field(kw_only=True)
    closed: tuple[bool, bool, bool] = field(kw_only=True)
    low: Array = field(kw_only=True)
    factor: Array = field(kw_only=True)

    @classmethod
    def over(
        cls, volume: BSplineVolume, closed: tuple[bool, bool, bool], low: Array, factor: Array, name: str
    ) -> BlockMap:
        """The map of a block that is scaled by `factor` (3,) to the domain, from its corner `low` (3,)."""
        return cls(
            lambda p: _evaluate(volume, closed, low + factor * p)[0],
            lambda p: _evaluate(volume, closed, low + factor * p)[1] * factor,
            name,
            volume=volume,
            closed=closed,
            low=low,
            factor=factor,
        )

    def images_and_jacobians(self, points: Array, scale: float) -> tuple[Array, Array]:
        """Return images (..., 3) and exact Jacobians (..., 3, 3) of points (..., 3) of the block."""
        image, jacobian = _evaluate(self.volume, self.closed, self.low + self.factor * points)
        return image, jacobian * self.factor


@validate_call()
def trivariate(
    poles: Annotated[ArrayLike, CONTROL_NET, "Control net, in model units."],
    knots: Annotated[
        ArrayLike | None,
        KNOTS,
        "Knot vectors with repetition, U + degree + 1 knots along the first axis, and so on. By default each has a "
        "single span, 0 to 1.",
    ] = None,
    degrees: Annotated[
        ArrayLike | None, DEGREES, "Polynomial degrees; by default the numbers of poles along the axes less one."
    ] = None,
) -> SplineMap:
    """Return the map of a trivariate B-spline, a design domain of free form.

    Returns
    -------
    SplineMap
        The map from the box of the knots, the unit cube by default, with its exact Jacobian. Beyond the box the polynomials of
        the last spans go on.

    Raises
    ------
    InvalidRequest
        If knots, degrees and poles do not fit each other; if the spline folds, that is, if its Jacobian is not positive
        everywhere, with the place; or if two parts of the domain lie on each other.

    Notes
    -----
    The Jacobian determinant of each span is a polynomial whose Bernstein coefficients bound it from below. `least_jacobian`
    of the result is the bound.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import maps
    >>> corners = np.stack(np.meshgrid([0.0, 20.0], [0.0, 10.0], [0.0, 5.0], indexing="ij"), axis=-1)
    >>> block = maps.trivariate(corners)
    >>> block([0.5, 0.5, 0.5])
    array([10. ,  5. ,  2.5])
    >>> round(block.least_jacobian, 6)
    1000.0
    """
    net = np.asarray(poles, float)
    if net.shape[-1] != 3:
        raise InvalidRequest(f"poles of shape {net.shape} must have three coordinates: (U, V, W, 3)")
    p, q, r = (int(n) - 1 for n in net.shape[:3]) if degrees is None else (int(d) for d in np.asarray(degrees))
    given = [bezier_knots(d) for d in (p, q, r)] if knots is None else [np.asarray(k, float) for k in knots]  # type: ignore[union-attr]
    _check_knots(net, given, (p, q, r))
    return spline_map(BSplineVolume(net, triple(given), (p, q, r)), "trivariate spline")


def spline_map(
    volume: BSplineVolume, name: str, face_error: float = 0.0, remedy: str = "move the poles apart there"
) -> SplineMap:
    """The map of a trivariate spline; InvalidRequest with the place if it folds or lies on itself."""
    closed = _find_closed_axes(volume)
    result = SplineMap(
        lambda p: _evaluate(volume, closed, p)[0],
        lambda p: _evaluate(volume, closed, p)[1],
        name,
        volume=volume,
        least_jacobian=_prove_positive_jacobian(volume, name, remedy),
        closed=closed,
        face_error=face_error,
    )
    _require_one_to_one(result, remedy)
    return result


def _check_knots(net: Array, knots: list[Array], degrees: tuple[int, int, int]) -> None:
    for axis, (t, degree, n) in enumerate(zip(knots, degrees, net.shape, strict=False)):
        name = "uvw"[axis]
        if not 1 <= degree < n:
            raise InvalidRequest(f"degree {degree} along {name} must be at least 1 and below the number of poles, {n}")
        if t.shape != (n + degree + 1,):
            raise InvalidRequest(
                f"{n} poles of degree {degree} along {name} need {n + degree + 1} knots, with repetition, not {t.size}"
            )
        if not (np.isfinite(t).all() and (np.diff(t) >= 0).all()):
            raise InvalidRequest(f"knots along {name} must be finite and must not decrease")
        inner, counts = np.unique(t, return_counts=True)
        if counts[0] != degree + 1 or counts[-1] != degree + 1:
            raise InvalidRequest(
                f"the first and last knot along {name} must be repeated {degree + 1} times, degree + 1"
            )
        if (worst := int(counts[1:-1].max(initial=1))) > max(degree - 1, 1) or (degree == 1 and len(inner) > 2):
            raise InvalidRequest(
                f"a knot along {name} is repeated {worst} times at degree {degree}: the map must be smooth, "
                "so a knot inside is repeated at most degree - 1 times; split the domain there"
            )


def _find_closed_axes(volume: BSplineVolume) -> tuple[bool, bool, bool]:
    """Along which axes both ends agree in position and two derivatives."""
    extent = float(np.ptp(volume.poles.reshape(-1, 3), axis=0).max())
    closed = []
    for axis, (low, high) in enumerate(volume.domain):
        grid = [np.linspace(*d, 9) for d in volume.domain]
        grid[axis] = np.array([low, high])
        misses = []
        for order in range(min(2, volume.degrees[axis]) + 1):
            orders = (order * (axis == 0), order * (axis == 1), order * (axis == 2))
            ends = volume.grid(grid[0], grid[1], grid[2], orders) * (high - low) ** order
            misses.append(np.abs(np.diff(ends, axis=axis)).max() / max(np.abs(ends).max(), extent))
        closed.append(bool(max(misses) <= CLOSED_TOL_FRACTION * 10 ** len(misses)))
    return triple(closed)


def _evaluate(volume: BSplineVolume, closed: tuple[bool, bool, bool], points: Array) -> tuple[Array, Array]:
    """Images (..., 3) and Jacobians (..., 3, 3) of parameters (..., 3), periodic along closed axes."""
    flat = points.reshape(-1, 3).copy()
    for axis, (low, high) in enumerate(volume.domain):
        if closed[axis]:
            flat[:, axis] = low + np.mod(flat[:, axis] - low, high - low)
    image, jacobian = volume.images(flat)
    return image.reshape(points.shape), jacobian.reshape(*points.shape, 3)


def _prove_positive_jacobian(volume: BSplineVolume, name: str, remedy: str) -> float:
    """A positive lower bound of the Jacobian determinant; InvalidRequest with the place where it is not positive."""
    spans = [np.unique(t[p : len(t) - p]) for t, p in zip(volume.knots, volume.degrees, strict=True)]
    corner = np.stack(np.meshgrid(*(s[:-1] for s in spans), indexing="ij"), axis=-1).reshape(-1, 3)
    size = np.stack(np.meshgrid(*map(np.diff, spans), indexing="ij"), axis=-1).reshape(-1, 3)
    # by the parameters of a span's own unit cube the determinant is scale^3 times as large
    scale = np.cbrt(size.prod(axis=1))
    bound = bound_jacobian(volume.bezier_nets() / scale[:, None, None, None, None])
    if bound.positive:
        return bound.lower
    at = corner[bound.body] + size[bound.body] * np.array(bound.parameters)
    place = f"at {format_point(at)} in its domain, {format_point(volume.images(at[None])[0][0])} in the model"
    if bound.attained > 0:
        raise InvalidRequest(
            f"the Jacobian of the {name} comes too close to zero to be proved positive: {bound.attained:.3g} {place}; "
            f"{remedy}"
        )
    middle = [[(low + high) / 2] for low, high in volume.domain]
    turned = "reverse one axis of the poles, poles[::-1], if the whole of it is left-handed"
    raise InvalidRequest(
        f"the {name} folds: its Jacobian determinant is {bound.attained:.3g} {place}; "
        + (turned if volume.jacobian(*middle).item() < 0 else remedy)
    )


def _require_one_to_one(map: SplineMap, remedy: str) -> None:
    """InvalidRequest if a sample of the boundary has a second preimage in the domain."""
    volume = map.volume
    low, high = (np.array(corner) for corner in map.domain)
    steps = [SAMPLES_PER_SPAN * (n - p) + 1 for n, p in zip(volume.poles.shape, volume.degrees, strict=False)]
    index = np.stack(np.meshgrid(*(np.arange(n) for n in steps), indexing="ij"), axis=-1).reshape(-1, 3)
    samples = low + (high - low) * index / (np.array(steps) - 1)
    images, _ = volume.images(samples)
    open_axes = ~np.array(map.closed)
    on_boundary = (((index == 0) | (index == np.array(steps) - 1)) & open_axes).any(axis=1)
    own = np.flatnonzero(on_boundary)
    _, near = cKDTree(images).query(images[own], min(NEAREST_SAMPLES, len(images)))
    apart = np.abs(index[own][:, None] - index[near])
    period = np.where(open_axes, 0, np.array(steps) - 1)
    apart = np.where(period > 0, np.minimum(apart, period - apart), apart)
    distinct = apart.max(axis=-1) > 1
    rows, columns = np.nonzero(distinct & (np.cumsum(distinct, axis=1) <= STARTS_PER_SAMPLE))
    start, target = samples[near[rows, columns]], images[own][rows]
    preimage = _find_preimages(volume, start, target)
    margin = SAME_PREIMAGE_FRACTION * (high - low)
    inside = ((preimage > low + margin) & (preimage < high - margin) | ~open_axes).all(axis=1)
    step = np.abs(preimage - samples[own][rows]) / (high - low)
    step = np.where(open_axes, step, np.abs(step - np.rint(step)))
    other = inside & (step.max(axis=1) > 10 * SAME_PREIMAGE_FRACTION)
    hit = np.zeros(len(other), bool)
    hit[other] = np.linalg.norm(
        volume.images(preimage[other])[0] - target[other], axis=1
    ) < SAME_IMAGE_FRACTION * np.ptp(images)
    if hit.any():
        k = int(np.flatnonzero(hit)[0])
        raise InvalidRequest(
            f"the {map.name} lies on itself: {format_point(target[k])} in the model is the image of "
            f"{format_point(samples[own][rows[k]])} and of {format_point(preimage[k])} in its domain; {remedy}"
        )


def _find_preimages(volume: BSplineVolume, start: Array, target: Array) -> Array:
    """Parameters (n, 3) near the domain whose images come to the targets (n, 3), by Newton's method from `start` (n, 3)."""
    low, high = (np.array(corner) for corner in zip(*volume.domain, strict=True))
    slack = 0.25 * (high - low)
    at = start
    for _ in range(NEWTON_STEPS):
        image, jacobian = volume.images(at)
        singular = np.abs(np.linalg.det(jacobian)) < np.finfo(float).tiny
        jacobian[singular] = np.eye(3)
        step = np.linalg.solve(jacobian, (target - image)[..., None])[..., 0]
        at = np.clip(at + np.clip(step, -slack, slack), low - slack, high + slack)
    return at
