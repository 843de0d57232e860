"""Any implicit field in a box as a patch complex: laid out, fitted, measured, refined where it falls short, or refused.

The coarsest layouts are tried first: uniform ones, with higher degrees where a patch misses, then octrees refined by the turning
of the normals and by what their fits miss. Nothing is accepted that was not measured; what can't pass ends in a LayoutError that
names the place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.patches import field_check
from tpmscad.patches.complex import PatchComplex
from tpmscad.patches.field_caps import LayoutError
from tpmscad.patches.field_fit import NetFit, fit_net
from tpmscad.patches.field_inside import inside
from tpmscad.patches.field_layers import check_apart, layers, rejoined
from tpmscad.patches.field_solid import assemble
from tpmscad.patches.layout import octree
from tpmscad.patches.layout.dual import Mesh, dual_mesh
from tpmscad.patches.layout.net import Net, net_of
from tpmscad.patches.layout.octree import Array, Ints, Mask, Octree
from tpmscad.patches.layout.refine import too_coarse
from tpmscad.patches.layout.relax import relaxed

Progress = Callable[[float], None]

DEGREES = (5, 7, 9)
TURN, USUAL = 1.5, 0.7
"""Size of the first leaves times the curvature that this part of the surface stays below: four leaves to a gyroid's period."""

TRIED = ((1.0, False), (1.25, False), (1.6, False), (1.0, True), (2.0, False))
"""First layouts tried, in leaves per length of the first: uniform, or with leaves split where they hide crossings."""

CONE = 0.5
"""Cosine of the angle that normals in a leaf may make with their mean where octrees are refined."""

DEPTH = 4
"""Greatest refinement of a first leaf: sixteen to one."""

REPAIRS = 2
ROUNDS = 6
SINGULAR = 0.15
"""Slopes below this part of the usual one are named as the cause of a failure."""

JUMP_DEG = 2.0
COSINE = 0.95
"""Least cosine of a patch's normal with the gradient: far from folded."""

PROBE_SIDE = 40
"""Grid lines along the box's longest edge on which curvature is sampled, at least."""

