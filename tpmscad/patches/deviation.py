"""How far a fitted patch is from its reference, measured: orthogonal distances on dense grids, in both directions.

Each sample's foot on the other surface is found by Gauss-Newton from its own parameters, with the fitted patch's tangents (the
reference's differ from them by the error that is being measured). The grid knows nothing of the samples the fit used; around
the worst sample a finer grid looks again, so that the maximum is not missed between samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.splines.bspline import Array, Surface

Reference = Callable[[Array, Array], Array]
"""Positions (..., 3) of the reference surface at (u, v); must hold a little outside the patch's domain, where feet may lie."""

SAMPLES = 49
"""Samples along each parameter: three for each lobe of the error of a patch of degree 16."""

FOOT = 1e-10
"""Feet that move less than this in a step are found: what is left of the tangential part is far below any deviation."""

ROOM = 0.04
"""Feet on the reference may lie this fraction of the domain outside it; a foot held back there only enlarges the distance."""

FOOT_ITERATIONS = 8
"""Gauss-Newton steps: each gains the factor of the tangents' relative error, 1e-1 at worst on the coarsest fits."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Largest and root-mean-square orthogonal distance, and the largest in each direction, in the units of the surfaces."""

    max: float
    rms: float
    to_reference: float
    from_reference: float

    def scaled(self, factor: float) -> Deviation:
        return Deviation(*(factor * getattr(self, name) for name in self.__slots__))


def worst(each: Sequence[Deviation]) -> Deviation:
    """The largest of several patches' deviations, and the root mean square over all of them."""
    return Deviation(
        max=max(d.max for d in each),
        rms=float(np.sqrt(np.mean([d.rms**2 for d in each]))),
        to_reference=max(d.to_reference for d in each),
        from_reference=max(d.from_reference for d in each),
    )


def deviation(fitted: Surface, reference: Reference, samples: int = SAMPLES) -> Deviation:
    """The two-way distance between a fitted patch and the reference on the patch's domain."""
    (u0, u1), (v0, v1) = fitted.domain
    u, v = np.meshgrid(np.linspace(u0, u1, samples), np.linspace(v0, v1, samples), indexing="ij")
    u, v = u.ravel(), v.ravel()
    forward = _to_reference(fitted, reference, u, v)
    backward = _from_reference(fitted, reference, u, v)

    largest = []
    for distances, measure in ((forward, _to_reference), (backward, _from_reference)):
        worst = int(np.argmax(distances))
        step = np.linspace(-1.0, 1.0, 17) / (samples - 1)
        near_u = np.clip(u[worst] + step * (u1 - u0), u0, u1)
        near_v = np.clip(v[worst] + step * (v1 - v0), v0, v1)
        fine_u, fine_v = np.meshgrid(near_u, near_v, indexing="ij")
        fine = measure(fitted, reference, fine_u.ravel(), fine_v.ravel())
        largest.append(float(max(distances.max(), fine.max())))
    rms = float(np.sqrt(np.mean(np.concatenate([forward, backward]) ** 2)))
    return Deviation(max=max(largest), rms=rms, to_reference=largest[0], from_reference=largest[1])


def _to_reference(fitted: Surface, reference: Reference, u: Array, v: Array) -> Array:
    """Distances of fitted points to the reference, whose feet may lie beyond the patch's border: (n,)."""
    points = fitted(u, v)
    tangents = fitted(u, v, 1, 0), fitted(u, v, 0, 1)
    (u0, u1), (v0, v1) = fitted.domain
    room_u, room_v = ROOM * (u1 - u0), ROOM * (v1 - v0)
    a, b = u, v
    for _ in range(FOOT_ITERATIONS):
        da, db = _step(points - reference(a, b), *tangents)
        a, b = np.clip(a + da, u0 - room_u, u1 + room_u), np.clip(b + db, v0 - room_v, v1 + room_v)
        if max(np.abs(da).max(), np.abs(db).max()) < FOOT:
            break
    return np.linalg.norm(points - reference(a, b), axis=-1)


def _from_reference(fitted: Surface, reference: Reference, u: Array, v: Array) -> Array:
    """Distances of reference points to the fitted patch alone, feet kept on it: an upper bound where it ends: (n,)."""
    points = reference(u, v)
    (u0, u1), (v0, v1) = fitted.domain
    a, b = u, v
    for _ in range(FOOT_ITERATIONS):
        residual, along_u, along_v = points - fitted(a, b), fitted(a, b, 1, 0), fitted(a, b, 0, 1)
        da, db = _step(residual, along_u, along_v)
        leaves_u, leaves_v = (a + da < u0) | (a + da > u1), (b + db < v0) | (b + db > v1)
        db = np.where(leaves_u, _ratio(along_v, residual), db)  # on a border the foot slides along it alone
        da = np.where(leaves_v, _ratio(along_u, residual), da)
        a, b = np.clip(a + da, u0, u1), np.clip(b + db, v0, v1)
        if max(np.abs(da).max(), np.abs(db).max()) < FOOT:
            break
    return np.linalg.norm(points - fitted(a, b), axis=-1)


def _ratio(tangent: Array, residual: Array) -> Array:
    return np.einsum("ni,ni->n", tangent, residual) / np.einsum("ni,ni->n", tangent, tangent)


def _step(residual: Array, tangent_u: Array, tangent_v: Array) -> tuple[Array, Array]:
    """The parameter step that cancels the residual's tangential part."""
    uu, uv, vv = (np.einsum("ni,ni->n", p, q) for p, q in ((tangent_u,) * 2, (tangent_u, tangent_v), (tangent_v,) * 2))
    ru, rv = np.einsum("ni,ni->n", tangent_u, residual), np.einsum("ni,ni->n", tangent_v, residual)
    determinant = uu * vv - uv**2
    return (vv * ru - uv * rv) / determinant, (uu * rv - uv * ru) / determinant
