"""The series of minimal surfaces, derived anew from the nodal formulas: coefficients, residuals, and distances.

    python -m benchmarks.minimal_series iwp neovius        # the entries of tpmscad/minimal_series.py and a row of the table each
    python -m benchmarks.minimal_series --check            # the table of the stored series, without fits

Unknowns are the coefficients of all orbits of wave vectors up to a length, but for the shortest wave of the nodal formula, which
sets the scale. Residuals are the mean curvatures H at points of the zero set, which follow it along the normal, and GAMMAS times
the coefficients, weighted by 1 + |k|^2. The latter choose among all functions with the same zero set, f and g f with g > 0, the
smoothest, which has no further zeros; without them some series vanish on spheres elsewhere. The length grows in steps, each of
which starts from the one before. The figures come from fresh points; H by differences of the unit normal, not by the fit's
formula.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from scipy.optimize import minimize

from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.minimal_series import GENERATORS, INVERSION_ODD, MINIMAL_SERIES, WaveVector, expand_orbit, generate_group

LENGTHS = {
    "gyroid": (4, 5, 6, 7, 8, 9),
    "diamond": (4, 5, 6),
    "schwarz_p": (3, 4, 5, 6),
    "iwp": (3, 4, 5, 6, 7, 8),
    "neovius": (3, 4, 5, 6, 7, 8),
    "frd": (5, 6, 7, 8, 9, 10),
    "fischer_koch_s": (4, 5, 6, 7, 8, 9, 10, 11, 12),
}
"""Greatest |k| of successive steps."""

EXACT_GAMMAS = (1e-3, 1e-5, 1e-7, 1e-8, 1e-10, 1e-10)
GAMMAS = {
    **dict.fromkeys(("gyroid", "diamond", "schwarz_p"), EXACT_GAMMAS),
    "iwp": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    "neovius": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    "frd": (1e-3, 1e-4, 1e-5, 1e-5, 1e-6, 1e-6),
    "fischer_koch_s": (1e-3, 1e-4, 1e-4, 1e-5, 1e-5, 1e-6, 1e-6, 1e-7, 1e-7),
}
"""Weight of the coefficients in each step."""

MAX_STEPS, MAX_TRIALS, STALLED = 60, 12, 0.98
FRESH_POINTS = 3000
NORMAL_STEP = 1e-4


class Orbits:
    """Orbit sums of plane waves as functions of points: values, gradients, Hessians."""

    def __init__(self, name: str, length: float) -> None:
        group, odd = generate_group(GENERATORS[name]), INVERSION_ODD in GENERATORS[name]
        span = range(int(length) + 1)
        every = [(h, k, n) for h in span for k in span for n in range(-int(length), int(length) + 1)]
        every = [k for k in every if np.dot(k, k) <= length**2]
        every.sort(key=lambda k: (np.dot(k, k), tuple(-c for c in k)))
        self.heads: list[WaveVector] = []
        parts: list[dict[WaveVector, complex]] = []
        known: set[WaveVector] = set()
        for k in every:
            if k in known or tuple(-c for c in k) in known:
                continue
            orbit = expand_orbit(group, k, odd)
            known |= {k, *orbit}
            if orbit:
                self.heads.append(k)
                parts.append(orbit)
        self.vectors = np.array([k for part in parts for k in part])
        self.amplitudes = np.array([a for part in parts for a in part.values()])
        self.sizes = np.array([len(part) for part in parts])
        self.starts = np.cumsum(self.sizes) - self.sizes
        self.weights = 1.0 + (np.array(self.heads) ** 2).sum(axis=1)

    def waves(self, points: Array) -> Array:
        """All waves (n, W), by powers of those of length one."""
        top = int(np.abs(self.vectors).max())
        powers = np.exp(2j * np.pi * points)[:, :, None] ** np.arange(-top, top + 1)
        x, y, z = (powers[:, axis, self.vectors[:, axis] + top] for axis in range(3))
        return np.asarray(self.amplitudes * x * y * z)

    def jets(self, points: Array) -> tuple[Array, Array, Array]:
        """Values (n, B), gradients (n, B, 3) and Hessians (n, B, 3, 3) of all orbit sums."""
        wave, k = self.waves(points), 2 * np.pi * self.vectors

        def total(terms: Array) -> Array:
            return np.add.reduceat(terms, self.starts, axis=1)

        gradient = np.stack([total(-wave.imag * k[:, i]) for i in range(3)], axis=-1)
        hessian = np.stack(
            [np.stack([total(-wave.real * k[:, i] * k[:, j]) for j in range(3)], axis=-1) for i in range(3)], axis=-2
        )
        return total(wave.real), gradient, hessian

    def jet(self, c: Array, points: Array) -> tuple[Array, Array, Array]:
        """Values (n,), gradients (n, 3) and Hessians (n, 3, 3) of the series."""
        wave, k = self.waves(points) * np.repeat(c, self.sizes), 2 * np.pi * self.vectors
        dyads = (k[:, :, None] * k[:, None, :]).reshape(-1, 9)
        return wave.real.sum(axis=1), -wave.imag @ k, (-wave.real @ dyads).reshape(-1, 3, 3)

    def project(self, c: Array, points: Array, steps: int) -> tuple[Array, Array]:
        """Points after steps along the gradient to the zero set, and their distances from it to first order."""
        for _ in range(steps):
            value, g, _ = self.jet(c, points)
            move = (value / (g * g).sum(axis=1))[:, None] * g
            length = np.linalg.norm(move, axis=1, keepdims=True)
            points = points - move * np.minimum(1.0, 0.03 / np.maximum(length, 1e-30))
        value, g, _ = self.jet(c, points)
        return points, np.abs(value) / np.linalg.norm(g, axis=1)

    def sample(self, c: Array, count: int, rng: np.random.Generator) -> Array:
        """Points of the zero set."""
        points, miss = self.project(c, rng.random((3 * count, 3)), 20)
        return points[miss < 1e-12][:count]


def mean_curvature(g: Array, h: Array) -> Array:
    """Half the divergence of the unit normal."""
    n = np.linalg.norm(g, axis=1)
    along = np.einsum("ni,nij,nj->n", g, h, g) / n**2
    return np.asarray((np.trace(h, axis1=1, axis2=2) - along) / (2 * n))


def differentiate_curvature(orbits: Orbits, c: Array, points: Array) -> tuple[Array, Array]:
    """H (n,) at points of the zero set and its derivatives (n, B) by the coefficients; the points move along the normal."""
    values, gs, hs = orbits.jets(points)
    g, h = np.einsum("nbi,b->ni", gs, c), np.einsum("nbij,b->nij", hs, c)
    n = np.linalg.norm(g, axis=1)
    normal = g / n[:, None]
    h_n = np.einsum("nij,nj->ni", h, normal)
    q, trace = (h_n * normal).sum(axis=1), np.trace(h, axis1=1, axis2=2)
    along = np.einsum("nbi,ni->nb", gs, normal)
    change = 2 * np.einsum("nbi,ni->nb", gs, h_n) + (trace - 3 * q)[:, None] * along
    fixed = np.trace(hs, axis1=2, axis2=3) - np.einsum("ni,nbij,nj->nb", normal, hs, normal) - change / n[:, None]
    step = 1e-5
    ahead, behind = (mean_curvature(*orbits.jet(c, points + s * step * normal)[1:]) for s in (1, -1))
    return (trace - q) / (2 * n), fixed / (2 * n[:, None]) - ((ahead - behind) / (2 * step * n))[:, None] * values


def fit_series(orbits: Orbits, c: Array, points: Array, gamma: float, fixed: int) -> Array:
    """Coefficients after Levenberg-Marquardt steps."""
    free = np.arange(len(c)) != fixed
    weights = orbits.weights[free]
    points, _ = orbits.project(c, points, 8)
    root = np.sqrt(len(points))
    damping, stalled = 1e-3, 0

    def cost(h: Array, c: Array) -> float:
        return float((h / root) @ (h / root) + gamma**2 * ((weights * c[free]) ** 2).sum())

    best = cost(mean_curvature(*orbits.jet(c, points)[1:]), c)
    for _ in range(MAX_STEPS):
        h, jacobian = differentiate_curvature(orbits, c, points)
        rows = np.vstack([jacobian[:, free] / weights / root, gamma * np.eye(len(weights))])
        left, sizes, right = np.linalg.svd(rows, full_matrices=False)
        against = left.T @ np.concatenate([h / root, gamma * weights * c[free]])
        for _ in range(MAX_TRIALS):
            trial = c.copy()
            trial[free] -= right.T @ (sizes / (sizes**2 + (damping * sizes[0]) ** 2) * against) / weights
            moved, miss = orbits.project(trial, points, 8)
            new = cost(mean_curvature(*orbits.jet(trial, moved)[1:]), trial)
            if miss.max() < 1e-10 and new < best:
                break
            damping *= 4
        else:
            break
        stalled = stalled + 1 if new > STALLED * best else 0
        c, points, best, damping = trial, moved, new, max(damping / 8, 1e-14)
        if stalled > 2:
            break
    return c


def nodal_coefficients(name: str) -> dict[WaveVector, complex]:
    """Fourier coefficients of the nodal formula, twice those of e^(2 pi i k x)."""
    t = np.arange(16) / 16
    spectrum = 2 * np.fft.fftn(fields.tpms(name, 1.0).on_grid(t, t, t)) / 16**3
    found = {}
    for k in np.argwhere(np.abs(spectrum) > 1e-9):
        h, m, n = ((int(i) + 8) % 16 - 8 for i in k)
        found[h, m, n] = complex(spectrum[tuple(k)])
    return found


def derive(name: str) -> dict[WaveVector, float]:
    """The coefficients of a surface's series."""
    rng = np.random.default_rng(1)
    nodal = nodal_coefficients(name)
    known: dict[WaveVector, float] = {}
    for length, gamma in zip(LENGTHS[name], GAMMAS[name], strict=False):
        orbits = Orbits(name, length)
        if not known:
            first = dict(zip(orbits.heads, orbits.amplitudes[orbits.starts], strict=True))
            known = {k: float((nodal[k] / first[k]).real) for k in orbits.heads if k in nodal}
            scale = next(iter(known))
        c = np.array([known.get(k, 0.0) for k in orbits.heads])
        points = orbits.sample(c, max(400, 8 * len(c)), rng)
        c = fit_series(orbits, c, points, gamma, orbits.heads.index(scale))
        known = dict(zip(orbits.heads, c.tolist(), strict=True))
        fresh = orbits.sample(c, FRESH_POINTS, rng)
        print(f"# {name} {length} {len(c)} {np.abs(mean_curvature(*orbits.jet(c, fresh)[1:])).max():.1e}", flush=True)
    return known


