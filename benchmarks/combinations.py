"""Any matter in any body, within any skin, with what is kept and cleared and without: combinations made and judged.

    python -m benchmarks.combinations                       # all, an hour of one core
    python -m benchmarks.combinations --matter struts --body mesh

A result is judged by points: whether they lie in the body, deeper than the skin, in the matter, in what is kept or cleared, is
asked of fields, distances and the kernel's classifier, and their share is compared with the volume of the certificate. Pieces
and cavities must be possible. What is refused is printed with its reason, which the guide's table of combinations has to state.
"""

from __future__ import annotations

import argparse
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from tpmscad import fields, maps
from tpmscad._typing import Array, BoolArray
from tpmscad.errors import TpmscadError
from tpmscad.kernel.body_import.cad_body import read_bodies
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt.exploration import faces_of

POINTS = 20_000
"""Points in the box of a body, of which those in the body are judged by."""

STANDARD_ERRORS = 4.0
ROUNDED = 0.06
"""Share of the body by which a skin by the distance may be thicker at its edges."""

SECONDS = 60.0
"""CPU seconds that a combination may take."""

CELL, TOL = 5.0, 0.05
PHI = fields.tpms("gyroid", CELL)
CENTRE = np.array([-1.5, -0.9, 0.4])


def _data() -> Any:
    axis = np.arange(-9.0, 9.01, 0.5)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return fields.sampled(np.abs(fields.tpms("schwarz_p", 6.0).at(x, y, z)) - 0.35, (0.5,) * 3, (-9.0,) * 3)


def _blend() -> Any:
    left, right = fields.rod(PHI, 0.1), fields.rod(fields.tpms("schwarz_p", CELL), -0.1)
    return fields.smooth_union(left, right, width=0.5)


WALL: dict[str, Any] = {"surface": "gyroid", "cell": CELL, "thickness": 0.7, "tol": TOL}
MATTER: dict[str, Callable[[], tuple[dict[str, Any], Callable[[Array], BoolArray]]]] = {
    "surface": lambda: (WALL, _near_surface(0.35)),
    "skeletal": lambda: ({**WALL, "thickness": None, "kind": "skeletal"}, lambda p: _surface()(p) < 0),
    "graded": lambda: _of_field(
        fields.sheet(PHI, -0.2 - 0.01 * fields.expression("x"), 0.2 + 0.01 * fields.expression("x"))
    ),
    "blend": lambda: _of_field(_blend()),
    "crossing": lambda: _of_field(fields.union(fields.sheet(PHI, -0.3, 0.3), fields.cylinder((0, 0, 0), 1.3, "x"))),
    "struts": lambda: _of_field(
        fields.translate(fields.strut_lattice("bcc", CELL, 1.0, cells=(4, 4, 4)), (-10.03, -9.97, -10.04))
    ),
    "plates": lambda: _of_field(
        fields.translate(fields.plate_lattice("cubic", CELL, 0.6, cells=(4, 4, 4)), (-10.03, -9.97, -10.04))
    ),
    "core": lambda: _of_field(fields.core("honeycomb", cell=4.2, thickness=0.5)),
    "data": lambda: _of_field(_data()),
    "mapped": lambda: ({**WALL, "map": _make_bend()}, lambda p: _near_surface(0.35)(_unbend(p))),
}


RADIUS = 24 * CELL / (2 * np.pi)


def _make_bend() -> maps.Map:
    """A wrap round a cylinder, moved so that the bodies lie in its wall."""
    wrap, middle = maps.cylinder(RADIUS), np.array([0.0, RADIUS, 0.0])
    return maps.Map(lambda p: wrap(p) - middle, lambda p: wrap.jacobian(p, CELL), "bend")


def _of_field(field: Any) -> tuple[dict[str, Any], Callable[[Array], BoolArray]]:
    return {"surface": field, "tol": TOL}, lambda points: np.asarray(field(points) < 0)


def _surface() -> Any:
    return fields.normal_distance(fields.tpms("gyroid", CELL, reference="minimal"))


def _near_surface(half: float) -> Callable[[Array], BoolArray]:
    return lambda points: np.asarray(np.abs(_surface()(points)) < half)


def _unbend(points: Array) -> Array:
    """Lattice coordinates of points under the bend, whose walls are off by some per cent, which the judge allows."""
    r = np.hypot(points[:, 0], points[:, 1] + RADIUS)
    angle = np.arctan2(points[:, 0], points[:, 1] + RADIUS)
    return np.column_stack([RADIUS * angle, r - RADIUS, points[:, 2]])


def _mesh(folder: Path) -> Any:
    path = folder / "ball.stl"
    bd.export_stl(bd.Sphere(6.0), str(path), tolerance=0.005, angular_tolerance=0.1)
    return str(path)


def _image(_: Path) -> Any:
    axis = np.arange(-7.5, 7.51, 0.5)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return fields.labels((x**2 / 1.3 + y**2 + z**2 < 33).astype(np.int16), (0.5,) * 3, (-7.5,) * 3)


BODIES: dict[str, Callable[[Path], Any]] = {
    "box": lambda _: bd.Pos(0.1, 0.2, 0.05) * bd.Box(11, 10, 9),
    "quadric": lambda _: bd.Cylinder(6, 9) - bd.Pos(2, 1, 0) * bd.Cylinder(1.5, 20),
    "free form": lambda _: bd.Pos(0, 0, -4.5) * bd.extrude(bd.Ellipse(6.5, 4.7), 9),
    "mesh": _mesh,
    "image": _image,
    "formula": lambda _: fields.expression("x^2/36 + y^2/25 + z^2/20 - 1"),
    "several": lambda _: bd.Compound([bd.Pos(-5, 0, 0) * bd.Box(7, 8, 8), bd.Pos(5, 0, 0) * bd.Cylinder(3.6, 8)]),
}

