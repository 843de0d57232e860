"""Requests of the standing trial that combine two capabilities: struts that are moved and cut, meshes of several shells, boxes of
whole periods in decimals.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.trial_judges import NodalFunction, Region
from benchmarks.trial_requests import FILES, Drawn, judge_model
from tpmscad.catalogue import CATALOGUE


def distance_to_segments(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distances (n,) of points (n, 3) from the nearest of segments (m, 2, 3)."""
    least = np.full(len(points), np.inf)
    for start, end in ends:
        along = end - start
        t = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(points - start - t[:, None] * along, axis=1))
    return least


def draw_struts(rng: np.random.Generator) -> Drawn:
    """A star of struts turned, scaled and shifted, as it is, complemented, or combined with a box or a ball."""
    import tpmscad
    from tpmscad import fields

    count = int(rng.integers(2, 6))
    nodes = np.vstack([np.zeros(3), rng.normal(size=(count, 3))])
    nodes[1:] *= (rng.uniform(4, 7, count) / np.linalg.norm(nodes[1:], axis=1))[:, None]
    nodes = nodes.round(2)
    diameter = round(float(rng.uniform(0.8, 1.8)), 2)
    turn, factor = rng.normal(size=3).round(2), round(float(rng.uniform(0.6, 1.2)), 2)
    degrees, shift = round(float(rng.uniform(0, 90)), 1), rng.uniform(-1, 1, 3).round(2)
    way = str(rng.choice(["alone", "complement", "from a box", "in a ball", "with a ball"]))
    half = round(float(rng.uniform(3.5, 5)), 2)
    rotation = Rotation.from_rotvec(np.radians(degrees) * turn / np.linalg.norm(turn)).as_matrix()
    moved = factor * nodes @ rotation.T + shift
    ends, radius = np.stack([np.broadcast_to(moved[0], (count, 3)), moved[1:]], axis=1), 0.5 * factor * diameter
    low, high = (
        (np.full(3, -half), np.full(3, half)) if way != "alone" else (moved.min(axis=0) - 2, moved.max(axis=0) + 2)
    )
    tol = round(float(10 ** rng.uniform(-2, -1.3)), 4)

    def inside(p: np.ndarray) -> np.ndarray:
        struts = distance_to_segments(p, ends) < radius
        ball = np.linalg.norm(p, axis=-1) < 0.7 * half
        box = (np.abs(p) < half - 0.5).all(axis=-1)
        return {  # type: ignore[no-any-return]
            "alone": struts,
            "complement": ~struts,
            "from a box": box & ~struts,
            "in a ball": ball & struts,
            "with a ball": ball | struts,
        }[way]

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        field = fields.struts(nodes, [[0, k + 1] for k in range(count)], diameter)
        field = fields.translate(fields.scale(fields.rotate(field, tuple(turn), degrees), factor), tuple(shift))
        ball = fields.sphere((0, 0, 0), 0.7 * half)
        box = fields.box((-half + 0.5,) * 3, (half - 0.5,) * 3)
        whole = {
            "alone": field,
            "complement": fields.complement(field),
            "from a box": fields.difference(box, field),
            "in a ball": fields.intersection(ball, field),
            "with a ball": fields.union(ball, field),
        }[way]
        model = tpmscad.solidify(whole, (tuple(low), tuple(high)), tol=tol, progress=False)
        return judge_model(model, folder, Region(inside, low, high), rng)

    text = (
        f"tpmscad.solidify({way}, struts({nodes.tolist()}, {diameter}) rotated by {turn.tolist()}, {degrees}, "
        f"scaled by {factor}, shifted by {shift.tolist()}, in +-{half}, tol={tol})"
    )
    return Drawn(text, make, FILES)


