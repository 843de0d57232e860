"""Requests of the standing trial for infill within a skin with open faces, and the judge of the skin, by the mesh and the labels.

Which faces are open is found here again from the words of the request; where skin, walls and voids are, from the body's faces and
the formula of the surface; what the solid holds, from its triangles.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.trial_judges import MINIMAL_OFF, NodalFunction, signed_distance
from benchmarks.trial_requests import FILES, Drawn, draw_body, draw_infill_options, judge_model, written
from benchmarks.trial_statements import COARSE_ANGLE, triangulate
from tpmscad.catalogue import CATALOGUE

PROBES = 120
"""Points in the body at which solid or void is told, and as many close below its open faces."""

PROBE_DEPTH = 0.02
"""In model units: how far below an open face its probes lie, besides the error of the mesh."""

TRIANGLES_AT_ONCE = 20_000

MITRE_RATIO = 1.45
"""In skins: the greatest thickness that a result may have; the statement of a result tells its own."""

EDGE_TOL = 1e-4
"""Model units: how far the edges of cut faces may be from the faces."""

SAMPLES_PER_FACE = 3
MAX_FACES_SAMPLED = 60


@dataclass(frozen=True)
class SkinRequest:
    """A body, the numbers of its open faces, the thickness of the skin, and the signed distance to the middle of the walls.

    smear: how far (model units) the walls may be from where `distance` has them.
    """

    body: Any
    opened: frozenset[int]
    skin: float
    distance: Callable[[np.ndarray], np.ndarray]
    half: float
    smear: float


def number_open_faces(body: Any, selection: Any) -> frozenset[int]:
    """Numbers of the faces that a selection names: numbers, faces, or words such as ">Z"; several in a tuple or by commas."""
    import build123d as bd

    faces = body.faces()
    plane = [i for i, face in enumerate(faces) if face.geom_type == bd.GeomType.PLANE]
    normal = {i: np.array(tuple(faces[i].normal_at())) for i in plane}
    corners = {i: np.array([tuple(v) for v in faces[i].vertices()]) for i in plane}
    box = body.bounding_box()
    ends = np.array([tuple(box.min), tuple(box.max)])
    found: set[int] = set()
    for part in selection if isinstance(selection, tuple | list) else (selection,):
        if not isinstance(part, str):
            found.add(part if isinstance(part, int) else next(i for i, face in enumerate(faces) if face.is_same(part)))
            continue
        for word in part.split(","):
            word = word.strip()
            if word.isdigit():
                found.add(int(word))
                continue
            axis = "XYZ".index(word[1].upper())
            along = {i: n[axis] for i, n in normal.items()}
            if word[0] in "<>":
                end = ends[int(word[0] == ">"), axis]
                found |= {i for i in plane if np.abs(corners[i][:, axis] - end).max() < 1e-5}
            else:
                ask = {
                    "|": lambda a: abs(abs(a) - 1) < 1e-9,
                    "#": lambda a: abs(a) < 1e-9,
                    "+": lambda a: abs(a - 1) < 1e-9,
                    "-": lambda a: abs(a + 1) < 1e-9,
                }[word[0]]
                found |= {i for i in plane if ask(along[i])}
    return frozenset(found)


def is_solid(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) lie in a mesh, by the sum of the solid angles of its triangles, of either 0 or 4 pi."""
    turned = np.zeros(len(points))
    for part in range(0, len(triangles), TRIANGLES_AT_ONCE):
        corners = vertices[triangles[part : part + TRIANGLES_AT_ONCE]]
        for i, point in enumerate(points):
            a, b, c = np.moveaxis(corners - point, 1, 0)
            la, lb, lc = (np.sqrt((x * x).sum(-1)) for x in (a, b, c))
            volume = (a * np.cross(b, c)).sum(-1)
            scale = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
            turned[i] += np.arctan2(volume, scale).sum()
    return turned > np.pi


def depths(points: np.ndarray, faces: Sequence[Any]) -> np.ndarray:
    """Distances (n,) of points (n, 3) from the nearest of some faces."""
    import build123d as bd

    return np.array([min(face.distance_to(bd.Vertex(*p)) for face in faces) for p in points.tolist()])