def measure(name: str, known: dict[WaveVector, float]) -> tuple[float, float, tuple[float, float]]:
    """Greatest |H| at fresh points by differences of the normal, greatest distance to the nodal surface, range of f."""
    orbits = Orbits(name, max(float(np.linalg.norm(k)) for k in known) + 1e-9)
    c = np.array([known.get(k, 0.0) for k in orbits.heads])
    rng = np.random.default_rng(77)
    points = orbits.sample(c, FRESH_POINTS, rng)

    def normal(x: Array) -> Array:
        g = orbits.jet(c, x)[1]
        return np.asarray(g / np.linalg.norm(g, axis=1, keepdims=True))

    divergence = np.zeros(len(points))
    for axis in np.eye(3) * NORMAL_STEP:  # differences of the fourth order
        near, far = (((normal(points + s * axis) - normal(points - s * axis)) @ axis) for s in (1, 2))
        divergence += (8 * near - far) / (12 * NORMAL_STEP**2)
    nodal = fields.tpms(name, 1.0)
    foot = points.copy()
    for _ in range(8):
        value, g = nodal.value_and_gradient(foot)
        foot -= (value / (g * g).sum(axis=1))[:, None] * g
    # orthogonal distance: the foot on the nodal surface whose normal leads to the point, by alternating projections
    for _ in range(60):
        g = nodal.gradient(foot)
        n = g / np.linalg.norm(g, axis=1, keepdims=True)
        foot = points - ((points - foot) * n).sum(axis=1, keepdims=True) * n
        value, g = nodal.value_and_gradient(foot)
        foot -= (value / (g * g).sum(axis=1))[:, None] * g
    distance = float(np.linalg.norm(points - foot, axis=1).max())
    t = np.arange(24) / 24
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.concatenate([orbits.jet(c, part)[0] for part in np.array_split(grid, 24)])
    ends = []
    for sign in (1, -1):
        found = minimize(
            lambda x, sign=sign: (sign * orbits.jet(c, x[None])[0][0], sign * orbits.jet(c, x[None])[1][0]),
            grid[np.argmin(sign * values)],
            jac=True,
            tol=1e-12,
        )
        ends.append(sign * float(found.fun))
    return float(np.abs(divergence).max() / 2), distance, (ends[0], ends[1])