def draw_shells(rng: np.random.Generator) -> Drawn:
    """Balls of triangles in one mesh: apart, overlapping, nested in either direction; filled, with or without a skin."""
    import trimesh

    import tpmscad

    balls = [(np.zeros(3), 6.0)]
    way = str(rng.choice(["overlapping", "nested", "cavity", "apart", "twice"]))
    offset = rng.normal(size=3)
    offset /= np.linalg.norm(offset)
    radius = {"overlapping": 4.5, "nested": 3.0, "cavity": 2.5, "apart": 4.0, "twice": 6.0}[way]
    away = {"overlapping": 4.0, "nested": 1.5, "cavity": 1.0, "apart": 12.0, "twice": 0.0}[way]
    balls.append(((away * offset).round(3), radius))
    skin = round(float(rng.uniform(0.6, 1.2)), 2) if rng.random() < 0.5 else None
    options: dict[str, Any] = {"cell": 6, "thickness": 0.7, "tol": 0.06} | ({"skin": skin} if skin else {})

    def depth(p: np.ndarray) -> np.ndarray:
        """A lower bound of the depth below the outer boundary, exact but where balls overlap."""
        outer, inner = (r - np.linalg.norm(p - c, axis=-1) for c, r in balls)
        return np.minimum(outer, -inner) if way == "cavity" else np.maximum(outer, inner)

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        parts = []
        for number, (centre, r) in enumerate(balls):
            part = trimesh.creation.icosphere(4, r)
            part.apply_translation(centre)
            if way == "cavity" and number:
                part.invert()
            parts.append(part)
        trimesh.util.concatenate(parts).export(folder / "body.stl")
        model = tpmscad.infill(folder / "body.stl", "gyroid", **options, progress=False)
        wall = NodalFunction(CATALOGUE["gyroid"].formula, (6.0,) * 3, (0, 0, 0))

        def inside(p: np.ndarray) -> np.ndarray:
            value, slope = wall.jet(p)
            in_wall = np.abs(value) < 0.35 * np.linalg.norm(slope, axis=-1)
            at = depth(p)
            return (at > 0) & (in_wall | (at < (skin or 0.0)))  # type: ignore[no-any-return]

        low = np.min([c - r for c, r in balls], axis=0)
        high = np.max([c + r for c, r in balls], axis=0)
        met, why, judge = judge_model(model, folder, None, rng)

        def judge_all() -> list[str]:
            faults = judge()
            c = model.certificate
            expected, error = Region(inside, low, high, 0.02).volume(c.area)
            error += (
                0.012 * expected * (2.0 if skin and way == "overlapping" else 1.0)
            )  # first order of the wall; a rounded crease
            if abs(c.volume + sum(c.dropped) - expected) > error:
                faults.append(f"volume {c.volume:.6g}, the sample says {expected:.6g} +- {error:.2g}")
            return faults

        return met, why, judge_all

    text = f"tpmscad.infill(STL of balls {[(c.tolist(), r) for c, r in balls]}, {way}, 'gyroid', {options})"
    return Drawn(text, make, FILES | {"body.stl"})


def draw_decimals(rng: np.random.Generator) -> Drawn:
    """A field of a decimal period in a slab of whole periods, which has the volume of as many single ones."""
    import tpmscad
    from tpmscad import fields

    name = str(rng.choice(["gyroid", "diamond", "schwarz_p"]))
    period = round(float(rng.uniform(1, 12)), int(rng.integers(1, 4)))
    n, first, axis = int(rng.integers(2, 10)), int(rng.integers(-3, 4)), int(rng.integers(3))
    as_decimal = bool(rng.random() < 0.5)
    kind = str(rng.choice(["rod", "sheet", "wall"]))
    level = round(float(rng.uniform(-0.3, 0.3)), 2)
    tol = round(period * 0.02, 4)

    def box_of(count: int) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.zeros(3), np.full(3, 0.5 * period)
        low[axis], high[axis] = first * period, (first + count) * period
        return (low.round(3), high.round(3)) if as_decimal else (low, high)

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        phi = fields.tpms(name, period)
        field = {
            "rod": lambda: fields.rod(phi, level),
            "sheet": lambda: fields.sheet(phi, level - 0.3, level + 0.3),
            "wall": lambda: fields.wall(phi, 0.12 * period),
        }[kind]()
        low, high = box_of(n)
        many, one = (
            tpmscad.solidify(field, (tuple(lo), tuple(hi)), tol=tol, loose="keep", progress=False)
            for lo, hi in ((low, high), box_of(1))
        )
        met, why, judge = judge_model(many, folder, None, rng, envelope=float((high - low).prod()))

        def judge_all() -> list[str]:
            faults = judge()
            if abs(many.volume - n * one.volume) > 2 * tol * many.area + 1e-9 * many.volume:
                faults.append(f"{n} periods have volume {many.volume:.9g}, one {one.volume:.9g}")
            return faults

        return met, why, judge_all

    low, high = box_of(n)
    text = f"tpmscad.solidify({kind} of {name!r}, {period}, {level}, {low.tolist()} to {high.tolist()}, tol={tol})"
    return Drawn(text, make, FILES)
