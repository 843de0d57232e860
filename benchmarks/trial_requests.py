"""Random requests of the standing trial: what is asked, how it is made, and how it is judged independently.

Each function draws one request of a kind from a generator. The text is the Python that asks the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import generate_binary_structure, label

from benchmarks.trial_judges import (
    MINIMAL_OFF,
    NodalFunction,
    Region,
    gmsh_volume,
    judge_solid,
    judge_step_text,
    judge_stl,
    signed_distance,
)
from benchmarks.trial_statements import judge_statements
from tpmscad.catalogue import CATALOGUE

MAX_FACES_FOR_GMSH = 700
GMSH_SHARE = 0.3
CELL_SIZES = (0.5, 2.0, 5.0, 8.0, 10.0, 10.0, 12.5, 25.0, 100.0)


@dataclass(frozen=True)
class Drawn:
    """`make(folder)` gives (met, why not, judge), where `judge()` names faults; it raises whatever the package raises."""

    text: str
    make: Callable[[Path], tuple[bool, str, Callable[[], list[str]]]]
    files: frozenset[str] = frozenset()


def written(call: str, options: dict[str, Any]) -> str:
    return f"{call}{', ' if options else ''}{', '.join(f'{k}={v!r}' for k, v in options.items())})"


def _triple(rng: np.random.Generator, low: float, high: float, digits: int = 3) -> tuple[float, float, float]:
    x, y, z = (round(float(v), digits) for v in rng.uniform(low, high, 3))
    return x, y, z


def judge_model(
    model: Any,
    folder: Path,
    region: Region | None,
    rng: np.random.Generator,
    *,
    wall: float | None = None,
    envelope: float | None = None,
    body: Any = None,
    box: np.ndarray | None = None,
) -> tuple[bool, str, Callable[[], list[str]]]:
    """Export a model that meets its request to STEP and STL, and judge it, its file, its mesh and what is stated of it.

    The keywords are those of `judge_statements`.
    """
    c = model.certificate
    if not c.met:
        return False, "; ".join(c.shortfalls), list
    model.export_step(folder / "made.step")
    with_gmsh = c.n_faces <= MAX_FACES_FOR_GMSH and rng.random() < GMSH_SHARE
    if with_gmsh:
        model.export(folder / "made.stl", deviation=max(c.tol, 2e-3 * c.volume / c.area))

    def judge() -> list[str]:
        faults = (
            [] if c.valid and c.closed and c.max_deviation <= c.tol else ["met, but not valid, closed and within tol"]
        )
        faults += judge_step_text(folder / "made.step", c.betti[0], c.n_faces)
        if with_gmsh:
            found = gmsh_volume(folder / "made.step")
            if abs(found - c.volume) > 1e-4 * c.volume:
                faults.append(f"gmsh reads volume {found:.9g}, the certificate says {c.volume:.9g}")
            faults += judge_stl(folder / "made.stl", c.volume, max(c.tol, 2e-3 * c.volume / c.area), c.area)
        if region is not None:
            faults += judge_solid(region, c.volume, c.area, c.betti[0], c.dropped)
        stated = {"wall": wall, "envelope": envelope, "body": body, "box": box}
        return faults + judge_statements(model, folder / "made.step", **stated)

    return True, "", judge


FILES = frozenset({"made.step", "made.stl"})


def _wall(rng: np.random.Generator, name: str, cell: float) -> dict[str, Any]:
    """The options of a wall that is often possible."""
    if rng.random() < 0.2:
        return {"kind": "skeletal", "side": str(rng.choice(["-", "+"]))} | (
            {"offset": round(float(rng.uniform(-0.03, 0.03)) * cell, 4)} if rng.random() < 0.5 else {}
        )
    way = rng.random()
    if way < 0.6:
        return {"thickness": round(float(rng.uniform(0.02, 0.1 if name not in ("frd", "octo") else 0.06)) * cell, 4)}
    if way < 0.8:
        low, high = sorted(rng.uniform(-0.06, 0.06, 2).tolist())
        return {"offset": (round(low * cell, 4), round(high * cell, 4))}
    return {"volume_fraction": round(float(rng.uniform(0.08, 0.35)), 3)}


def _limits(options: dict[str, Any]) -> tuple[float, float] | None:
    """Signed distances between which the solid lies; None if they have to be solved for."""
    if options.get("kind") == "skeletal":
        at = options.get("offset", 0.0)
        return (-np.inf, at) if options["side"] == "-" else (at, np.inf)
    if "thickness" in options:
        return -0.5 * options["thickness"], 0.5 * options["thickness"]
    return options.get("offset")


def around(f: Callable[..., Any], limits: tuple[float, float], size: float) -> Callable[[np.ndarray], np.ndarray]:
    reach = max(abs(v) for v in limits if np.isfinite(v)) or 1e-3 * size

    def inside(p: np.ndarray) -> np.ndarray:
        d = signed_distance(f, p, reach, size)
        return (d > limits[0]) & (d < limits[1])

    return inside


def draw_lattice(rng: np.random.Generator) -> Drawn:
    import tpmscad

    name = str(rng.choice(list(CATALOGUE)))
    cell = float(rng.choice(CELL_SIZES))
    cells = tuple(int(n) for n in rng.choice([1, 1, 1, 2], 3))
    options: dict[str, Any] = {"cell": cell, "cells": cells} | _wall(rng, name, cell)
    if rng.random() < 0.3:
        options["cell"] = tuple(round(cell * float(s), 4) for s in rng.uniform(0.8, 1.25, 3))
    if rng.random() < 0.3:
        options["reference"] = str(rng.choice(["minimal", "nodal"]))
    if rng.random() < 0.4:
        options["phase"] = _triple(rng, -1, 1)
    if rng.random() < 0.15:
        options["boundary"] = "natural"
    options["tol"] = round(cell * float(10 ** rng.uniform(-3, -1.8)), 7)
    info = CATALOGUE[name]
    limits, edges = _limits(options), np.broadcast_to(np.asarray(options["cell"], float), 3)
    exact = options.get("reference", info.references[0]) == "minimal"
    phase = options.get("phase")

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        model = tpmscad.lattice(name, **options, progress=False)
        region = None
        if limits is not None and options.get("boundary") != "natural":
            kind, side = options.get("kind", "sheet"), options.get("side", "-")
            shift = info.one_piece.phase_of(kind, side) if phase is None else phase
            f = NodalFunction(info.formula, edges, shift)
            smear = (
                MINIMAL_OFF[name] * cell * 1.3 * (0.2 if options.get("kind") != "skeletal" else 1.0) if exact else 0.0
            )
            region = Region(around(f, limits, float(edges.min())), np.zeros(3), edges * cells, smear)
        stated: dict[str, Any] = {"wall": options.get("thickness"), "envelope": float(np.prod(edges * cells))}
        if options.get("boundary") != "natural":
            stated["box"] = np.array([np.zeros(3), edges * cells])
        return judge_model(model, folder, region, rng, **stated)

    return Drawn(written(f"tpmscad.lattice({name!r}, ", options).replace("(, ", "(").replace(", , ", ", "), make, FILES)


def draw_map(rng: np.random.Generator) -> Drawn:
    import tpmscad
    from tpmscad import maps

    name = str(rng.choice(["gyroid", "diamond", "schwarz_p"]))
    cell = float(rng.choice([2.0, 10.0]))
    cells = tuple(int(n) for n in rng.choice([1, 2, 3], 3, p=[0.6, 0.3, 0.1]))
    thickness = round(float(rng.uniform(0.03, 0.09)) * cell, 4)
    options: dict[str, Any] = {
        "cell": cell,
        "cells": cells,
        "thickness": thickness,
        "tol": round(cell * float(10 ** rng.uniform(-2.3, -1.6)), 6),
        "boundary": str(rng.choice(["natural", "box"])),
    }
    phase = (0.0, 0.0, 0.0)
    which = int(rng.integers(4))
    if which == 0:
        factors = _triple(rng, 0.7, 1.4)
        text, map_ = f"maps.stretching({factors})", maps.stretching(factors)
        inverse: Callable[[np.ndarray], np.ndarray] = lambda p: p / np.array(factors)  # noqa: E731
    elif which == 1:
        turns = float(rng.choice([0.3, 0.6, 0.9, 1.0, 1.3]))
        radius = cells[0] * cell / (2 * np.pi * turns)
        text, map_ = f"maps.cylinder({radius!r})", maps.cylinder(radius)
        inverse = lambda p: np.stack([radius * np.arctan2(p[..., 0], p[..., 1]) % (2 * np.pi * radius), np.hypot(p[..., 0], p[..., 1]) - radius, p[..., 2]], -1)  # noqa: E731,E501  # fmt: skip
    elif which == 2:
        amount = round(float(rng.choice([0.05, 0.15, 0.4, 1.0])) * float(rng.choice([-1, 1])), 3)
        text = f"lambda p: p + {amount!r} * {cell!r} * np.stack([np.sin(p[..., 1] / {cell!r}), 0 * p[..., 0], 0 * p[..., 0]], -1)"
        map_ = lambda p: p + amount * cell * np.stack([np.sin(p[..., 1] / cell), 0 * p[..., 0], 0 * p[..., 0]], -1)  # noqa: E731
        inverse = lambda p: p - amount * cell * np.stack([np.sin(p[..., 1] / cell), 0 * p[..., 0], 0 * p[..., 0]], -1)  # noqa: E731
        options["boundary"] = "natural"
    else:
        ends = round(float(rng.uniform(0.7, 1.0)), 3), round(float(rng.uniform(1.0, 1.4)), 3)
        text = f"maps.grading(2, {ends}, {cells[2] * cell!r})"
        map_, inverse = maps.grading(2, ends, cells[2] * cell), None  # type: ignore[assignment]
    info = CATALOGUE[name]

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        model = tpmscad.lattice(name, **options, map=map_, progress=False)
        met, why, judge = judge_model(model, folder, None, rng)
        if not met or inverse is None:
            return met, why, judge

        def judge_all() -> list[str]:
            f = NodalFunction(info.formula, (cell,) * 3, phase)
            low, high = (np.asarray(c) for c in model.bounding_box)
            extent = np.array(cells) * cell

            def in_cells(p: np.ndarray) -> np.ndarray:
                x = inverse(p)
                return ((x > 0) & (x < extent)).all(axis=-1)

            wall = around(lambda p: f(inverse(p)), (-0.5 * thickness, 0.5 * thickness), cell)
            region = Region(lambda p: wall(p) & in_cells(p), low, high, MINIMAL_OFF[name] * cell)
            c = model.certificate
            faults = judge()
            if options["boundary"] == "box":  # whole patches reach beyond the cells
                expected, error = region.volume(c.area)
                if abs(c.volume + sum(c.dropped) - expected) > error + 0.01 * expected:
                    faults.append(f"volume {c.volume:.6g}, the sample says {expected:.6g} +- {error:.2g}")
            return faults

        return True, "", judge_all

    return Drawn(written(f"tpmscad.lattice({name!r}, map={text}, ", options).replace(", , ", ", "), make, FILES)


def draw_body(rng: np.random.Generator) -> tuple[str, Any, Callable[[np.ndarray], np.ndarray], np.ndarray, np.ndarray]:
    """The text, shape, inside test and box of a simple body."""
    import build123d as bd

    which = int(rng.integers(4))
    x, y, z = _triple(rng, -6, 6, 2)
    at, c = f"bd.Pos({x}, {y}, {z}) * ", np.array([x, y, z])
    if which == 0:
        a, b, h = _triple(rng, 11, 18, 2)
        half = 0.5 * np.array([a, b, h])
        return f"{at}bd.Box({a}, {b}, {h})", bd.Pos(x, y, z) * bd.Box(a, b, h), lambda p: (np.abs(p - c) < half).all(-1), c - half, c + half  # noqa: E501  # fmt: skip
    r, h = round(float(rng.uniform(6, 9)), 2), round(float(rng.uniform(11, 16)), 2)
    if which == 1:
        half = np.array([r, r, 0.5 * h])
        return f"{at}bd.Cylinder({r}, {h})", bd.Pos(x, y, z) * bd.Cylinder(r, h), lambda p: (np.hypot(p[..., 0] - x, p[..., 1] - y) < r) & (np.abs(p[..., 2] - z) < 0.5 * h), c - half, c + half  # noqa: E501  # fmt: skip
    if which == 2:
        return (
            f"{at}bd.Sphere({r})",
            bd.Pos(x, y, z) * bd.Sphere(r),
            lambda p: np.linalg.norm(p - c, axis=-1) < r,
            c - r,
            c + r,
        )
    half = np.array([9.0, 7.0, 6.0])
    bore = round(float(rng.uniform(1.5, 3)), 2)
    shape = bd.Pos(x, y, z) * (
        bd.Box(18, 14, 12) - bd.Pos(4, 0, 4) * bd.Box(12, 16, 8) - bd.Pos(-5, 0, 0) * bd.Cylinder(bore, 20)
    )

    def inside(p: np.ndarray) -> np.ndarray:
        q = p - c
        pocket = (q[..., 0] > -2) & (q[..., 2] > 0)
        return (np.abs(q) < half).all(-1) & ~pocket & (np.hypot(q[..., 0] + 5, q[..., 1]) > bore)

    text = (
        f"{at}(bd.Box(18, 14, 12) - bd.Pos(4, 0, 4) * bd.Box(12, 16, 8) - bd.Pos(-5, 0, 0) * bd.Cylinder({bore}, 20))"
    )
    return text, shape, inside, c - half, c + half


def draw_infill_options(rng: np.random.Generator) -> tuple[str, dict[str, Any]]:
    name = str(rng.choice(list(CATALOGUE), p=np.array([5, 4, 5, 2, 1, 1, 1, 1, 1, 1]) / 22))
    cell = float(rng.choice([7.0, 9.0, 10.0]))
    options: dict[str, Any] = {
        "cell": cell,
        "thickness": round(float(rng.uniform(0.05, 0.09 if name != "frd" else 0.06)) * cell, 3),
    }
    if rng.random() < 0.5:
        options["phase"] = _triple(rng, -1, 1)
    options["tol"] = round(float(10 ** rng.uniform(-1.6, -0.8)), 4)
    return name, options


def draw_infill(rng: np.random.Generator) -> Drawn:
    import tpmscad

    body_text, body, in_body, low, high = draw_body(rng)
    name, options = draw_infill_options(rng)
    if rng.random() < 0.25:
        options["skin"] = round(float(rng.uniform(0.4, 1.5)), 2)
    info = CATALOGUE[name]
    cell, half = options["cell"], 0.5 * options["thickness"]

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        model = tpmscad.infill(body, name, **options, progress=False)
        region = None
        if "skin" not in options:
            wall = around(
                NodalFunction(info.formula, (cell,) * 3, options.get("phase", (0, 0, 0))), (-half, half), cell
            )
            smear = 0.2 * MINIMAL_OFF.get(name, 0.0) * cell
            region = Region(lambda p: in_body(p) & wall(p), low, high, smear)
        return judge_model(model, folder, region, rng, wall=options["thickness"], envelope=body.volume, body=body)

    return Drawn(written(f"tpmscad.infill({body_text}, {name!r}, ", options).replace(", , ", ", "), make, FILES)


def draw_domains(rng: np.random.Generator) -> Drawn:
    import tpmscad

    body_text, body, in_body, low, high = draw_body(rng)
    name, options = draw_infill_options(rng)
    info = CATALOGUE[name]
    cell, half = options["cell"], 0.5 * options["thickness"]

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        found = tpmscad.fluid_domains(body, name, **options, progress=False)
        if not found.certificate.met:
            return False, "; ".join(found.certificate.shortfalls), list
        found.export_step(folder / "made.step")

        def judge() -> list[str]:
            f = NodalFunction(info.formula, (cell,) * 3, options.get("phase", info.one_piece.phase_of()))
            smear = MINIMAL_OFF.get(name, 0.0) * cell
            faults = []
            total = sum(m.volume for m in found.domains.values())
            if abs(total - body.volume) > 1e-5 * body.volume:
                faults.append(f"the domains fill {total:.8g} of {body.volume:.8g}")
            for model, limits in (
                (found.wall, (-half, half)),
                (found.plus, (half, np.inf)),
                (found.minus, (-np.inf, -half)),
            ):
                part = around(f, limits, cell)
                region = Region(lambda p, part=part: in_body(p) & part(p), low, high, smear)
                c = model.certificate
                expected, error = region.volume(c.area)
                if abs(c.volume - expected) > error + 1e-3 * expected:
                    faults.append(f"{model.name}: volume {c.volume:.6g}, the sample says {expected:.6g} +- {error:.2g}")
            return faults

        return True, "", judge

    return Drawn(written(f"tpmscad.fluid_domains({body_text}, {name!r}, ", options).replace(", , ", ", "), make, FILES)


def _field(rng: np.random.Generator) -> tuple[str, str, Callable[[np.ndarray], np.ndarray]]:
    """Python text and recipe tables of a field, and its values by formulas of the trial's own."""
    name = str(rng.choice(list(CATALOGUE)))
    period = float(rng.choice([8.0, 10.0, 12.0]))
    f = NodalFunction(CATALOGUE[name].formula, (period,) * 3, (0, 0, 0))
    spread = float(np.std(f(np.random.default_rng(0).random((4000, 3)) * period)))
    kind = str(rng.choice(["rod", "pore", "sheet", "graded"]))
    at = round(float(rng.uniform(-0.5, 0.5)) * spread, 3)
    width = round(float(rng.uniform(0.25, 0.8)) * spread, 3)
    base = f"fields.tpms({name!r}, {period})"
    head = f'surface = "{name}"\nperiod = {period}\n'
    if kind in ("rod", "pore"):
        sign = 1.0 if kind == "rod" else -1.0
        recipe = f'[field]\nkind = "{kind}"\n{head}level = {at}\n'
        return f"fields.{kind}({base}, {at})", recipe, lambda p: sign * (f(p) - at)
    if kind == "sheet":
        recipe = f'[field]\nkind = "sheet"\n{head}levels = [{at - width}, {at + width}]\n'
        return f"fields.sheet({base}, {at - width}, {at + width})", recipe, lambda p: np.abs(f(p) - at) - width
    ends = round(0.4 * width, 3), round(width, 3)
    text = f"fields.rod({base}, fields.ramp('z', (0, 10), {ends}, smooth=False))"
    recipe = f'[field]\nkind = "rod"\n{head}level = "growth"\n[fields.growth]\nkind = "ramp"\nby = "z"\nspan = [0, 10]\nvalues = {list(ends)}\nsmooth = false\n'  # noqa: E501
    return text, recipe, lambda p: f(p) - (ends[0] + (ends[1] - ends[0]) * np.clip(p[..., 2] / 10, 0, 1))


