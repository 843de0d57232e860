"""Judges of the standing trial that share no code with what they judge: formulas evaluated here, plain text, labels, meshes.

`Region` tells inside from outside by the published formula and its distance, found by Newton steps.
Volumes are compared with a stratified sample, with five standard errors and the certified deviation as the limit.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import sympy
from scipy.ndimage import generate_binary_structure, label

Points = np.ndarray
Inside = Callable[[Points], np.ndarray]

STANDARD_ERRORS = 5.0
SAMPLES_PER_AXIS = 48
LABEL_GRIDS = (40, 56)
FOOT_STEPS = 8

MINIMAL_OFF = {
    "gyroid": 1.4e-3,
    "diamond": 8e-4,
    "schwarz_p": 1.2e-2,
    "iwp": 4.8e-2,
    "neovius": 1.4e-2,
    "frd": 2.1e-2,
    "fischer_koch_s": 9e-3,
}
"""Greatest distance between the minimal surface and its nodal namesake, in cells."""


class NodalFunction:
    """A catalogue formula such as `2*cos(x)*cos(y) - cos(2*x)` as a function of points, with x = 2 pi (p / cell - phase)."""

    def __init__(self, text: str, cell: Sequence[float], phase: Sequence[float]) -> None:
        axes = sympy.symbols("x y z")
        value = sympy.sympify(text, locals=dict(zip("xyz", axes, strict=True)))
        self._value = sympy.lambdify(axes, value, "numpy", cse=True)
        self._jet = sympy.lambdify(axes, [value, *(sympy.diff(value, axis) for axis in axes)], "numpy", cse=True)
        self._cell, self._phase = np.asarray(cell, float), np.asarray(phase, float)

    def _angles(self, p: Points) -> np.ndarray:
        return np.moveaxis(2 * np.pi * (p / self._cell - self._phase), -1, 0)

    def __call__(self, p: Points) -> np.ndarray:
        return np.asarray(self._value(*self._angles(p)))

    def jet(self, p: Points) -> tuple[np.ndarray, np.ndarray]:
        """Values (n,) and gradients (n, 3) at points (n, 3)."""
        value, *slopes = self._jet(*self._angles(p))
        return value, np.stack(slopes, axis=-1) * (2 * np.pi / self._cell)


def jet(f: Callable[[Points], np.ndarray], p: Points, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) and gradients (n, 3) at points (n, 3): in closed form where `f` has one, else by differences."""
    if isinstance(f, NodalFunction):
        return f.jet(p)
    return f(p), np.stack([(f(p + step * e) - f(p - step * e)) / (2 * step) for e in np.eye(3)], axis=-1)


def signed_distance(f: Callable[[Points], np.ndarray], p: Points, reach: float, size: float) -> np.ndarray:
    """Distance of points (n, 3) to {f = 0} with the sign of f where it is below `reach`; elsewhere something larger.

    Foot points by steps to the level set along the gradient and tangential steps towards the point, from the point itself.
    """
    step = 1e-5 * size
    value, g = jet(f, p, step)
    slope = np.linalg.norm(g, axis=-1)
    near = np.flatnonzero(np.abs(value) < 2.5 * reach * np.maximum(slope, 0.25 * np.median(slope)))
    result = np.sign(value) * 9e9
    at, foot = p[near], p[near].copy()
    for _ in range(FOOT_STEPS):
        height, g = jet(f, foot, step)
        square = np.maximum((g * g).sum(axis=-1, keepdims=True), 1e-30)
        move = -height[:, None] * g / square
        across = at - foot
        move += 0.7 * (across - (across * g).sum(axis=-1, keepdims=True) * g / square)
        foot += move * np.minimum(1.0, 0.1 * size / np.maximum(np.linalg.norm(move, axis=-1, keepdims=True), 1e-30))
    found = np.linalg.norm(at - foot, axis=-1)
    result[near] = np.sign(value[near]) * found
    return result


