"""The rims of an offset shell cut where they get shallow, with vertices at the cuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.erosion.edge_graph import EdgeGraph
from tpmscad.erosion.offset_shell import SheetEdge
from tpmscad.erosion.sheets import ring_radius
from tpmscad.errors import TrimmingError, format_point
from tpmscad.trimming.intersect.network_hits import evaluate_faces

RIM_SAMPLES = 65
"""Points along a rim at which its depth is tested."""

NEWTON_STEPS = 16
"""Steps to the point where a rim pierces a sheet."""

RESIDUAL_REL_TOL = 1e-13
"""In sizes of the coordinates: distance of the points on rim and sheet that counts as zero."""


def cut_rim(graph: EdgeGraph, rim: SheetEdge) -> None:
    """The pieces of a rim that are deep enough, with their vertices."""
    shell = graph.shell

    def reaches(t: Array) -> BoolArray:
        """Whether the sheets have not ended in a pole."""
        return np.all(
            [
                ring_radius(shell.sheets[s].carrier, uv[:, 1]) > 0
                for s, uv in zip(rim.sheets, shell.rim_parameters(rim, t), strict=True)
            ],
            axis=0,
        )

    def is_kept(t: Array) -> BoolArray:
        return reaches(t) & graph.are_deep(rim.curve(t))

    def vertex(t: float, *more: tuple[int, Array]) -> int:
        uvs = shell.rim_parameters(rim, np.array([t]))
        entries = [(s, uv[0]) for s, uv in zip(rim.sheets, uvs, strict=True)]
        return graph.vertex_at(rim.curve(t), [*entries, *more])

    def end(good: float, bad: float) -> tuple[float, int]:
        for _ in range(60):
            if reaches(np.array([bad]))[0]:
                found = _pierce(graph, rim, good, bad)
                if found is not None:
                    return found[0], vertex(found[0], found[1])
            middle = 0.5 * (good + bad)
            if is_kept(np.array([middle]))[0]:
                good = middle
            else:
                bad = middle
        if reaches(np.array([bad]))[0]:
            raise TrimmingError(f"a joint of two offset faces ends in nothing at {format_point(rim.curve(good))}")
        return good, vertex(good)

    samples = np.linspace(*rim.span, RIM_SAMPLES)
    kept = is_kept(samples)
    changes = np.flatnonzero(kept[1:] != kept[:-1])
    ends = [(float(samples[0]), vertex(float(samples[0])))] if kept[0] else []
    ends += [
        end(*(float(samples[k + (0 if kept[k] else 1)]), float(samples[k + (1 if kept[k] else 0)]))) for k in changes
    ]
    if kept[-1]:
        ends.append((float(samples[-1]), vertex(float(samples[-1]))))
    for (low, start), (high, stop) in zip(ends[::2], ends[1::2], strict=True):
        if start != stop or high - low > 0.5 * (rim.span[1] - rim.span[0]):
            graph.rim_pieces.append((replace(rim, span=(low, high)), start, stop))


def _pierce(graph: EdgeGraph, rim: SheetEdge, good: float, bad: float) -> tuple[float, tuple[int, Array]] | None:
    """Where a rim pierces the sheet of the site that is too near at its parameter `bad`; None if not between both parameters."""
    at = rim.curve(bad)
    nearest = graph.nearest_sheet(at)
    if nearest is None:
        return None
    sheet, uv = nearest
    t, size = bad, 1.0 + float(np.abs(at).max())
    for _ in range(NEWTON_STEPS):
        jet, point = evaluate_faces(graph.patches, np.array([sheet]), uv[None])[0], rim.curve(t)
        gap = point - jet[0]
        if np.abs(gap).max() <= RESIDUAL_REL_TOL * size:
            break
        step = np.linalg.lstsq(np.column_stack([rim.curve(t, 1), *-jet[1:]]), -gap, rcond=None)[0]
        t, uv = float(np.clip(t + step[0], *rim.span)), uv + step[1:]
    if np.abs(gap).max() > 1000 * RESIDUAL_REL_TOL * size:
        return None
    slack = 1e-9 * (rim.span[1] - rim.span[0])
    if not min(good, bad) - slack <= t <= max(good, bad) + slack or not graph.are_deep(point[None])[0]:
        return None
    return t, (sheet, uv)
