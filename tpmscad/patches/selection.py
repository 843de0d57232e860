"""A part of a complex: some of its faces, those on splines, or the same faces seen from the other side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tpmscad.patches.complex import Edges, Faces, Ints, PatchComplex, Uses
from tpmscad.splines.bspline import Surface


def selected(whole: PatchComplex, kept: Ints) -> PatchComplex:
    """The complex of some of the faces, on the edges and vertices that these use."""
    faces, uses, e = whole.faces, whole.uses, whole.edges
    loops = [range(faces.loop_start[f], faces.loop_start[f + 1]) for f in kept]
    spans = [range(faces.use_start[loop], faces.use_start[loop + 1]) for of in loops for loop in of]
    at = np.array([k for span in spans for k in span], np.int64)
    used, edge = np.unique(uses.edge[at], return_inverse=True)
    vertices, ends = np.unique(np.concatenate([e.start[used], e.end[used]]), return_inverse=True)
    start, end = np.split(ends.ravel(), 2)
    return replace(
        whole,
        vertices=whole.vertices[vertices],
        edges=Edges(e.curve[used], e.rotation[used], e.translation[used], e.span[used], start, end, e.deviation[used]),
        uses=Uses(edge.ravel(), uses.sense[at], uses.pcurve[at]),
        faces=Faces(
            carrier=faces.carrier[kept],
            rotation=faces.rotation[kept],
            translation=faces.translation[kept],
            sense=faces.sense[kept],
            tag=faces.tag[kept],
            loop_start=np.cumsum([0, *map(len, loops)]),
            use_start=np.cumsum([0, *map(len, spans)]),
        ),
    )


def spline_faces(patches: PatchComplex) -> Iterator[tuple[Ints, Surface]]:
    """B-spline surfaces in turn, each with the faces on it (f,)."""
    for index in np.unique(patches.faces.carrier).tolist():
        carrier = patches.carriers[index]
        if isinstance(carrier, Surface):
            yield np.flatnonzero(patches.faces.carrier == index), carrier


def flipped(patches: PatchComplex) -> PatchComplex:
    """The patches that bound what the lattice leaves: the other side of every one is out."""
    return replace(patches, faces=replace(patches.faces, sense=-patches.faces.sense))