SKINS: dict[str, dict[str, Any]] = {"none": {}, "skin": {"skin": 0.6}, "open": {"skin": 0.6, "open_faces": ">Z,<Z"}}
KEPT: dict[str, Callable[[], dict[str, Any]]] = {
    "none": dict,
    "keep": lambda: {"keep": bd.Pos(*CENTRE) * bd.Cylinder(1.4, 5)},
    "clear": lambda: {"clear": bd.Pos(*CENTRE) * bd.Cylinder(1.1, 30)},
}


def list_jobs() -> Iterator[tuple[str, str, str, str]]:
    """Every matter in every body, without a skin and within one; open faces, what is kept and what is cleared in turn."""
    for m, matter in enumerate(MATTER):
        for b, body in enumerate(BODIES):
            yield matter, body, "none", list(KEPT)[(m + b) % 3]
            yield matter, body, ("skin", "open")[(m + b) % 2], list(KEPT)[(m + 2 * b) % 3]


class Overtime(BaseException):
    """A combination took longer than it is given."""


class _Judge:
    """The share of points in a body that ought to be filled."""

    def __init__(self, body: Any) -> None:
        rng = np.random.default_rng(5)
        points = rng.uniform(-9, 9, (POINTS, 3))
        if isinstance(body, str):
            body = fields.mesh(body)
        self.field = body if isinstance(body, fields.Field) else None
        self.solids = [] if self.field is not None else [each.shape for each in read_bodies(body, "all")]
        if self.field is not None:
            inside = self.field(points) < 0
        else:
            inside = np.any([contains_points(solid, points) for solid in self.solids], axis=0)
        self.points = points[inside]

    def _measure_depth(self, leaves_open: bool) -> Array:
        """Depths (n,) of the points below the body's boundary, or below its faces that are not square to z."""
        if self.field is not None:
            is_distance = hasattr(self.field, "mesh")
            depth = -self.field if is_distance else -fields.normal_distance(self.field)
            return np.asarray(depth(self.points))
        faces = [face for solid in self.solids for face in faces_of(solid)]
        if leaves_open:
            faces = [face for face in faces if abs(bd.Face(face).normal_at().Z) < 0.999]
        return SkinDepth(self.solids[0], faces).distances(self.points)

    def expect(
        self, matter: Callable[[Array], BoolArray], skin: dict[str, Any], passive: dict[str, Any]
    ) -> tuple[float, float]:
        """The volume that is expected, and its standard error."""
        filled = matter(self.points)
        if skin:
            filled = filled | (self._measure_depth("open_faces" in skin) < skin["skin"])
        for name, solid in passive.items():
            inside = contains_points(solid.solid().wrapped, self.points)
            filled = (filled | inside) if name == "keep" else (filled & ~inside)
        share = float(filled.mean())
        return 18.0**3 * float(filled.sum()) / POINTS, 18.0**3 * np.sqrt(share * len(self.points)) / POINTS


def run(matter: str, body: str, skin: str, kept: str, folder: Path) -> tuple[str, str]:
    """The outcome of a combination in a word, and what is to be said of it."""
    given, contains = MATTER[matter]()
    source, passive = BODIES[body](folder), KEPT[kept]()
    options = {**given, **SKINS[skin], **passive, "progress": False}
    if body == "several":
        options["solid"] = "all"
    begun = time.process_time()
    try:
        model = tpmscad.infill(source, **options)
    except TpmscadError as error:
        spent = time.process_time() - begun
        return ("slow" if spent > SECONDS else "refused"), f"{spent:5.1f} s  {type(error).__name__}: {str(error)[:300]}"
    spent = time.process_time() - begun
    expected, error = _Judge(source).expect(contains, SKINS[skin], passive)
    certificate = model.certificate
    off = (certificate.volume - expected) / error
    rounded = ROUNDED * model.envelope.volume if skin != "none" and model.envelope else 0.0
    bent = 0.03 * expected if matter == "mapped" else 0.0
    allowed = STANDARD_ERRORS * error + bent
    shares = f"{certificate.volume:.2f} of {expected:.2f} ({off:+.1f} s.e.)"
    told = f"{spent:5.1f} s  {shares}, {certificate.n_faces} faces, {model.trimmed_by}"
    if not certificate.met:
        return "not met", f"{told}; {certificate.shortfalls[0][:200]}"
    if not -allowed <= certificate.volume - expected <= allowed + rounded or min(certificate.betti) < 0:
        return "WRONG", told
    return ("slow" if spent > SECONDS else "met"), told


def main(arguments: list[str] | None = None) -> None:
    """Print a line for each combination, and how many have each outcome."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--matter", default="", help="of this matter only")
    parser.add_argument("--body", default="", help="in this body only")
    parser.add_argument("--limit", type=int, default=600, help="seconds after which a combination is given up")
    chosen = parser.parse_args(arguments)

    def give_up(*_: Any) -> None:
        raise Overtime

    signal.signal(signal.SIGALRM, give_up)
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        for job in list_jobs():
            if chosen.matter not in job[0] or chosen.body not in job[1]:
                continue
            signal.alarm(chosen.limit)
            try:
                outcome, words = run(*job, Path(name))
            except Overtime:
                outcome, words = "hangs", f"more than {chosen.limit} s"
            except Exception as error:
                outcome, words = "FAULT", f"{type(error).__name__}: {error}"[:300]
            finally:
                signal.alarm(0)
            counts[outcome] += 1
            print(f"{' '.join(f'{each:9s}' for each in job)} {outcome:8s} {words}", flush=True)
    print(dict(counts))


if __name__ == "__main__":
    main()
