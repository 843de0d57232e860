"""A lattice of round struts in a box, as an exact solid of cylinders, balls and planes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.api.public_calls import validate_options
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest
from tpmscad.fields.kinds.strut_graphs import StrutsField, make_strut_graph, map_struts
from tpmscad.fields.kinds.strut_graphs import struts as make_struts
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.lattices.coordinate_maps import as_map
from tpmscad.requests.lattice_request import size_of_cells
from tpmscad.requests.strut_options import StrutOptions
from tpmscad.results.model import Model, UnitCell
from tpmscad.solids._solidify import solidify_crossing
from tpmscad.solids.matter.strut_boundaries import as_graph, bound_struts_in_box, require_struts_apart
from tpmscad.stage_timer import StageTimer
from tpmscad.strut_cells import FLAT_KINDS

DEFAULT_TOL_CELLS = 1e-3
"""In shortest edges of the cell: the tolerance if none is given."""

BOX_MARGIN = 1.25
"""In radii: how far the box of struts under a map reaches beyond their nodes."""

FRACTION_RTOL = 1e-9
"""Relative difference of the volume fraction from the one asked for."""

MAX_STEPS = 12
"""Steps of the search for the diameter; without balls, whose radius stays, the first one is exact."""


@validate_options(StrutOptions, 'struts("octet", cell=10, cells=(2, 2, 2), diameter=1)')
def struts(options: StrutOptions) -> Model:
    """Make a lattice of round struts that fills the box from the origin to `cells` x `cell`.

    Struts in the sides of the box are cut by them: half of each is in the box, and a quarter along its edges.

    Returns
    -------
    Model
        The solid and its certificate; `certificate.met` is False if the result misses the request.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy. The struts may touch
        in their nodes only.
    KernelError
        If the kernel cannot build the solid.

    Notes
    -----
    ``struts(kind, cell=..., cells=..., diameter=...)`` is ``solidify(fields.strut_lattice(kind, ...), box, tol=...)``. A body is
    filled by ``infill(body, fields.strut_lattice(...), tol=...)``, and any graph becomes a solid through `fields.struts`.

    Examples
    --------
    >>> model = tpmscad.struts("octet", cell=10, cells=(2, 2, 2), diameter=1)  # doctest: +SKIP
    >>> model.export_step("octet.step")  # doctest: +SKIP
    """
    stages = StageTimer(options.progress)
    edges = np.broadcast_to(np.asarray(options.cell, float), 3)
    hi = np.array(size_of_cells(options.cell, options.cells))
    graph = make_strut_graph(options.kind, options.cell, options.cells, options.angle)
    fraction = _resolve_fraction(options)
    if options.kind in FLAT_KINDS and options.map is None:
        raise InvalidRequest(
            f"the struts of a {options.kind} lie in the plane y = 0, a side of the box: give `map`, a cylinder say, for a stent"
        )
    low = np.zeros(3)
    if options.map is not None:
        if options.diameter is None:
            raise InvalidRequest("a volume fraction is that of the box of the cells: under a map give diameter=")
        field = map_struts(
            make_struts(*graph, options.diameter, options.node_radius), as_map(options.map).over_block(hi)
        )
        margin = BOX_MARGIN * float(field.balls.max())
        low, hi = field.points.min(axis=0) - margin, field.points.max(axis=0) + margin
        notes: tuple[str, ...] = ()
    elif fraction is None:
        assert options.diameter is not None
        field = make_struts(*graph, options.diameter, options.node_radius)
        notes = ()
    else:
        with stages("diameter"):
            field = _solve_diameter(graph[0], graph[1], options.node_radius, hi, fraction)
        notes = (f"struts of {2 * field.radii[0, 0]:.9g} mm fill {fraction:g} of the box",)
    unit_cell = None
    if options.map is None and field.is_even:
        one = make_struts(
            *make_strut_graph(options.kind, options.cell, 1, options.angle),
            float(2 * field.radii[0, 0]),
            options.node_radius,
        )
        counts = tuple(np.broadcast_to(options.cells, 3).tolist())
        unit_cell = UnitCell(partial(bound_struts_in_box, one, low, edges), tuple(edges.tolist()), counts)
    tol = DEFAULT_TOL_CELLS * float(edges.min()) if options.tol is None else options.tol
    model = solidify_crossing(field, (low, hi), tol, options.loose, stages)
    return replace(
        model,
        name=f"{options.kind} struts",
        unit_cell=unit_cell,
        certificate=replace(model.certificate, notes=(*notes, *model.certificate.notes)),
        envelope=Envelope.of_box("the box of the cells", low, hi),
        struts=field,
    )


def _resolve_fraction(options: StrutOptions) -> float | None:
    """The volume fraction that is asked for, None for a diameter; InvalidRequest unless exactly one is given."""
    given = [n for n in ("diameter", "volume_fraction", "porosity") if getattr(options, n) is not None]
    if len(given) != 1:
        raise InvalidRequest(
            f"give exactly one of diameter, volume_fraction and porosity, not {' and '.join(given) or 'none'}"
        )
    return 1.0 - options.porosity if options.porosity is not None else options.volume_fraction


def _solve_diameter(points: Array, edges: IntArray, node_radius: float, hi: Array, fraction: float) -> StrutsField:
    """The struts that fill a fraction of the box; InvalidRequest if they would touch each other.

    Without balls the volume is a d^2 - b d^3, exactly, as long as struts meet in their nodes only: the ends of equal struts are
    similar. A ball of a fixed radius changes a little of it, so that a few steps follow.
    """
    goal = fraction * float(np.prod(hi))

    def measure(diameter: float, node_radius: float = node_radius) -> tuple[StrutsField, float]:
        field = make_struts(points, edges, diameter, node_radius)
        require_struts_apart(as_graph(field))
        moments = integral_properties.integrate_faces(bound_struts_in_box(field, np.zeros(3), hi))
        return field, float(integral_properties.volume(moments)[0])

    length = float(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).sum())
    diameter = float(
        np.sqrt(4 * goal / (np.pi * length))
    )  # too thin or too thick by the nodes and the sides of the box
    thin = 0.1 * diameter
    first, second = (measure(d, 0.0)[1] / d**2 for d in (0.5 * thin, thin))
    slope, base = (second - first) / (0.5 * thin), 2 * first - second
    roots = np.roots([slope, base, 0.0, -goal])
    real = np.sort(roots[(abs(roots.imag) < FRACTION_RTOL * abs(roots)) & (roots.real > 0)].real)
    if not len(real):
        peak = -2 * base / (3 * slope)
        most = (base * peak**2 + slope * peak**3) / float(np.prod(hi))
        raise InvalidRequest(
            f"a volume fraction of {fraction:g} is more than struts of this kind fill before they merge, less than {most:.3g}: "
            "give a smaller one"
        )
    diameter = float(real[0])
    field, volume = measure(diameter)
    for _ in range(MAX_STEPS):
        if abs(volume - goal) <= FRACTION_RTOL * goal:
            return field
        diameter += (goal - volume) / (2 * base * diameter + 3 * slope * diameter**2)
        if not diameter > 0:
            break
        field, volume = measure(diameter)
    raise InvalidRequest(
        f"no diameter gives a volume fraction of {fraction:g} with a node_radius of {node_radius:g}: the balls fill more; make "
        "them smaller"
    )
