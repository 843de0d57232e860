"""Requests of the standing trial from sampled data: images of a known shape in a stated frame and unit, and a judge of places.

The shape {|q|^2 (1 + k.q) < 1}, q = (p - centre) / axes, has no symmetry. It is a cubic, so that the spline through its samples
reproduces it, and star-shaped about its centre, so that volume, centroid and extents follow from integrals over directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.trial_requests import FILES, Drawn, judge_model
from benchmarks.trial_statements import triangulate

RIGHT_ANTERIOR_SUPERIOR = {"RAS": (1, 1, 1), "LPS": (-1, -1, 1), "LAS": (-1, 1, 1)}
"""x, y and z of a frame of the patient as multiples of right, anterior and superior."""

NRRD_NAMES = {"RAS": "right-anterior-superior", "LPS": "left-posterior-superior", "LAS": "left-anterior-superior"}

UNITS = {"mm": 1.0, "um": 1e-3, "cm": 10.0, "m": 1e3}
"""Millimetres in a unit of a NRRD file."""

NIFTI_UNITS = {"mm": 1.0, "micron": 1e-3, "meter": 1e3}

IDENTITY = np.eye(3)

DIRECTIONS = (240, 480)
"""Polar and azimuthal directions of the integrals."""

EXTENT_STEPS = 20
"""Of the search for the farthest ray, each with steps 0.6 times as long: from 0.013 to 1e-6."""

EXTENT_TOL = 5e-5
"""In diagonals: by how much the farthest ray that is found falls short of an extent; 2e-5 at sharp edges, by 4 million rays."""

MARGIN_CELLS = 4.0
"""Least distance of a shape that is not cut from the outermost samples."""

END_EFFECT_CELLS = 5e-3
"""How far a spline of cell data is from the cubic that it samples, MARGIN_CELLS before its ends, where its slope vanishes: the
slope's error of one spacing falls by 0.27 with each cell."""

CUT_EFFECT_CELLS = 0.342
"""The same at the ends themselves, where a shape is cut: the spline through |x| at half-integers is 0.342 at 0."""

LABEL_BLUR_VOXELS = 0.5
"""Distance of the surface of a label from the true one: any that separates the voxels explains them."""

LABEL_CENTROID_VOXELS = 0.25
"""Offset of the centroid of a label's surface from the true one, along each axis: the errors of some hundred voxels of the
boundary, each below half a voxel, average out; voxels taken for points would be off by 0.5."""