FEW = 0.25
"""Above this share of failing patches a uniform layout is made finer as a whole."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldSolid:
    """A field's solid as a complex, with what was measured on it; lengths in model units, angles in degrees.

    `field` is what was laid out: the one asked for, but for levels moved off the box's corners, which `notes` tell.
    `to_field` and `from_field`: greatest distances from the patches to the level sets and back; `jump_p95_deg` over all joints.
    """

    complex: PatchComplex
    field: Field
    tol: float
    to_field: float
    from_field: float
    rms: float
    cosine: float
    jump_deg: float
    jump_p95_deg: float
    curvature_jump: float
    wall: float
    leaves: int
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """One level set, fitted and measured; `bad` leaves of its tree are too coarse."""

    field: Field
    tree: Octree
    mesh: Mesh
    net: Net
    fit: NetFit
    measured: field_check.Measured
    missed: Array
    bad: Ints
    why: str

    @property
    def doubtful(self) -> float:
        """The volume of the bad leaves: their number grows with every split."""
        return float((self.tree.size[self.bad] ** 3).sum() * np.prod(self.tree.step))

    @property
    def share(self) -> float:
        return len(self.bad) / max(1, len(np.unique(self.net.cell)))


def field_complex(
    field: Field,
    lo: Array,
    hi: Array,
    tol: float,
    *,
    progress: Progress | None = None,
) -> FieldSolid:
    """The solid {field < 0} inside the box [lo, hi], within tol of the field's level set in both directions.

    LayoutError names where the field can't be laid out, and why; InvalidRequest what is wrong with the request. Betti numbers
    and volume are the caller's to compare (`tpmscad.solids`).
    """
    lo, hi = _box(lo, hi)
    if not 0 < tol < (hi - lo).min():
        raise InvalidRequest(f"tol {tol!r} must be above zero and below the box's least edge, {(hi - lo).min():g}")
    done = progress or (lambda share: None)
    parts = tuple(inside(part, lo, hi) for part in layers(field))
    spacing = float((hi - lo).max()) / PROBE_SIDE
    samples = []
    for part in parts:
        if (period := part.periods()) is not None:
            spacing = min(spacing, min(period) / 8)
        samples.append(field_check.samples_of(part, lo, hi, spacing))
    if not any(len(s) for s in samples):
        raise LayoutError("the field has no surface inside the box: check the level and the domain")
    notes: list[str] = []
    parts, samples = _off_corners(parts, samples, lo, hi, tol, spacing, notes)
    shown = rejoined(field, parts)
    wall = check_apart(shown, parts, samples, tol)

    fitted = []
    for i, part in enumerate(parts):
        if len(samples[i]):
            fitted.append(_laid_out(part, lo, hi, tol, samples[i]))
        done((i + 1) / len(parts))
    corners = np.stack(np.meshgrid(*np.stack([lo, hi], axis=1), indexing="ij"), axis=-1)
    corner_solid = shown(corners) <= 0
    complex = assemble([(f.net, f.fit) for f in fitted], [_fixed(f) for f in fitted], lo, hi, corner_solid)
    jump = np.concatenate([f.measured.jump for f in fitted])
    steepest = max(float(f.measured.curvature.max(initial=0.0)) for f in fitted)
    return FieldSolid(
        complex=complex,
        field=shown,
        tol=tol,
        to_field=max(float(f.measured.distance.max()) for f in fitted),
        from_field=max(float(f.missed.max(initial=0.0)) for f in fitted),
        rms=float(np.sqrt(np.mean(np.concatenate([f.measured.square for f in fitted])))),
        cosine=min(float(f.measured.cosine.min()) for f in fitted),
        jump_deg=float(jump.max(initial=0.0)),
        jump_p95_deg=float(np.percentile(jump, 95)) if len(jump) else 0.0,
        curvature_jump=max(float(f.measured.bend.max(initial=0.0)) for f in fitted) / max(steepest, 1e-300),
        wall=wall,
        leaves=sum(len(f.tree.size) for f in fitted),
        notes=tuple(notes),
    )


def _laid_out(field: Field, lo: Array, hi: Array, tol: float, samples: Array) -> _Layer:
    """The coarsest layout of one level set that passes."""
    first = _first_spacing(field, samples)
    best: _Layer | None = None
    for finer, searched in TRIED:
        counts = _counts(field, lo, hi, first / finer)
        tree = octree.uniform(lo, hi, counts)
        if searched:
            tree = _refined(tree, field, None)
            if tree.size.max() == 1:
                continue
        layer = _fitted(field, tree, tol, samples)
        for _ in range(REPAIRS):
            if not len(layer.bad) or layer.share > FEW or tree.size.max() >= 2**DEPTH * tree.size[layer.bad].min():
                break
            tree = octree.split(tree, _mask(len(tree.size), layer.bad))
            layer = _fitted(field, tree, tol, samples)
        if not len(layer.bad):
            return layer
    counts = _counts(field, lo, hi, first)
    tree = _refined(octree.uniform(lo, hi, counts), field, CONE)
    idle = 0
    for _ in range(ROUNDS):
        layer = _fitted(field, tree, tol, samples)
        if not len(layer.bad):
            return layer
        idle = 0 if best is None or layer.doubtful < best.doubtful else idle + 1
        if idle == 0:
            best = layer
        elif idle == 2:
            break
        deep = tree.size[layer.bad] * 2**DEPTH > tree.size.max()
        if not deep.any():
            break
        tree = octree.split(tree, _mask(len(tree.size), layer.bad[deep]))
    assert best is not None
    where = best.tree.points(best.tree.origin[best.bad] + 0.5 * best.tree.size[best.bad][:, None])
    raise LayoutError(_refusal(field, best, where))


def _refusal(field: Field, layer: _Layer, where: Array) -> str:
    gradient = field.gradient(where)
    slope = np.linalg.norm(gradient, axis=1)
    size = layer.tree.size[layer.bad][:, None] * layer.tree.step
    at_box = (where - size < layer.tree.lo) | (where + size > layer.tree.hi)
    level = np.linalg.norm(np.where(at_box, 0.0, gradient), axis=1)
    usual = np.median(np.linalg.norm(field.gradient(layer.net.vertices), axis=1))
    places = ", ".join("(" + ", ".join(f"{x:.4g}" for x in p) + ")" for p in where[np.argsort(slope)][:3])
    if slope.min() < SINGULAR * usual:
        cause = "the field is nearly singular there: change the level, the transition or the minimum neck"
    elif (at_box.any(axis=1) & (level < SINGULAR * usual)).any():
        cause = "the surface touches the box there without crossing it: move the domain or change the level"
    else:
        cause = "the surface turns too fast for the depth allowed: use a looser tol, or a smoother field"
    return f"{len(where)} places could not be fitted within the request ({layer.why}), near {places}; {cause}"


def _fitted(field: Field, tree: Octree, tol: float, samples: Array) -> _Layer:
    """Lay out, relax and fit on a tree; degrees are raised where patches miss, then what still misses names its leaves."""
    mesh = relaxed(dual_mesh(tree, field), field, tree.lo, tree.hi)
    net = net_of(mesh, field)
    twice = _doubled(mesh)
    curve_degree, patch_degree = np.full(len(net.ends), DEGREES[0]), np.full(len(net.curve), DEGREES[0])
    for degree in (*DEGREES[1:], 0):
        fit = fit_net(net, field, curve_degree, patch_degree)
        measured = field_check.measure(net, fit, field)
        folded = measured.cosine < COSINE
        coarse = measured.distance > tol
        steep = np.unique(measured.curve[measured.jump > JUMP_DEG])
        rough = np.isin(net.curve, steep).any(axis=1)
        if degree == 0 or folded.mean() > 0.1 or not (coarse | rough).any():
            break
        patch_degree = np.where(coarse | rough | folded, degree, patch_degree)
        curve_degree[net.curve[coarse | rough | folded].ravel()] = degree
    bad = folded | coarse | rough
    missed = np.zeros(0)
    leaves = np.unique(net.cell[bad])
    why = ", ".join(
        f"{np.count_nonzero(m)} {word}"
        for m, word in ((folded, "folded"), (coarse, "too far off"), (rough, "not smooth"))
        if m.any()
    )
    if not len(leaves):
        missed = field_check.missed(fit, samples, min(tol, 4 * float(measured.distance.max())))
        leaves = np.unique(_leaves_at(tree, samples[missed > tol]))
        why = f"{len(leaves)} parts of the surface missed" if len(leaves) else why
    if len(twice):
        leaves = np.union1d(leaves, twice)
        why = "two edges between the same vertices" + (f", {why}" if why else "")
    return _Layer(field, tree, mesh, net, fit, measured, missed, leaves, why)


def _doubled(mesh: Mesh) -> Ints:
    """Leaves of the ends of sides that join the same two vertices as another, or one with itself."""
    ends = np.sort(mesh.side_ends, axis=1)
    _, index, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    odd = (count[index.ravel()] > 1) | (ends[:, 0] == ends[:, 1])
    return np.unique(mesh.cell[ends[odd]])


def _refined(tree: Octree, field: Field, cosine: float | None) -> Octree:
    for _ in range(DEPTH - 1 if cosine is not None else 2):
        flagged = too_coarse(tree, field, cosine) & (tree.size * 2**DEPTH > tree.size.max())
        if not flagged.any():
            break
        tree = octree.split(tree, flagged)
    return tree


def _first_spacing(field: Field, samples: Array) -> float:
    """The size of leaf for the curvature of most of the surface."""
    step = 1e-3 * float(np.ptp(samples, axis=0).max())
    slope = field.gradient(samples)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    normal = slope / np.maximum(length, 1e-300)
    hessian = np.stack(
        [(field.gradient(samples + step * e) - field.gradient(samples - step * e)) / (2 * step) for e in np.eye(3)], -1
    )
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    bend = across @ hessian @ across / np.maximum(length, 1e-300)[..., None]
    return TURN / float(np.quantile(np.linalg.norm(bend, ord=2, axis=(1, 2)), USUAL))


def _counts(field: Field, lo: Array, hi: Array, size: float) -> Ints:
    """Leaves along each axis, none longer than size; a whole number to a period, so that periods are laid out alike."""
    leaf = np.full(3, size)
    periods = field.periods()
    if periods is not None:
        leaf = np.array(periods) / np.ceil(np.array(periods) / size - 1e-6)
    return np.maximum(2, np.ceil((hi - lo) / leaf - 1e-6)).astype(np.int64)


def _off_corners(
    parts: tuple[Field, ...], samples: list[Array], lo: Array, hi: Array, tol: float, spacing: float, notes: list[str]
) -> tuple[tuple[Field, ...], list[Array]]:
    """Levels moved by at most a tenth of tol where the surface passes through a corner of the box."""
    corners = np.stack(np.meshgrid(*np.stack([lo, hi], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    result, moved = [], []
    for part, points in zip(parts, samples, strict=True):
        value, slope = part.value_and_gradient(corners)
        near = np.abs(value) < 1e-2 * tol * np.linalg.norm(slope, axis=1)
        if near.any() and len(points):
            shift = 0.1 * tol * float(np.linalg.norm(part.gradient(points), axis=1).min())
            where = ", ".join(f"{x:g}" for x in corners[near][0])
            notes.append(f"the surface passes through the box's corner ({where}): its level was moved by {shift:.3g}")
            part = part + shift
            points = field_check.samples_of(part, lo, hi, spacing)
        result.append(part)
        moved.append(points)
    return tuple(result), moved


def _fixed(layer: _Layer) -> Mask:
    fixed = np.zeros((len(layer.net.vertices), 3), bool)
    fixed[: len(layer.mesh.fixed)] = layer.mesh.fixed
    return fixed


def _leaves_at(tree: Octree, points: Array) -> Ints:
    cell = np.clip(((points - tree.lo) / tree.step).astype(int), 0, tree.shape - 1)
    return tree.leaf[tuple(cell.T)].astype(np.int64)


def _mask(count: int, chosen: Ints) -> Mask:
    mask = np.zeros(count, bool)
    mask[chosen] = True
    return mask


def _box(lo: Array, hi: Array) -> tuple[Array, Array]:
    try:
        low, high = np.asarray(lo, float), np.asarray(hi, float)
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"domain ({lo!r}, {hi!r}) must be two points of three numbers") from error
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all() or not np.isfinite([low, high]).all():
        raise InvalidRequest(f"domain ({lo!r}, {hi!r}) must be two points (x, y, z), the first below the second")
    return low, high