@dataclass(frozen=True)
class Region:
    """A solid by its inside test, in a box [low, high]; `smear` is how far its true boundary may be from the tested one."""

    inside: Inside
    low: np.ndarray
    high: np.ndarray
    smear: float = 0.0

    def volume(self, area: float) -> tuple[float, float]:
        """Volume by one random point in each of many cells, and the error to be allowed for."""
        n = SAMPLES_PER_AXIS
        rng = np.random.default_rng(7)
        grid = np.stack(np.meshgrid(*(np.arange(n),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        step = (self.high - self.low) / n
        hit = np.concatenate(
            [self.inside(self.low + step * (part + rng.random(part.shape))) for part in np.array_split(grid, 8)]
        )
        mean, cell = hit.mean(), float(step.prod())
        crossed = min(len(hit), area / cell ** (2 / 3) * 1.5 + 8)  # only cells that the boundary passes vary
        error = STANDARD_ERRORS * 0.5 * np.sqrt(crossed) * cell + self.smear * area
        return float(mean * len(hit) * cell), float(error)

    def pieces(self, n: int) -> tuple[list[int], list[int]]:
        """Sizes of the components by faces and by corners, largest first, of a grid with `n` samples on the longest edge."""
        counts = np.maximum(12, np.ceil(n * (self.high - self.low) / (self.high - self.low).max()).astype(int))
        axes = [a + (b - a) * (np.arange(m) + 0.5) / m for a, b, m in zip(self.low, self.high, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        solid = np.stack([self.inside(plane.reshape(-1, 3)).reshape(plane.shape[:-1]) for plane in points])
        found = []
        for connectivity in (1, 3):
            labels, _ = label(solid, generate_binary_structure(3, connectivity))
            found.append(sorted(np.bincount(labels.ravel())[1:].tolist(), reverse=True))
        return found[0], found[1]


def judge_solid(region: Region, volume: float, area: float, n_pieces: int, dropped: Sequence[float]) -> list[str]:
    """What contradicts a solid's certified volume and number of pieces; chips that were left out are added to its volume."""
    faults = []
    expected, error = region.volume(area)
    if abs(volume + sum(dropped) - expected) > error + 1e-3 * expected:
        faults.append(f"volume {volume + sum(dropped):.6g}, the sample says {expected:.6g} +- {error:.2g}")
    labelled = [sizes for n in LABEL_GRIDS for sizes in region.pieces(n)]
    counts = {sum(s >= 0.02 * sizes[0] for s in sizes) for sizes in labelled if sizes}
    small = any(sizes[-1] < 0.02 * sizes[0] for sizes in labelled if sizes)
    if len(counts) == 1 and (n_pieces < min(counts) or (n_pieces > min(counts) and not small)):
        faults.append(f"{n_pieces} pieces, labels on {LABEL_GRIDS} samples say {min(counts)}")
    return faults


def judge_step_text(path: Path, n_solids: int, n_faces: int) -> list[str]:
    """What a file's own text contradicts: numbers of solids and faces, and every edge used once in each direction."""
    text = re.sub(r"\s+", "", path.read_text(encoding="ascii"))  # writers break lines where they like
    names = Counter(re.findall(r"=([A-Z_]+)\(", text))
    faults = []
    if (solids := names["MANIFOLD_SOLID_BREP"] + names["BREP_WITH_VOIDS"]) != n_solids:
        faults.append(f"the file has {solids} solids, the certificate {n_solids}")
    if names["ADVANCED_FACE"] != n_faces:
        faults.append(f"the file has {names['ADVANCED_FACE']} faces, the certificate {n_faces}")
    oriented = dict(re.findall(r"#(\d+)=ORIENTED_EDGE\('[^']*',\*,\*,(#\d+,\.[TF]\.)\)", text))
    loops = dict(re.findall(r"#(\d+)=EDGE_LOOP\('[^']*',\(([^)]*)\)\)", text))
    uses: Counter[tuple[str, bool]] = Counter()
    for loop, along in re.findall(r"=FACE(?:_OUTER)?_BOUND\('[^']*',#(\d+),\.([TF])\.\)", text):
        for use in loops.get(loop, "").replace("#", "").split(","):
            edge, _, sense = oriented.get(use, "?,").partition(",")
            uses[edge, (sense == ".T.") == (along == "T")] += 1
    edges = {edge for edge, _ in uses}
    if not edges or any(uses[edge, sense] != 1 for edge in edges for sense in (True, False)):
        faults.append("an edge of the file is not used once in each direction")
    return faults


def judge_stl(path: Path, volume: float, tol: float, area: float) -> list[str]:
    """What the triangles of a binary STL file contradict: closedness and volume."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80)
    record = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("flag", "<u2")])
    corners = np.frombuffer(data, record, count, 84)["corner"]
    _, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = index.reshape(-1, 3)
    sides = Counter(
        map(tuple, np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).tolist())
    )
    faults = []
    if any(sides[b, a] != n for (a, b), n in sides.items()):
        faults.append("the mesh is open")
    x = corners.astype(float) - corners.reshape(-1, 3).mean(axis=0, dtype=float)
    found = float(np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 1], x[:, 2])).sum() / 6)
    if abs(found - volume) > 2 * tol * area + 1e-5 * abs(volume):
        faults.append(f"the mesh bounds {found:.6g}, the certificate says {volume:.6g}")
    return faults


def gmsh_volume(path: Path) -> float:
    """The volume of all solids of a STEP file by gmsh, which has a kernel of its own."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.model.occ.importShapes(str(path))
        return float(sum(gmsh.model.occ.getMass(*entity) for entity in gmsh.model.occ.getEntities(3)))
    finally:
        gmsh.finalize()