@dataclass(frozen=True)
class Shape:
    """The shape of the trial: centre and half axes (3,), model units, and tilt k (3,)."""

    centre: np.ndarray
    axes: np.ndarray
    tilt: np.ndarray

    def value(self, p: np.ndarray) -> np.ndarray:
        """Values (...) at points (..., 3), negative inside."""
        q = (p - self.centre) / self.axes
        return np.asarray((q * q).sum(-1) * (1 + q @ self.tilt) - 1)

    def place(
        self, low: np.ndarray, high: np.ndarray, turn: np.ndarray = IDENTITY
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Volume, centroid (3,) and box (2, 3) of the part within [low, high], which holds the centre, turned about 0."""
        cosine, weight = np.polynomial.legendre.leggauss(DIRECTIONS[0])
        azimuth = 2 * np.pi * np.arange(DIRECTIONS[1]) / DIRECTIONS[1]
        flat = np.sqrt(1 - cosine**2)[:, None]
        ray = np.stack(
            [
                flat * np.cos(azimuth),
                flat * np.sin(azimuth),
                np.broadcast_to(cosine[:, None], (len(cosine), len(azimuth))),
            ],
            axis=-1,
        )
        solid_angle = np.broadcast_to(weight[:, None] * 2 * np.pi / len(azimuth), ray.shape[:-1])
        reach = self._reach(ray, low, high)
        volume = float((solid_angle * reach**3).sum() / 3)
        first = (solid_angle[..., None] * ray * reach[..., None] ** 4).sum(axis=(0, 1)) / 4
        centroid = turn @ (self.centre + self.axes * first / volume)
        tips = (ray * reach[..., None]).reshape(-1, 3) * self.axes + self.centre
        rays = ray.reshape(-1, 3)
        box = np.array(
            [[self._extent(s * row, rays[(tips @ (s * row)).argmax()], low, high) for row in turn] for s in (-1.0, 1.0)]
        )
        return volume * float(self.axes.prod()), centroid, box * [[-1.0], [1.0]]

    def _reach(self, ray: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """How far (...) the part reaches along unit vectors (..., 3), in half axes."""
        reach, along = np.ones(ray.shape[:-1]), ray @ self.tilt
        for _ in range(30):  # Newton's method: the cubic rises between its start and its root
            reach = reach - (reach**2 * (1 + along * reach) - 1) / (reach * (2 + 3 * along * reach))
        with np.errstate(divide="ignore"):
            walls = np.where(ray > 0, high - self.centre, self.centre - low) / (self.axes * np.abs(ray))
        return np.asarray(np.minimum(reach, walls.min(axis=-1)))

    def _extent(self, along: np.ndarray, ray: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
        """How far the part reaches along a unit vector (3,), near a ray: others about the best one are tried, ever closer ones.

        The farthest point may lie on the edge in which a side cuts the shape, where the steps of rays drawn beforehand show.
        """
        step, best = np.pi / DIRECTIONS[0], -np.inf
        offsets = np.stack(np.meshgrid(*[np.linspace(-2, 2, 5)] * 3), axis=-1).reshape(-1, 3)
        for _ in range(EXTENT_STEPS):
            rays = ray + step * offsets
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            height = (self.centre + self.axes * rays * self._reach(rays, low, high)[:, None]) @ along
            ray, best, step = rays[height.argmax()], max(best, float(height.max())), 0.6 * step
        return best


@dataclass(frozen=True)
class Grid:
    """Samples along x, y and z of a file's frame: their numbers, and in mm their spacing and the position of the first."""

    counts: tuple[int, int, int]
    spacing: np.ndarray
    first: np.ndarray
    of_cells: bool

    @property
    def box(self) -> np.ndarray:
        """Corners (2, 3) of the domain: the outermost samples, or the outer faces of the outermost cells."""
        half = 0.5 * self.of_cells * self.spacing
        return np.array([self.first - half, self.first + (np.array(self.counts) - 1) * self.spacing + half])

    def points(self) -> np.ndarray:
        """Positions (nx, ny, nz, 3)."""
        axes = [a + h * np.arange(n) for a, h, n in zip(self.first, self.spacing, self.counts, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def stored(
        self, values: np.ndarray, order: tuple[int, ...], flips: tuple[bool, ...], unit: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The values with axes `order`, some reversed, and the affine map (4, 4) of their indices to positions in the unit."""
        matrix, at = np.zeros((3, 3)), self.first.copy()
        kept = values.transpose(order)
        for axis, (of, flipped) in enumerate(zip(order, flips, strict=True)):
            matrix[of, axis] = -self.spacing[of] if flipped else self.spacing[of]
            if flipped:
                at[of] += (self.counts[of] - 1) * self.spacing[of]
                kept = np.flip(kept, axis)
        affine = np.eye(4)
        affine[:3, :3], affine[:3, 3] = matrix / unit, at / unit
        return np.ascontiguousarray(kept), affine


def judge_place(
    model: Any,
    place: tuple[float, np.ndarray, np.ndarray],
    blur: float,
    centroid_blur: float | None = None,
    cut_blur: float = 0.0,
) -> list[str]:
    """What the triangles and the box of a solid contradict of the place (volume, centroid, box) of the shape that was sampled.

    blur: how far (model units) the surface asked for may be from the shape's; centroid_blur: the same of the centroid along each
    axis, if less than follows from blur; cut_blur: the same of the edge in which an end of the data cuts the shape.
    """
    volume, centroid, box = place
    c = model.certificate
    deviation = 0.25 * c.tol
    vertices, triangles = triangulate(model.wrapped, deviation)
    x = vertices[triangles] - centroid
    parts = np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6
    found = float(parts.sum())
    shift = (parts[:, None] * x.sum(axis=1)).sum(axis=0) / (4 * found)
    off, lever = c.tol + deviation + blur, float(np.linalg.norm(x, axis=-1).max())
    faults = []
    if abs(found - volume) > off * c.area:
        faults.append(f"volume {found:.6g}, the shape's is {volume:.6g} +- {off * c.area:.2g}")
    allowed = (c.tol + deviation) * c.area * lever / volume + (
        blur * c.area * lever / volume if centroid_blur is None else centroid_blur
    )
    if np.abs(shift).max() > allowed:
        faults.append(
            f"the centroid is {shift.round(6).tolist()} off that of the shape, {centroid.round(6).tolist()} +- {allowed:.2g}"
        )
    stated = np.asarray(model.bounding_box, float)
    if np.abs(stated - box).max() > c.tol + max(blur, cut_blur) + EXTENT_TOL * np.linalg.norm(box[1] - box[0]):
        faults.append(f"the box is {stated.round(6).tolist()}, that of the shape {box.round(6).tolist()}")
    return faults


def judge_frame_note(notes: tuple[str, ...], stated: str, given: str | None) -> list[str]:
    """What the notes of a certificate say wrongly of the frame: `stated` by the file, `given` in the request."""
    said = [note for note in notes if "frame" in note]
    if stated not in RIGHT_ANTERIOR_SUPERIOR:
        return (
            [] if said and not any("converted" in note for note in said) else [f"of an unstated frame is said {said}"]
        )
    target = stated if given == "file" else given or "RAS"
    reversed_axes = [
        a
        for a, one, other in zip("xyz", RIGHT_ANTERIOR_SUPERIOR[stated], RIGHT_ANTERIOR_SUPERIOR[target], strict=True)
        if one != other
    ]
    told = f"{stated} converted to {target}, {' and '.join(reversed_axes)} reversed" if reversed_axes else stated
    right = [note for note in said if told in note and ("converted" in note) == bool(reversed_axes)]
    return [] if right else [f"of the frame is said {said}, it is {told}"]


def write_nrrd(path: Path, values: np.ndarray, affine: np.ndarray, frame: str, unit: str, centring: str) -> None:
    """A raw NRRD file, as its definition has it: the first index runs fastest."""
    vectors = " ".join("(" + ",".join(repr(float(x)) for x in affine[:3, i]) + ")" for i in range(3))
    types = {"float64": "double", "float32": "float", "int16": "short", "uint8": "uchar"}
    lines = [
        "NRRD0005",
        f"type: {types[values.dtype.name]}",
        "dimension: 3",
        f"space: {NRRD_NAMES[frame]}" if frame else "space dimension: 3",
        f"sizes: {' '.join(map(str, values.shape))}",
        f"space directions: {vectors}",
        "endian: little",
        "encoding: raw",
        f"space origin: ({','.join(repr(float(x)) for x in affine[:3, 3])})",
    ]
    lines += [f"centerings: {' '.join([centring] * 3)}"] if centring else []
    lines += ["space units:" + 3 * f' "{unit}"'] if unit else []
    path.write_bytes("\n".join(lines).encode() + b"\n\n" + values.tobytes(order="F"))


def write_nifti(path: Path, values: np.ndarray, affine: np.ndarray, unit: str, by_quaternion: bool) -> None:
    """A NIfTI file with one of its two positions: the matrix, or the rotation."""
    import nibabel

    image = nibabel.Nifti1Image(values, None)
    image.header.set_xyzt_units(unit or "unknown")
    if by_quaternion:
        image.set_qform(affine, 1)
        image.set_sform(None, 0)
    else:
        image.set_sform(affine, 2)
        image.set_qform(None, 0)
    nibabel.save(image, path)


def write_vti(path: Path, values: np.ndarray, affine: np.ndarray, of_cells: bool) -> None:
    """A VTK image as text; `affine` places the samples, the origin of cells is the corner of the first."""
    spacing, first = np.diag(affine)[:3], affine[:3, 3]
    origin = first - 0.5 * spacing if of_cells else first
    last = np.array(values.shape) - (0 if of_cells else 1)
    extent, kind = " ".join(f"0 {n}" for n in last), "CellData" if of_cells else "PointData"
    types = {"float64": "Float64", "float32": "Float32", "int16": "Int16", "uint8": "UInt8"}
    numbers = " ".join(map(repr, values.ravel(order="F").tolist()))
    path.write_text(
        f'<VTKFile type="ImageData" version="0.1" byte_order="LittleEndian"><ImageData WholeExtent="{extent}" '
        f'Origin="{" ".join(map(repr, origin.tolist()))}" Spacing="{" ".join(map(repr, spacing.tolist()))}">'
        f'<Piece Extent="{extent}"><{kind} Scalars="s"><DataArray type="{types[values.dtype.name]}" Name="s" format="ascii">'
        f"{numbers}</DataArray></{kind}></Piece></ImageData></VTKFile>\n"
    )


def draw_image(rng: np.random.Generator) -> Drawn:
    """Grey values or labels of the shape, in an array or a file of one of the formats, solidified in the image's own box."""
    import tpmscad
    from tpmscad import fields
    from tpmscad.recipe.recipe_runs import SolidRun

    suffix = str(rng.choice(["array", ".npy", ".nrrd", ".nrrd", ".nii", ".nii.gz", ".vti"]))
    of_labels = rng.random() < 0.35
    counts = tuple(int(n) for n in rng.integers(20, 27, 3))
    spacing = rng.uniform(0.5, 1.6, 3).round(2)
    first = rng.uniform(-40, 40, 3).round(2)
    stated_cells = bool(rng.random() < 0.5)  # by the file or the argument
    of_cells = of_labels or stated_cells
    grid = Grid(counts, spacing, first, of_cells)  # type: ignore[arg-type]
    span = (np.array(counts) - 1) * spacing
    axes = span * rng.uniform(0.2, 0.25, 3)
    tilt = rng.normal(size=3)
    tilt *= 0.12 / np.linalg.norm(tilt)
    room = MARGIN_CELLS * spacing + 1.1 * axes
    centre = rng.uniform(first + room, first + span - room)
    cut = int(rng.integers(6)) if rng.random() < 0.3 else None
    if cut is not None:  # the end of the image, across x, y or z, cuts the shape
        axis, end = divmod(cut, 2)
        inwards = rng.uniform(0.2, 0.6) * axes[axis]
        centre[axis] = grid.box[end, axis] + (-inwards if end else inwards)
    shape = Shape(centre, axes, tilt)

    # what the file states
    frame, unit, factor, centring = "", "", 1.0, ""
    order, flips = (0, 1, 2), (False, False, False)
    if suffix == ".nrrd":
        frame = str(rng.choice(["RAS", "LPS", "LPS", "LAS", ""]))
        unit = str(rng.choice(["", *UNITS]))
        factor = UNITS.get(unit, 1.0)
        centring = "cell" if stated_cells else "node"
    elif suffix in (".nii", ".nii.gz"):
        frame, unit = "RAS", str(rng.choice(["", *NIFTI_UNITS]))
        factor = NIFTI_UNITS.get(unit, 1.0)
    if frame or suffix == ".nrrd":
        order = tuple(int(i) for i in rng.permutation(3))
        flips = tuple(bool(b) for b in rng.random(3) < 0.5)
    given = [None, "RAS", "LPS", "file"][int(rng.integers(4))] if frame else [None, "file"][int(rng.integers(2))]
    if suffix == "array":
        given = None
    by_quaternion = bool(rng.random() < 0.5)
    turn = IDENTITY
    if (
        suffix in (".nii", ".nii.gz", ".nrrd") and rng.random() < 0.4
    ):  # an oblique scan, turned by less than half a right angle
        turn = Rotation.from_rotvec(rng.uniform(0.05, 0.7) * rng.normal(size=3) / np.sqrt(3)).as_matrix()

    # what the image holds, and what is asked of it
    inside_label, other_label = (int(n) for n in rng.choice([1, 2, 3, 7, 12], 2, replace=False))
    value, options = -shape.value(grid.points()), {}
    if of_labels:
        way = str(rng.choice(["one", "two", "all"]))
        kept = (value > 0) * inside_label
        if way == "one":  # another label beside it
            kept = np.where((value < -1.5) & (grid.points()[..., 0] > centre[0]), other_label, kept)
        else:
            kept = np.where((value > 0) & (grid.points()[..., 1] > centre[1]), other_label, kept)
        values = kept.astype(rng.choice([np.uint8, np.int16]))
        options["label"] = {"one": inside_label, "two": [inside_label, other_label], "all": "all"}[way]
    else:
        level, gain = round(float(rng.uniform(-300, 300)), 1), round(float(rng.uniform(20, 200)), 1)
        if rng.random() < 0.7:
            values, options["level"] = level + gain * value, level
        else:
            values = -gain * value
        if suffix not in (".nrrd", ".vti") or rng.random() < 0.3:
            options["centred"] = stated_cells
    stored, affine = grid.stored(values, order, flips, factor)
    affine[:3] = turn @ affine[:3]
    if given is not None:
        options["frame"] = given
    if suffix in ("array", ".npy"):
        options |= {"spacing": tuple(spacing.tolist()), "origin": tuple(first.tolist())}
    tol = round(0.03 * float(spacing.min()), 4)
    through_run = suffix != "array" and ("level" in options or of_labels) and rng.random() < 0.4

    # where the solid has to be
    target = {None: "RAS", "file": frame}.get(given, given)
    signs = np.multiply(RIGHT_ANTERIOR_SUPERIOR[frame], RIGHT_ANTERIOR_SUPERIOR[target]) if frame else np.ones(3)
    expected = shape.place(*grid.box, turn)
    place = expected[0], signs * expected[1], np.sort(signs * expected[2], axis=0)
    domain = np.sort(signs * grid.box, axis=0)
    cell = float(spacing.max())

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        path = folder / f"image{suffix}"
        source: Any = values if suffix == "array" else path
        if suffix == ".npy":
            np.save(path, stored)
        elif suffix == ".nrrd":
            write_nrrd(path, stored, affine, frame, unit, centring)
        elif suffix == ".vti":
            write_vti(path, stored, affine, of_cells)
        elif suffix != "array":
            write_nifti(path, stored, affine, unit, by_quaternion)
        if through_run:
            model, _ = SolidRun.sample(path, **options, tol=tol).make(None)
        else:
            field = (fields.labels if of_labels else fields.sampled)(source, **options)
            model = tpmscad.solidify(field, field.domain, tol=tol, progress=False)
        stated = {"envelope": float(np.ptp(domain, axis=0).prod()), "box": domain} if turn is IDENTITY else {}
        met, why, judge = judge_model(model, folder, None, rng, **stated)

        def judge_all() -> list[str]:
            faults = judge()
            if suffix != "array":
                faults += judge_frame_note(model.certificate.notes, frame, given)
            if of_labels:
                return faults + judge_place(model, place, LABEL_BLUR_VOXELS * cell, LABEL_CENTROID_VOXELS * cell)
            if not of_cells:
                return faults + judge_place(model, place, 0.0)
            cut_blur = 0.0 if cut is None else CUT_EFFECT_CELLS * float(spacing[cut // 2])
            return faults + judge_place(model, place, END_EFFECT_CELLS * cell, None, cut_blur)

        return met, why, judge_all

    said = f"{'cells' if of_cells else 'points'}, frame {frame or 'none'}, unit {unit or 'none'}, axes {order} {flips}"
    said += f", turned by {Rotation.from_matrix(turn).as_rotvec().round(3).tolist()}"
    asked = ", ".join(f"{k}={v!r}" for k, v in options.items())
    call = "SolidRun.sample" if through_run else "fields.labels" if of_labels else "fields.sampled"
    ends = "whole" if cut is None else f"cut at side {cut}"
    text = f"{call}(image{suffix} of {counts} {said}, {asked}), tol={tol}, {ends}"
    return Drawn(text, make, FILES | {f"image{suffix}"})
