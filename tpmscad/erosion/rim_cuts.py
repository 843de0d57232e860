"""The rims of an offset shell cut where they get shallow, with vertices at the cuts."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.erosion.edge_graph import EdgeGraph, RimPiece
from tpmscad.erosion.intersections import meet_rim
from tpmscad.erosion.sheets import ring_radius
from tpmscad.errors import TrimmingError, format_point

RIM_SAMPLES = 65
"""Points along a rim at which its depth is tested."""


def cut_rim(graph: EdgeGraph, number: int) -> None:
    """The pieces of a rim that are deep enough, with their vertices."""
    shell, rim = graph.shell, graph.shell.rims[number]

    def own_parameters(t: Array) -> list[Array]:
        found = []
        for s, pcurve in zip(rim.sheets, rim.pcurves, strict=True):
            carrier = shell.sheets[s].carrier
            found.append(carrier.parameters(rim.curve(t)) if pcurve is None else pcurve(t))  # type: ignore[union-attr]
        return found

    def reaches(t: Array) -> BoolArray:
        """Whether the sheets have not ended in a pole."""
        return np.all(
            [
                ring_radius(shell.sheets[s].carrier, uv[:, 1]) > 0
                for s, uv in zip(rim.sheets, own_parameters(t), strict=True)
            ],
            axis=0,
        )

    def is_kept(t: Array) -> BoolArray:
        return reaches(t) & graph.are_deep(rim.curve(t))

    def vertex(t: float, *more: tuple[int, Array]) -> int:
        uvs = own_parameters(np.array([t]))
        entries = [(s, uv[0]) for s, uv in zip(rim.sheets, uvs, strict=True)]
        return graph.vertex_at(rim.curve(t), [*entries, *more])

    def end(good: float, bad: float) -> tuple[float, int]:
        for _ in range(60):
            if reaches(np.array([bad]))[0]:
                found = _pierce(graph, number, good, bad)
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
            graph.rim_pieces.append(RimPiece(number, (low, high), start, stop))


def _pierce(graph: EdgeGraph, number: int, good: float, bad: float) -> tuple[float, tuple[int, Array]] | None:
    """Where a rim pierces the sheet of the site that is too near at its parameter `bad`; None if not between both parameters."""
    shell, rim = graph.shell, graph.shell.rims[number]
    at = rim.curve(bad)
    nearest = graph.nearest_sheet(at)
    if nearest is None:
        return None
    sheet, uv = nearest
    found = meet_rim(rim, shell.sheets[sheet], bad, uv)
    if found is None:
        return None
    t, uv, point = found
    slack = 1e-9 * (rim.span[1] - rim.span[0])
    if not min(good, bad) - slack <= t <= max(good, bad) + slack or not graph.are_deep(point[None])[0]:
        return None
    return t, (sheet, uv)