def judge_skin(
    model: Any, request: SkinRequest, vertices: np.ndarray, triangles: np.ndarray, deviation: float
) -> list[str]:
    """What a solid's mesh, within `deviation` of it, its labels and its notes contradict of the skin that was asked for."""
    faces = request.body.faces()
    closed = [face for i, face in enumerate(faces) if i not in request.opened]
    said = [
        m for note in model.certificate.notes if (m := re.match(r"skin of (\S+) by [^:]*: (\S+) to (\S+) thick", note))
    ]
    if not said:
        return ["no note tells the thickness of the skin"]
    stated, least, most = (float(x) for x in said[0].groups())
    faults = []
    if stated != float(f"{request.skin:g}") or least < 0.97 * request.skin or most > MITRE_RATIO * request.skin:
        faults.append(f"a skin of {stated:g} is stated, {least:g} to {most:g} thick, asked for was {request.skin:g}")
    slack = deviation + model.certificate.max_deviation
    faults += judge_skin_labels(model, request, closed, (least, most))
    return faults + judge_probes(model, request, closed, most, vertices, triangles, slack)


def judge_skin_labels(
    model: Any, request: SkinRequest, closed: Sequence[Any], thickness: tuple[float, float]
) -> list[str]:
    """What the labels say wrongly: whole closed faces, open ones with holes, inner sides of the skin at its depth, walls."""
    import build123d as bd

    of_body = request.body.faces()
    area = dict.fromkeys(range(len(of_body)), 0.0)
    faults, inner, walls = [], [], []
    for solid in model.named_solids():
        for label, face in zip(solid.labels, bd.Shape.cast(solid.solid).faces(), strict=True):
            if match := re.match(r"body (\d+)", label):
                area[int(match[1])] += face.area
            elif label == "skin":
                inner.append(face)
            elif label.startswith("surface"):
                walls.append(face)
            else:
                faults.append(f"a face about {tuple(face.center())} has the label {label!r}")
    for i, face in enumerate(of_body):
        if i in request.opened and area[i] > (1 - 1e-3) * face.area:
            faults.append(f"face {i} is open, but {area[i]:.6g} of its area {face.area:.6g} has its label")
        if i not in request.opened and abs(area[i] - face.area) > 1e-5 * face.area:
            faults.append(f"face {i} is closed, but {area[i]:.6g} of its area {face.area:.6g} has its label")
    if not inner:
        faults.append("no face has the label of the inner side of the skin")
    if not walls:
        faults.append("no face has the label of a wall")
    depth = depths(sample_faces(inner), closed) if inner else np.zeros(0)
    bounds = thickness[0] * (1 - 1e-3) - 1e-4, thickness[1] * (1 + 1e-3) + 1e-4  # four digits are printed
    if ((depth < bounds[0]) | (depth > bounds[1])).any():
        faults.append(
            f"faces with the label skin lie {depth.min():.5g} to {depth.max():.5g} deep, stated is {thickness}"
        )
    if walls:
        off = np.abs(np.abs(request.distance(sample_faces(walls))) - request.half)
        stated = model.certificate.max_deviation + request.smear
        if off.max() > stated + EDGE_TOL:
            faults.append(f"a face with the label of a wall is {off.max():.3g} off the wall, stated are {stated:.3g}")
    return faults