def write_entry(name: str, known: dict[WaveVector, float]) -> None:
    """Print the entry of `tpmscad/minimal_series.py` and the row of the table."""
    curvature, distance, span = measure(name, known)
    entries = [f"{' '.join(map(str, k))} {c!r}" for k, c in known.items()]
    lines = ["; ".join(entries[i : i + 3]) for i in range(0, len(entries), 3)]
    print(f'        "{name}": MinimalSeries(\n            GENERATORS["{name}"],\n            _read_table("""')
    print("\n".join(lines))
    print(f'"""),\n            mean_curvature={curvature:.1e},\n            nodal_distance={distance:.4g},')
    print(f"            value_range=({span[0]!r}, {span[1]!r}),\n        ),")
    print(f"# | {name} | {len(known)} | {curvature:.1e} | {distance:.3e} |", flush=True)


def main() -> None:
    """Derive the series of the surfaces named, or measure the stored ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[])
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    for name in options.names or GENERATORS:
        start = time.process_time()
        if options.check:
            known = dict(MINIMAL_SERIES[name].coefficients)
            curvature, distance, _ = measure(name, known)
            print(f"| {name} | {len(known)} | {curvature:.1e} | {distance:.3e} |", flush=True)
        else:
            write_entry(name, derive(name))
            print(f"# {time.process_time() - start:.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()