def draw_field(rng: np.random.Generator) -> Drawn:
    import tpmscad
    from tpmscad import fields

    text, _, value = _field(rng)
    high = np.array([float(v) for v in rng.choice([6.0, 9.3, 10.0, 12.0], 3)])
    tol = round(float(10 ** rng.uniform(-2, -1)), 4)

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        model = tpmscad.solidify(eval(text, {"fields": fields}), ((0, 0, 0), tuple(high)), tol=tol, progress=False)
        region = Region(lambda p: value(p) < 0, np.zeros(3), high)
        return judge_model(model, folder, region, rng, envelope=float(high.prod()), box=np.array([np.zeros(3), high]))

    return Drawn(f"tpmscad.solidify({text}, ((0, 0, 0), {tuple(high.tolist())}), tol={tol})", make, FILES)


def draw_recipe(rng: np.random.Generator) -> Drawn:
    from tpmscad.recipe.recipe_runs import SolidRun

    _, recipe, value = _field(rng)
    high = [float(v) for v in rng.choice([6.0, 9.3, 10.0], 3)]
    text = f"tol = {round(float(10 ** rng.uniform(-1.7, -1)), 4)}\ndomain = [[0, 0, 0], {high}]\n{recipe}"
    broken = rng.random() < 0.6
    if broken:
        for _ in range(int(rng.integers(1, 4))):
            at, way = int(rng.integers(len(text))), int(rng.integers(5))
            extra = str(
                rng.choice(['"', "[", "=", "nan", "1e999", "-", "\n", "true", "{}", "é", "0" * 40, "\x00", "'" * 3])
            )
            text = (text[:at] + text[at + 1 :], text[:at] + extra + text[at:], text[:at] + extra, text.replace(*_swap(text, rng)), text + text[: at // 2])[way]  # noqa: E501  # fmt: skip

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        path = folder / "request.toml"
        path.write_text(text, encoding="utf-8")
        run = SolidRun.read(path)
        if broken:
            run.describe()
            return True, "", list
        model, _ = run.make(None)
        return judge_model(model, folder, Region(lambda p: value(p) < 0, np.zeros(3), np.array(high)), rng)

    return Drawn(f"SolidRun.read(recipe of {text!r})", make, FILES | {"request.toml"})


def _swap(text: str, rng: np.random.Generator) -> tuple[str, str]:
    words = text.split()
    old, new = (str(w) for w in rng.choice(words, 2))
    return old, new


def draw_blend(rng: np.random.Generator) -> Drawn:
    import tpmscad
    from benchmarks.random_pairs import random_pair

    seed = int(rng.integers(10**6))
    size = int(rng.choice([24, 32, 40]))

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        pair = random_pair(seed)
        side = [b - a for a, b in zip(pair.regions[0].lo, pair.regions[0].hi, strict=True)]
        shape = (size, *(max(8, round(size * s)) for s in side[1:]))
        result = tpmscad.blend(pair.structures, pair.regions, [pair.blending], resolution=shape)
        if not result.converged:
            return False, result.message, list

        def judge() -> list[str]:
            faults = []
            low, high = (np.array(c) for c in result.domain)
            for shape in result.errors.resolutions:
                axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, shape, strict=True)]
                points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
                values = result.field(points)
                inputs = [np.asarray(s(points)) for s in pair.structures]
                found = _defects(values)
                own = max(sum(d) for d in zip(*(_defects(v) for v in inputs), strict=True))
                index = result.errors.resolutions.index(shape)
                said = result.errors.n0.final[index], result.errors.n2.final[index]
                if found != said:
                    faults.append(f"{found} isolated components and cavities at {shape}, said {said} (inputs {own})")
                outside = pair.blending(points) > 1e-9
                region = (pair.regions[1](points) < pair.regions[0](points))[outside]
                if not np.array_equal(values[outside], np.where(region, inputs[1][outside], inputs[0][outside])):
                    faults.append("the field differs from its inputs outside the blending region")
            return faults

        return True, "", judge

    return Drawn(f"blend of random_pair({seed}) at {size} samples along x", make)