def sample_faces(faces: Sequence[Any]) -> np.ndarray:
    """Points (n, 3) of faces, at vertices and on edges of an even choice of them."""
    chosen = faces[:: max(1, len(faces) // MAX_FACES_SAMPLED)]
    return np.array(
        [tuple(edge @ t) for face in chosen for edge in face.edges()[:SAMPLES_PER_FACE] for t in (0.0, 0.4)]
    )


def judge_probes(
    model: Any,
    request: SkinRequest,
    closed: Sequence[Any],
    most: float,
    vertices: np.ndarray,
    triangles: np.ndarray,
    slack: float,
) -> list[str]:
    """Points of the body that are solid and should be void, or the reverse; those near a boundary are left out."""

    rng = np.random.default_rng(11)
    box = request.body.bounding_box()
    low, high = np.array(tuple(box.min)), np.array(tuple(box.max))
    points = [p for p in rng.uniform(low, high, (2 * PROBES, 3)) if request.body.is_inside(tuple(p))][:PROBES]
    for i in sorted(request.opened):
        face = request.body.faces()[i]
        corners = face.bounding_box()
        inward = -np.array(tuple(face.normal_at()))
        across = rng.uniform(tuple(corners.min), tuple(corners.max), (PROBES // len(request.opened), 3))
        points += [p + (PROBE_DEPTH + slack) * inward for p in across if face.is_inside(tuple(p))]
    probes = np.array([p for p in points if request.body.is_inside(tuple(p))])
    depth, distance = depths(probes, closed), np.abs(request.distance(probes))
    margin = slack + request.smear
    in_skin = (depth > slack) & (depth < request.skin - slack)  # the mesh may cut off what is less deep
    beyond = depth > most + slack
    in_wall = beyond & (distance < request.half - margin)
    in_void = beyond & (distance > request.half + margin)
    if model.certificate.dropped:  # a piece of the walls that touches nothing
        in_wall &= False
    found = is_solid(probes, vertices, triangles)
    faults = []
    for name, expected, where in (("skin", True, in_skin), ("wall", True, in_wall), ("void", False, in_void)):
        wrong = np.flatnonzero(where & (found != expected))
        if len(wrong):
            at = probes[wrong[0]].round(4).tolist()
            faults.append(
                f"{len(wrong)} of {where.sum()} points in the {name} are {'void' if expected else 'solid'}, as at {at}, "
                f"{depth[wrong[0]]:.4g} below the closed faces and {distance[wrong[0]]:.4g} from the middle of a wall"
            )
    return faults


def draw_skin(rng: np.random.Generator) -> Drawn:
    """An infill within a skin, with some faces open that are named in one of the ways there are."""
    import tpmscad

    body_text, body, _, _, _ = draw_body(rng)
    while not (plane := _plane_faces(body)):
        body_text, body, _, _, _ = draw_body(rng)
    name, options = draw_infill_options(rng)
    skin = options["skin"] = round(float(rng.uniform(0.4, 1.5)), 2)
    faces = body.faces()
    way = str(rng.choice(["word", "words", "number", "numbers", "adjacent", "shape"]))
    letter = str(rng.choice(["Z"] if len(plane) == 2 else ["X", "Y", "Z"]))
    number = int(rng.choice(plane))
    selection: Any = number
    if way == "word":
        selection = str(rng.choice(["<", ">", "|", "+", "-"])) + letter
    elif way == "words":
        other = str(rng.choice(["Z"] if len(plane) == 2 else ["X", "Y", "Z"]))
        pair = f"{rng.choice(['<', '>'])}{letter}", f"{rng.choice(['<', '>'])}{other.lower()}"
        selection = ", ".join(pair) if rng.random() < 0.5 else pair
    elif way == "numbers":
        chosen = [int(i) for i in rng.choice(plane, min(2, len(plane)), replace=False)]
        selection = ",".join(map(str, chosen)) if rng.random() < 0.5 else chosen
    elif way == "adjacent":
        pairs = [
            (i, j)
            for i, j in itertools.combinations(plane, 2)
            if any(one.is_same(two) for one in faces[i].edges() for two in faces[j].edges())
        ]
        selection = pairs[int(rng.integers(len(pairs)))] if pairs else number
    given = faces[number] if way == "shape" else selection
    opened = number_open_faces(body, given)
    info, cell, half = CATALOGUE[name], options["cell"], 0.5 * options["thickness"]

    def make(folder: Path) -> tuple[bool, str, Callable[[], list[str]]]:
        model = tpmscad.infill(body, name, **options, open_faces=given, progress=False)
        met, why, judge = judge_model(
            model, folder, None, rng, wall=max(options["thickness"], skin), envelope=body.volume, body=body
        )

        def judge_all() -> list[str]:
            f = NodalFunction(info.formula, (cell,) * 3, options.get("phase", (0, 0, 0)))
            request = SkinRequest(
                body,
                opened,
                skin,
                lambda p: signed_distance(f, p, 2 * half, cell),
                half,
                MINIMAL_OFF.get(name, 0.0) * cell,
            )
            c = model.certificate
            deviation = max(c.tol, 1e-3 * c.volume / c.area)
            vertices, triangles = triangulate(model.wrapped, deviation, angle=COARSE_ANGLE)
            return judge() + judge_skin(model, request, vertices, triangles, deviation)

        return met, why, judge_all

    shown = f"body.faces()[{number}]" if way == "shape" else repr(selection)
    call = written(f"tpmscad.infill({body_text}, {name!r}, ", options).replace(", , ", ", ")
    return Drawn(f"{call[:-1]}, open_faces={shown}): open are {sorted(opened)}", make, FILES)


def _plane_faces(body: Any) -> list[int]:
    """Numbers of the plane faces of a body."""
    import build123d as bd

    return [i for i, face in enumerate(body.faces()) if face.geom_type == bd.GeomType.PLANE]
