"""Small bodies with free-form faces, each with a surface of another kind, for tests and benchmarks of cuts and skins."""

from __future__ import annotations

from collections.abc import Callable

import build123d as bd


def cam() -> bd.Shape:
    """An extruded periodic spline: the third derivative jumps across six lines."""
    points = [(4.0, 0), (1.8, 2.7), (-1.3, 3.1), (-4, 1), (-3.1, -2.2), (0.5, -2.6)]
    return bd.extrude(bd.make_face(bd.Spline(*points, periodic=True)), 5)


def turned() -> bd.Shape:
    """A spline revolved."""
    side = bd.Spline((3.2, 0), (3.6, 1.6), (2.4, 4), (1.6, 6))
    profile = bd.make_face([*bd.Polyline((1.6, 6), (0, 6), (0, 0), (3.2, 0)).edges(), side])
    return bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z)


def elbow() -> bd.Shape:
    """An ellipse swept along a spline in space."""
    path = bd.Spline((0, 0, 0), (0, 0, 3), (2, 0.8, 5.2), (4.8, 1.6, 5.6))
    return bd.sweep(bd.Plane(origin=path @ 0, z_dir=path % 0) * bd.Ellipse(2.0, 1.3), path)


def ellipse() -> bd.Shape:
    return bd.extrude(bd.Ellipse(3.9, 2.4), 5)


def blade() -> bd.Shape:
    """A ruled loft between two quadratic arcs with a chord each."""
    sections = []
    for z, ends, top in ((0, ((0, 0), (7, 0)), (3.5, 6)), (5, ((1, 1), (6, 1.5)), (3.5, 6.5))):
        (a, b), c = ((x, y, z) for x, y in ends), (*top, z)
        sections.append(bd.Face(bd.Wire([bd.Edge.make_bezier(a, c, b), bd.Edge.make_line(b, a)])))
    return bd.loft(sections, ruled=True)


def dome() -> bd.Shape:
    """A spline revolved that meets the axis at a right angle: a pole where the surface is smooth."""
    side = bd.Spline((4, 0), (3.2, 2.4), (0, 4), tangents=((0, 1), (-1, 0)))
    profile = bd.make_face([side, *bd.Polyline((0, 4), (0, 0), (4, 0)).edges()])
    return bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z)


FREE_FORM_BODIES: dict[str, Callable[[], bd.Shape]] = {
    "cam": cam,
    "turned": turned,
    "elbow": elbow,
    "ellipse": ellipse,
    "blade": blade,
    "dome": dome,
}
