"""Faults, put on purpose into boundary representations and into the text of STEP files: one at a time, at random places."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, select_faces
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SHIFT = 1e-3
"""How far poles, vertices and placements move, in model units: far above the kernel's tolerance, far below any feature."""

BrepFault = Callable[[Brep, np.random.Generator], Brep]
TextFault = Callable[[str, np.random.Generator], str]


def _moved(poles: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The poles with one of them moved."""
    poles = poles.copy()
    place = tuple(int(rng.integers(n)) for n in poles.shape[:-1])
    poles[place] += SHIFT * rng.choice([-1.0, 1.0], poles.shape[-1])
    return poles


def _place(motion: Motion, i: int, rng: np.random.Generator) -> Motion:
    """The motions with one of them moved."""
    translation = motion.translation.copy()
    translation[i] += SHIFT * rng.choice([-1.0, 1.0], 3)
    return Motion(motion.rotation, translation)


def _with(values: np.ndarray, i: int, value: float) -> np.ndarray:
    values = values.copy()
    values[i] = value
    return values


def move_vertex(brep: Brep, rng: np.random.Generator) -> Brep:
    return replace(brep, vertices=_moved(brep.vertices, rng))


def move_pole_of_face(brep: Brep, rng: np.random.Generator) -> Brep:
    spline = [f for f, c in enumerate(brep.faces.carrier.tolist()) if isinstance(brep.carriers[c], BSplineSurface)]
    f = int(rng.choice(spline))
    old = brep.carriers[int(brep.faces.carrier[f])]
    assert isinstance(old, BSplineSurface)
    edge_pole = _moved(old.poles[0], rng)  # on a side, where an edge must notice
    new = BSplineSurface(
        np.concatenate([edge_pole[None], old.poles[1:]]), old.knots_u, old.knots_v, old.degree_u, old.degree_v
    )
    carrier = _with(brep.faces.carrier, f, len(brep.carriers))
    return replace(brep, carriers=(*brep.carriers, new), faces=replace(brep.faces, carrier=carrier))


def move_pole_of_edge(brep: Brep, rng: np.random.Generator) -> Brep:
    spline = [e for e, c in enumerate(brep.edges.curve.tolist()) if isinstance(brep.curves[c], BSplineCurve)]
    e = int(rng.choice(spline))
    old = brep.curves[int(brep.edges.curve[e])]
    assert isinstance(old, BSplineCurve)
    new = BSplineCurve(_moved(old.poles, rng), old.knots, old.degree)
    edges = replace(brep.edges, curve=_with(brep.edges.curve, e, len(brep.curves)))
    return replace(brep, curves=(*brep.curves, new), edges=edges)


def move_pole_of_pcurve(brep: Brep, rng: np.random.Generator) -> Brep:
    k = int(rng.choice(np.flatnonzero(brep.uses.pcurve >= 0)))
    old = brep.pcurves[int(brep.uses.pcurve[k])]
    new = BSplineCurve(_moved(old.poles, rng), old.knots, old.degree)
    return replace(
        brep,
        pcurves=(*brep.pcurves, new),
        uses=replace(brep.uses, pcurve=_with(brep.uses.pcurve, k, len(brep.pcurves))),
    )


def move_face(brep: Brep, rng: np.random.Generator) -> Brep:
    faces = brep.faces
    return replace(brep, faces=replace(faces, motion=_place(faces.motion, int(rng.integers(len(faces))), rng)))


def move_edge(brep: Brep, rng: np.random.Generator) -> Brep:
    edges = brep.edges
    return replace(brep, edges=replace(edges, motion=_place(edges.motion, int(rng.integers(len(edges))), rng)))


def shorten_edge(brep: Brep, rng: np.random.Generator) -> Brep:
    edges, e = brep.edges, int(rng.integers(len(brep.edges)))
    low, high = edges.span[e]
    return replace(brep, edges=replace(edges, span=_with(edges.span, e, (low, high - 0.1 * (high - low)))))


def _permuted(brep: Brep, order: np.ndarray) -> Brep:
    uses = brep.uses
    return replace(brep, uses=EdgeUses(uses.edge[order], uses.sense[order], uses.pcurve[order]))


def _random_loop(brep: Brep, rng: np.random.Generator) -> np.ndarray:
    j = int(rng.integers(len(brep.faces.use_start) - 1))
    return np.arange(brep.faces.use_start[j], brep.faces.use_start[j + 1])


def reverse_order_of_loop(brep: Brep, rng: np.random.Generator) -> Brep:
    order, loop = np.arange(len(brep.uses)), _random_loop(brep, rng)
    order[loop] = loop[::-1]
    return _permuted(brep, order)


def reverse_loop(brep: Brep, rng: np.random.Generator) -> Brep:
    order, loop = np.arange(len(brep.uses)), _random_loop(brep, rng)
    order[loop] = loop[::-1]
    turned = _permuted(brep, order)
    sense = turned.uses.sense.copy()
    sense[loop] *= -1
    return replace(turned, uses=replace(turned.uses, sense=sense))


def swap_uses_of_loop(brep: Brep, rng: np.random.Generator) -> Brep:
    order, loop = np.arange(len(brep.uses)), _random_loop(brep, rng)
    a, b = rng.choice(loop, 2, replace=False).tolist()
    order[[a, b]] = order[[b, a]]
    return _permuted(brep, order)


def swap_edges_of_faces(brep: Brep, rng: np.random.Generator) -> Brep:
    a, b = rng.choice(len(brep.uses), 2, replace=False).tolist()
    edge = brep.uses.edge.copy()
    edge[[a, b]] = edge[[b, a]]
    return replace(brep, uses=replace(brep.uses, edge=edge))


def swap_pcurves(brep: Brep, rng: np.random.Generator) -> Brep:
    a, b = rng.choice(np.flatnonzero(brep.uses.pcurve >= 0), 2, replace=False).tolist()
    pcurve = brep.uses.pcurve.copy()
    pcurve[[a, b]] = pcurve[[b, a]]
    return replace(brep, uses=replace(brep.uses, pcurve=pcurve))


def flip_use(brep: Brep, rng: np.random.Generator) -> Brep:
    k = int(rng.integers(len(brep.uses)))
    return replace(brep, uses=replace(brep.uses, sense=_with(brep.uses.sense, k, -brep.uses.sense[k])))


def flip_face(brep: Brep, rng: np.random.Generator) -> Brep:
    f = int(rng.integers(len(brep.faces)))
    return replace(brep, faces=replace(brep.faces, sense=_with(brep.faces.sense, f, -brep.faces.sense[f])))


def exchange_ends_of_edge(brep: Brep, rng: np.random.Generator) -> Brep:
    edges, e = brep.edges, int(rng.integers(len(brep.edges)))
    start, end = edges.start[e], edges.end[e]
    return replace(brep, edges=replace(edges, start=_with(edges.start, e, end), end=_with(edges.end, e, start)))


def split_vertex(brep: Brep, rng: np.random.Generator) -> Brep:
    e = int(rng.integers(len(brep.edges)))
    vertices = np.concatenate([brep.vertices, brep.vertices[brep.edges.start[e]][None]])
    return replace(
        brep,
        vertices=vertices,
        edges=replace(brep.edges, start=_with(brep.edges.start, e, len(brep.vertices))),
    )


def merge_vertices(brep: Brep, rng: np.random.Generator) -> Brep:
    a, b = rng.choice(len(brep.vertices), 2, replace=False).tolist()
    edges = brep.edges
    start, end = np.where(edges.start == a, b, edges.start), np.where(edges.end == a, b, edges.end)
    return replace(brep, edges=replace(edges, start=start, end=end))


def split_edge_in_two(brep: Brep, rng: np.random.Generator) -> Brep:
    k, edges = int(rng.integers(len(brep.uses))), brep.edges
    e = np.append(np.arange(len(edges)), brep.uses.edge[k])
    doubled = Edges(edges.curve[e], edges.motion[e], edges.span[e], edges.start[e], edges.end[e], edges.deviation[e])
    return replace(brep, edges=doubled, uses=replace(brep.uses, edge=_with(brep.uses.edge, k, len(edges))))


def drop_face(brep: Brep, rng: np.random.Generator) -> Brep:
    return select_faces(brep, np.delete(np.arange(len(brep.faces)), int(rng.integers(len(brep.faces)))))


def double_face(brep: Brep, rng: np.random.Generator) -> Brep:
    return select_faces(brep, np.append(np.arange(len(brep.faces)), int(rng.integers(len(brep.faces)))))


def take_carrier_of_another_face(brep: Brep, rng: np.random.Generator) -> Brep:
    faces: Faces = brep.faces
    a, b = rng.choice(len(faces), 2, replace=False).tolist()
    motion = Motion(
        _with(faces.motion.rotation, a, faces.motion.rotation[b]),
        _with(faces.motion.translation, a, faces.motion.translation[b]),
    )
    return replace(brep, faces=replace(faces, carrier=_with(faces.carrier, a, faces.carrier[b]), motion=motion))


BREP_FAULTS: tuple[BrepFault, ...] = (
    move_vertex,
    move_pole_of_face,
    move_pole_of_edge,
    move_pole_of_pcurve,
    move_face,
    move_edge,
    shorten_edge,
    reverse_order_of_loop,
    reverse_loop,
    swap_uses_of_loop,
    swap_edges_of_faces,
    swap_pcurves,
    flip_use,
    flip_face,
    exchange_ends_of_edge,
    split_vertex,
    merge_vertices,
    split_edge_in_two,
    drop_face,
    double_face,
    take_carrier_of_another_face,
)


def _replaced(text: str, found: re.Match[str], new: str) -> str:
    return text[: found.start()] + new + text[found.end() :]


def _pick(pattern: str, text: str, rng: np.random.Generator) -> re.Match[str]:
    """A random match of a pattern in the data section."""
    found = list(re.finditer(pattern, text[text.index("DATA;") :]))
    chosen = found[int(rng.integers(len(found)))]
    match = re.compile(pattern).match(text, text.index("DATA;") + chosen.start())
    assert match is not None
    return match


def change_digit(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"(?<=[(,])-?\d+\.\d{2}", text, rng)
    digit = int(found[0][-1])
    return _replaced(text, found, f"{found[0][:-1]}{(digit + 1 + int(rng.integers(8))) % 10}")


def change_sign(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"(?<=[(,])\d+\.\d{2}", text, rng)
    return _replaced(text, found, f"-{found[0]}")


def change_reference(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"(?<=[(,])#\d+", text, rng)
    return _replaced(text, found, f"#{int(found[0][1:]) + int(rng.choice([-2, -1, 1, 2]))}")


def dangle_reference(text: str, rng: np.random.Generator) -> str:
    return _replaced(text, _pick(r"(?<=[(,])#\d+", text, rng), "#99999999")


def flip_flag(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"(?:ORIENTED_EDGE|ADVANCED_FACE)\('[^\n]*\.([TF])\.", text, rng)
    flipped = found[0][:-2] + ("F." if found[1] == "T" else "T.")
    return _replaced(text, found, flipped)


def drop_line(text: str, rng: np.random.Generator) -> str:
    return _replaced(text, _pick(r"#\d+=[^\n]*;\n", text, rng), "")


def double_line(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"#(\d+)=([^\n]*;\n)", text, rng)
    other = _pick(r"#(\d+)=([^\n]*;\n)", text, rng)
    return _replaced(text, found, f"#{other[1]}={found[2]}")


def exchange_lines(text: str, rng: np.random.Generator) -> str:
    a, b = _pick(r"#\d+=([^\n]*;\n)", text, rng), _pick(r"#\d+=([^\n]*;\n)", text, rng)
    a, b = (a, b) if a.start() < b.start() else (b, a)
    return text[: a.start(1)] + b[1] + text[a.end(1) : b.start(1)] + a[1] + text[b.end(1) :]


def truncate(text: str, rng: np.random.Generator) -> str:
    return text[: int(rng.integers(text.index("DATA;"), len(text) - 20))]


def drop_semicolon(text: str, rng: np.random.Generator) -> str:
    return _replaced(text, _pick(r";\n", text, rng), "\n")


def change_degree(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"B_SPLINE_(?:SURFACE|CURVE)_WITH_KNOTS\('',(\d)", text, rng)
    return _replaced(text, found, f"{found[0][:-1]}{int(found[1]) + 1}")


def change_knot(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"(?<=,)1\.0\),\.UNSPECIFIED\.\)", text, rng)
    return _replaced(text, found, found[0].replace("1.0", "1.25"))


def shorten_list(text: str, rng: np.random.Generator) -> str:
    found = _pick(r"(?:CLOSED_SHELL|EDGE_LOOP)\('',\((#\d+),#", text, rng)
    return _replaced(text, found, found[0].replace(f"{found[1]},#", "#"))


def change_unit(text: str, rng: np.random.Generator) -> str:
    return text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)")


TEXT_FAULTS: tuple[TextFault, ...] = (
    change_digit,
    change_sign,
    change_reference,
    dangle_reference,
    flip_flag,
    drop_line,
    double_line,
    exchange_lines,
    truncate,
    drop_semicolon,
    change_degree,
    change_knot,
    shorten_list,
    change_unit,
)