def _defects(values: np.ndarray) -> tuple[int, int]:
    """Solid components besides the largest one, and void components that do not reach the border, by faces."""
    faces = generate_binary_structure(3, 1)
    _, solid = label(values <= 0, faces)
    void, count = label(values > 0, faces)
    border = {int(v) for axis in range(3) for end in (0, -1) for v in np.unique(np.take(void, end, axis))} - {0}
    return max(solid - 1, 0), count - len(border)


ODD = (
    None,
    True,
    0,
    -1,
    math.nan,
    math.inf,
    1e-300,
    1e300,
    "10",
    b"10",
    1j,
    (),
    (1, 2),
    [1, 2, 3],
    {},
    (math.nan,) * 3,
    object,
)


def draw_malformed(rng: np.random.Generator) -> Drawn:
    import build123d as bd

    import tpmscad
    from tpmscad import fields

    if rng.random() < 0.5:
        call = str(rng.choice(["lattice", "infill", "fluid_domains", "solidify", "blend"]))
        good: dict[str, Any] = {"cell": 10.0, "thickness": 1.0, "tol": 0.3, "phase": (0.1, 0.2, 0.3)}
        if call == "lattice":
            good |= {"cells": 1, "kind": "sheet", "reference": "nodal", "boundary": "box", "loose": "drop", "map": None}
        if call == "infill":
            good |= {"skin": None, "rotation": (0, 0, 0)}
        if call == "solidify":
            good = {"domain": ((0, 0, 0), (5, 5, 5)), "tol": 0.3}
        if call == "blend":
            good = {
                "resolution": (20, 10, 10),
                "max_iterations": 5,
                "minimum_neck": None,
                "max_change": 0.1,
                "weight": "auto",
            }
        key = str(rng.choice(list(good)))
        value = ODD[int(rng.integers(len(ODD)))]
        options = good | {key: value}
        if call == "solidify":
            first = (fields.rod(fields.tpms("gyroid", 5.0), 0.0), options.pop("domain"))
        elif call == "blend":
            rods = [fields.rod(fields.tpms(n, 0.5), 0.0) for n in ("gyroid", "schwarz_p")]
            boxes = [fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))]
            first = (rods, boxes, [fields.box((0.3, 0, 0), (0.7, 0.5, 0.5))])
        else:
            first = ("schwarz_p",) if call == "lattice" else (bd.Box(12, 11, 12), "schwarz_p")

        def make_value(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
            getattr(tpmscad, call)(*first, **options)
            return True, "", list

        return Drawn(f"tpmscad.{call}(..., {key}={value!r})", make_value)
    number = int(rng.integers(10**6))

    def make_file(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        own = np.random.default_rng(number)
        path = folder / "request.step"
        bd.export_step(bd.Box(12, 12, 12) - bd.Cylinder(3, 12), path)
        data = bytearray(path.read_bytes())
        for _ in range(int(own.integers(1, 30))):
            at = int(own.integers(len(data)))
            way = int(own.integers(4))
            if way == 0:
                data[at] = int(own.integers(256))
            elif way == 1:
                del data[at : at + int(own.integers(1, 60))]
            elif way == 2:
                data[at:at] = data[at // 2 : at // 2 + int(own.integers(1, 60))]
            else:
                data[at : at + 1] = str(int(own.integers(10**6))).encode()
        path.write_bytes(bytes(data))
        report = tpmscad.check_step(path)
        if not report.ok:
            return False, "check says so", list
        tpmscad.infill(path, "schwarz_p", cell=10, thickness=1, tol=0.3)
        return True, "", list

    return Drawn(
        f"check_step and infill of a STEP file garbled by default_rng({number})", make_file, frozenset({"request.step"})
    )
