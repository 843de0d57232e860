"""A file's solids held against the boundary representation that it is meant to hold, to the last bit, from its text alone.

The entities are followed from the solids down to the points: shells, faces, bounds, loops, oriented edges, edges, vertices,
curves and surfaces. Every reference must lead to an entity of the kind expected, every number be the float that was meant,
every flag agree, and every edge and vertex of the file stand for one of the boundary representation. Coordinates of points are
meant as multiples of a power of ten (`geometry_entities.COORDINATE_DIGITS`). Placements of planes, quadrics and conics, which
are computed once more here, may differ by round-off.

Every usage of a part in an assembly says twice what is placed where: by product definitions, and by representations with a
transformation. Both must agree. The representations form a tree; its leaf is the part, its root the whole, and the
transformations along the way give the place of each copy.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import (
    Carrier,
    Circle,
    ConicalSurface,
    CylindricalSurface,
    EdgeCurve,
    Plane,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.brep.moments import integral_properties
from tpmscad.kernel.build.shell_nesting import ShellNesting
from tpmscad.kernel.step.entity_table import (
    ROUND_OFF,
    EntityRows,
    EntityTable,
    agree,
    read_entity_table,
    require,
    template_marks,
)
from tpmscad.kernel.step.geometry_entities import count_decimals, find_knots_in_file, poles_of
from tpmscad.kernel.step.product_entities import compose_levels
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment


def check_text(
    path: Path, brep: Brep, nesting: ShellNesting, instances: Sequence[Motion] = ()
) -> tuple[EntityTable, Array]:
    """The entities of a file and the entity number of each face, if it holds the solids of `brep`, placed as `instances` say.

    KernelError that names the first difference otherwise.
    """
    text = FileText(read_entity_table(path), brep, nesting)
    faces = text.check()
    if instances:
        check_placements(text, instances)
    return text.table, faces


class FileText(EntityRows):
    """The entities of a file and what they are meant to be."""

    def __init__(self, table: EntityTable, brep: Brep, nesting: ShellNesting) -> None:
        require(np.diff(np.sort(table.number)) > 0, "two entities have one number")
        super().__init__(table)
        self.brep, self.nesting = brep, nesting
        sizes = [np.abs(brep.vertices).max(initial=1e-9)]
        self._curves, self._surfaces = (
            list(_group_splines(items, placed))
            for items, placed in ((brep.curves, brep.edges.curve), (brep.carriers, brep.faces.carrier))
        )
        for groups, motions in ((self._curves, brep.edges.motion), (self._surfaces, brep.faces.motion)):
            sizes += [float(np.abs(motions[own, None].apply(poles)).max()) for _, own, poles in groups]
        self.decimals = count_decimals(float(max(sizes)))

    def check(self) -> Array:
        """The entity number of each face (F,); KernelError if anything differs."""
        self._check_references()
        brep, nesting = self.brep, self.nesting
        face_of_file = self._faces_in_order()
        sense = brep.faces.sense.copy()
        voids = [v for _, *of_piece in nesting.shells_of_solid for v in of_piece]
        sense[np.isin(nesting.shell_of_face, voids)] *= -1  # the text reverses whole void shells
        bounds, surface, flag, n_bounds = self._faces(face_of_file)
        quadric = np.array([not isinstance(c, BSplineSurface | Plane) for c in brep.carriers])[brep.faces.carrier]
        turned = np.where(quadric & (np.linalg.det(brep.faces.motion.rotation) < 0), -sense, sense)
        require(flag == turned, "the side of a face")
        require(n_bounds == np.diff(brep.faces.loop_start), "the number of loops of a face")
        edge, vertices = self._check_loops(bounds, sense)
        self._check_edges(edge, vertices)
        self._check_surfaces(surface)
        self._check_totals()
        self._check_styles(face_of_file)
        return face_of_file

    # entities and their numbers

    def lists(self, numbers: Array, before: str, after: str) -> tuple[Array, IntArray]:
        """References listed in entities whose template is `before`, a list, `after`; and the length of each list."""
        form = re.escape(before) + r"\((#(?:,#)*)\)" + re.escape(after)
        at, count, _ = self._match_lists(numbers, form, before)
        return self.table.values[_ranges(self.table.start[at], count)], count

    def _match_lists(self, numbers: Array, form: str, what: str) -> tuple[IntArray, IntArray, IntArray]:
        """Positions of entities whose template has a form, the length of the list in its first group, and its template."""
        table, at = self.table, self.table.positions(numbers)
        require(at >= 0, f"a reference leads nowhere instead of to {what}")
        length = np.zeros(len(table.templates), np.int64)
        for i in np.unique(table.template[at]).tolist():
            found = re.fullmatch(form, table.templates[i])
            require(found is not None, f"there is another entity in place of {what}")
            assert found is not None
            length[i] = found[1].count("#")
        self.known[at] = True
        return at, length[table.template[at]], table.template[at]

    def _check_references(self) -> None:
        """Every reference leads to an entity."""
        for i, template in enumerate(self.table.templates):
            marks = template_marks(template)
            columns = [k for k, mark in enumerate(marks) if mark == "#"]
            if columns:
                own = self.table.start[:-1][self.table.template == i]
                referred = self.table.values[own[:, None] + np.array(columns)]
                require(self.table.positions(referred) >= 0, f"a reference of {template[:60]} leads nowhere")

    # topology

    def _faces_in_order(self) -> Array:
        """Entity number of each face of the boundary representation, from the solids and shells."""
        result = np.zeros(len(self.brep.faces))
        solids = np.sort(np.concatenate([self.with_keyword(k) for k in ("MANIFOLD_SOLID_BREP", "BREP_WITH_VOIDS")]))
        require(len(solids) == len(self.nesting.shells_of_solid), "the number of solids")
        for at, shells in zip(solids.tolist(), self.nesting.shells_of_solid, strict=True):
            template = self.table.templates[self.table.template[at]]
            form = r"MANIFOLD_SOLID_BREP\('(?:[^']|'')*',#\)|BREP_WITH_VOIDS\('(?:[^']|'')*',#,\(#(?:,#)*\)\)"
            require(re.fullmatch(form, template), "a solid")
            self.known[at] = True
            outer, *voids = self.table.values[self.table.start[at] : self.table.start[at + 1]].tolist()
            inner = self.rows(np.array(voids), "ORIENTED_CLOSED_SHELL('',*,#,.F.)")[:, 0].tolist() if voids else []
            require(1 + len(inner) == len(shells), "the number of shells of a solid")
            for number, shell in zip([outer, *inner], shells, strict=True):
                faces, _ = self.lists(np.array([number]), "CLOSED_SHELL('',", ")")
                own = self.nesting.faces_of_shell(shell)
                require(len(faces) == len(own), "the number of faces of a shell")
                result[own] = faces
        require(len(np.unique(result)) == len(result), "a face is listed twice")
        return result

    def _faces(self, numbers: Array) -> tuple[Array, Array, IntArray, IntArray]:
        """Bounds of all faces, surface and flag of each face, and its number of bounds."""
        table = self.table
        form = r"ADVANCED_FACE\('(?:[^']|'')*',\((#(?:,#)*)\),#,\.[TF]\.\)"
        at, n, template = self._match_lists(numbers, form, "a face")
        flag = np.array([1 if text.endswith(".T.)") else -1 for text in table.templates])[template]
        return table.values[_ranges(table.start[at], n)], table.values[table.start[at] + n], flag, n

    def _check_loops(self, bounds: Array, sense: IntArray) -> tuple[Array, Array]:
        """Edge (E,) and vertex (V,) entity of each edge and vertex, if the loops run as meant."""
        brep, table = self.brep, self.table
        faces, uses, edges = brep.faces, brep.uses, brep.edges
        at = table.positions(bounds)
        kinds = [table.templates[i] for i in range(len(table.templates))]
        outer = np.array([k == "FACE_OUTER_BOUND('',#,.T.)" for k in kinds])[table.template[at]]
        inner = np.array([k == "FACE_BOUND('',#,.T.)" for k in kinds])[table.template[at]]
        require(outer | inner, "there is another entity in place of a bound")
        require(np.add.reduceat(outer, faces.loop_start[:-1]) == 1, "the outer bound of a face")
        self.known[at] = True
        oriented, n = self.lists(table.values[table.start[at]], "EDGE_LOOP('',", ")")
        require(n == np.diff(faces.use_start), "the number of edges of a loop")
        loop = np.repeat(np.arange(len(n)), n)
        backwards = (np.repeat(sense, np.diff(faces.loop_start)) < 0)[loop]
        use = np.arange(len(uses))
        use = np.where(backwards, faces.use_start[loop] + faces.use_start[loop + 1] - 1 - use, use)
        forward = (uses.sense[use] > 0) != backwards
        at = table.positions(oriented)
        require(at >= 0, "an oriented edge is missing")
        templates = [f"ORIENTED_EDGE('',*,*,#,.{flag}.)" for flag in "FT"]
        direction = np.array([templates.index(k) if k in templates else -1 for k in kinds])[table.template[at]]
        require(direction == forward, "the direction of an edge in a loop")
        self.known[at] = True
        require(len(np.unique(oriented)) == len(oriented), "an oriented edge is used twice")
        edge = self._match(table.values[table.start[at]], uses.edge[use], len(edges), "edge")
        ends = self.rows(edge, "EDGE_CURVE('',#,#,#,.T.)")[:, :2]
        vertex = self._match(
            ends.ravel(), np.column_stack([edges.start, edges.end]).ravel(), len(brep.vertices), "vertex"
        )
        return edge, vertex

    @staticmethod
    def _match(numbers: Array, index: IntArray, count: int, kind: str) -> Array:
        """The entity of each of `count` items, given entities and items in pairs: one entity for one item."""
        entity = np.full(count, -1.0)
        entity[index] = numbers
        require(entity >= 0, f"the loops lack an {kind}")
        require(entity[index] == numbers, f"one {kind} is two in the file")
        require(len(np.unique(entity)) == count, f"two of the kind {kind} are one in the file")
        return entity

    # geometry

    def meant(self, points: Array) -> Array:
        """The coordinates that a file states for points."""
        return np.rint(points * 10.0**self.decimals) / 10.0**self.decimals

    def _check_edges(self, edge: Array, vertex: Array) -> None:
        """Positions of vertices, and the curves of edges."""
        brep = self.brep
        at = self.points(self.rows(vertex, "VERTEX_POINT('',#)")[:, 0])
        require(at == self.meant(brep.vertices), "the position of a vertex")
        ends = self.rows(edge, "EDGE_CURVE('',#,#,#,.T.)")
        for spline, own, local in self._curves:
            assert isinstance(spline, BSplineCurve)
            meant = self.meant(brep.edges.motion[own, None].apply(local))
            shape = (len(spline.poles),)
            poles = self._spline(ends[own, 2], "B_SPLINE_CURVE_WITH_KNOTS", [spline.degree], [spline.knots], shape)
            require(poles == meant, "a pole of a curve")
        straight = np.array([isinstance(c, BSplineCurve) and is_segment(c) for c in brep.curves], bool)
        own = np.flatnonzero(straight[brep.edges.curve])
        a, b = brep.vertices[brep.edges.start[own]], brep.vertices[brep.edges.end[own]]
        through, vector = self.rows(ends[own, 2], "LINE('',#,#)").T
        require(self.points(through) == self.meant(a), "the origin of a line")
        direction, length = self.rows(vector, "VECTOR('',#,&)").T
        require(agree(self.directions(direction) * length[:, None], b - a), "the direction of a line")
        for index in np.unique(brep.edges.curve).tolist():
            curve = brep.curves[index]
            if isinstance(curve, BSplineCurve):
                continue
            own = np.flatnonzero(brep.edges.curve == index)
            radii = [curve.radius] if isinstance(curve, Circle) else [curve.major, curve.minor]
            kind = "CIRCLE('',#,&)" if isinstance(curve, Circle) else "ELLIPSE('',#,&,&)"
            frames = curve.place_frames(brep.edges.motion[own])
            self._check_placements(ends[own, 2], kind, frames, np.tile(radii, (len(own), 1)))

    def _check_surfaces(self, surface: Array) -> None:
        """The surfaces of faces."""
        brep = self.brep
        for spline, own, local in self._surfaces:
            assert isinstance(spline, BSplineSurface)
            degrees, knots = [spline.degree_u, spline.degree_v], find_knots_in_file(spline)
            poles = self._spline(surface[own], "B_SPLINE_SURFACE_WITH_KNOTS", degrees, knots, spline.poles.shape[:2])
            require(poles == self.meant(brep.faces.motion[own, None].apply(local)), "a pole of a surface")
        for index in np.unique(brep.faces.carrier).tolist():
            carrier = brep.carriers[index]
            if isinstance(carrier, BSplineSurface):
                continue
            own = np.flatnonzero(brep.faces.carrier == index)
            motion, number = brep.faces.motion[own], surface[own]
            x, origin = motion.apply_to_vectors(np.tile(carrier.x_axis, (len(own), 1))), motion.apply(carrier.origin)
            if isinstance(carrier, Plane):
                y = motion.apply_to_vectors(np.tile(carrier.y_axis, (len(own), 1)))
                self._check_placements(
                    number, "PLANE('',#)", np.stack([origin, np.cross(x, y), x], 1), np.zeros((len(own), 0))
                )
                continue
            axis = motion.apply_to_vectors(np.tile(carrier.axis, (len(own), 1)))
            if isinstance(carrier, ConicalSurface):
                axis = axis if carrier.angle > 0 else -axis
            sizes, kind = _quadric_text(carrier)
            self._check_placements(number, kind, np.stack([origin, axis, x], 1), np.tile(sizes, (len(own), 1)))

    def _spline(
        self, numbers: Array, keyword: str, degrees: Sequence[int], knots: Sequence[Array], shape: tuple[int, ...]
    ) -> Array:
        """Poles (n, p, 3) of splines, whose degrees and knots must be those given."""
        listed = "(" + ",".join(["#"] * shape[-1]) + ")"
        listed = listed if len(shape) == 1 else "(" + ",".join([listed] * shape[0]) + ")"
        distinct, counts = zip(*(np.unique(k, return_counts=True) for k in knots), strict=True)
        marks = [*(["@"] * len(c) for c in counts), *(["&"] * len(c) for c in counts)]
        vectors = ",".join(f"({','.join(m)})" for m in marks)
        flags = ",".join([".F."] * (len(shape) + 1))
        first = ",".join(["@"] * len(degrees))
        rows = self.rows(numbers, f"{keyword}('',{first},{listed},.UNSPECIFIED.,{flags},{vectors},.UNSPECIFIED.)")
        fixed = np.concatenate([*counts, *distinct]).astype(float)
        require(rows[:, : len(degrees)] == np.array(degrees), "the degree of a spline")
        require(rows[:, rows.shape[1] - len(fixed) :] == fixed, "the knots of a spline")
        poles = rows[:, len(degrees) : rows.shape[1] - len(fixed)]
        return self.points(poles.ravel()).reshape(*poles.shape, 3)

    def _check_placements(self, numbers: Array, kind: str, frames: Array, sizes: Array) -> None:
        """Origin, axis and reference direction (n, 3, 3), and the sizes (n, m), of planes, quadrics and conics."""
        rows = self.rows(numbers, kind)
        read = self.frames(rows[:, 0])
        require(agree(read[:, 0], frames[:, 0]) & agree(read[:, 1:].reshape(-1, 6), frames[:, 1:].reshape(-1, 6)), kind)
        require(agree(rows[:, 1:], sizes), f"a size of {kind}")

    # what stands beside the solids

    def _check_totals(self) -> None:
        """No geometry or topology but that of the solids; volume and area are those of the boundary representation."""
        own = re.compile(
            r"ADVANCED_FACE|FACE_.*BOUND|EDGE_LOOP|ORIENTED_EDGE|EDGE_CURVE|VERTEX_POINT|VECTOR|LINE|B_SPLINE.*|CIRCLE|ELLIPSE|PLANE|"
            r".*_SURFACE|.*CLOSED_SHELL|MANIFOLD_SOLID_BREP|BREP_WITH_VOIDS"
        )
        kinds = [i for i, keyword in enumerate(self.keyword) if own.fullmatch(keyword)]
        require(self.known[np.isin(self.table.template, kinds)], "there is geometry that no face uses")
        moments = self.nesting.moments
        for name, kind, value in (
            ("volume measure", "VOLUME", float(integral_properties.volume(moments)[0])),
            ("surface area measure", "AREA", float(moments.area.sum())),
        ):
            template = f"MEASURE_REPRESENTATION_ITEM('{name}',{kind}_MEASURE(&),#)"
            found = [i for i, t in enumerate(self.table.templates) if t == template]
            at = np.flatnonzero(np.isin(self.table.template, found))
            stated = self.table.values[self.table.start[at]]
            require(len(at) and np.isclose(stated, value, rtol=ROUND_OFF, atol=0).any(), f"the stated {name}")

    def _check_styles(self, faces: Array) -> None:
        """No face has two colours, and nothing else has one."""
        at = self.with_keyword("STYLED_ITEM")
        item = self.table.values[self.table.start[at] + 1]
        require(np.isin(item, faces), "something besides a face has a colour")
        require(len(np.unique(item)) == len(item), "a face has two colours")


def _group_splines(
    items: Sequence[Carrier | EdgeCurve], placed: IntArray
) -> Iterator[tuple[BSplineCurve | BSplineSurface, IntArray, Array]]:
    """Splines that a file has poles of, by degrees, knots and numbers of poles: one of each kind, rows of `placed`, their poles.

    Thousands of fitted splines that are placed once each have a few kinds: compared one by one they took most of a check.
    """
    number: dict[tuple[Any, ...], int] = {}
    kind = np.full(len(items), -1)
    for i in np.unique(placed).tolist():
        item = items[i]
        if len(poles_of(item)):
            assert isinstance(item, BSplineCurve | BSplineSurface)
            knots = (item.knots,) if isinstance(item, BSplineCurve) else find_knots_in_file(item)
            kind[i] = number.setdefault((item.poles.shape, *(k.tobytes() for k in knots)), len(number))
    order = np.argsort(kind[placed], kind="stable")
    limits = np.searchsorted(kind[placed][order], np.arange(len(number) + 1))
    for k in range(len(number)):
        own = order[limits[k] : limits[k + 1]]
        used, row = np.unique(placed[own], return_inverse=True)
        nets = [poles_of(items[i]) for i in used.tolist()]
        first = items[int(used[0])]
        assert isinstance(first, BSplineCurve | BSplineSurface)
        yield first, own, np.stack(nets)[row]


def _ranges(start: IntArray, count: IntArray) -> IntArray:
    """The indices start[i] .. start[i] + count[i] - 1, one range after another."""
    ends = np.cumsum(count)
    return np.repeat(start - ends + count, count) + np.arange(int(count.sum()))


def _quadric_text(carrier: Any) -> tuple[Array, str]:
    """Sizes and template of a quadric."""
    if isinstance(carrier, ConicalSurface):
        return np.array([carrier.radius, abs(carrier.angle)]), "CONICAL_SURFACE('',#,&,&)"
    if isinstance(carrier, ToroidalSurface):
        return np.array([carrier.major, carrier.minor]), "TOROIDAL_SURFACE('',#,&,&)"
    assert isinstance(carrier, CylindricalSurface | SphericalSurface)
    kind = "CYLINDRICAL" if isinstance(carrier, CylindricalSurface) else "SPHERICAL"
    return np.array([carrier.radius]), f"{kind}_SURFACE('',#,&)"


_RELATION = (
    "(REPRESENTATION_RELATIONSHIP('','',#,#)REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#)"
    "SHAPE_REPRESENTATION_RELATIONSHIP())"
)


def check_placements(entities: EntityRows, levels: Sequence[Motion]) -> None:
    """KernelError unless the file places its part as the levels of an assembly say, innermost first, and nothing else."""
    read, meant = _read_placements(entities), compose_levels(levels)
    require(len(read) == len(meant), f"{len(read)} placements in place of {len(meant)}")
    require(agree(read.translation, meant.translation), "the place of a copy")
    require(agree(read.rotation.reshape(-1, 9), meant.rotation.reshape(-1, 9)), "the rotation of a copy")


def _read_placements(entities: EntityRows) -> Motion:
    """The places of all copies of the part, in the order of the file, the inner ones fastest."""
    table = entities.table
    used = table.number[entities.with_keyword("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION")]
    relation, usage_shape = entities.rows(used, "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#,#)").T
    part, whole, motion = entities.rows(relation, _RELATION).T
    origin, frame = entities.rows(motion, "ITEM_DEFINED_TRANSFORMATION('','',#,#)").T
    still = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    require(entities.frames(origin) == still, "the origin of a part")
    _check_usages(entities, usage_shape, part, whole)
    place, z, x = np.moveaxis(entities.frames(frame), 1, 0)
    placed = Motion(np.stack([x, np.cross(z, x), z], axis=-1), place)
    require(len(np.setdiff1d(part, whole)) == 1 and len(np.setdiff1d(whole, part)) == 1, "the tree of the assembly")
    (node,) = np.setdiff1d(part, whole)
    levels: list[Motion] = []
    for _ in np.unique(whole):
        own = part == node
        require(len(np.unique(whole[own])) == 1, "the tree of the assembly")
        levels.append(placed[own])
        node = whole[own][0]
    require(sum(map(len, levels)) == len(part), "the tree of the assembly")
    return compose_levels(levels)


def _check_usages(entities: EntityRows, usage_shape: Array, part: Array, whole: Array) -> None:
    """The product definitions of each usage are those of the representations that it relates."""
    table = entities.table
    shown = table.number[entities.with_keyword("SHAPE_DEFINITION_REPRESENTATION")]
    shape, representation = entities.rows(shown, "SHAPE_DEFINITION_REPRESENTATION(#,#)").T
    definition = entities.rows(shape, "PRODUCT_DEFINITION_SHAPE('','',#)")[:, 0]
    of_representation = dict(zip(representation.tolist(), definition.tolist(), strict=True))
    usage = entities.rows(usage_shape, "PRODUCT_DEFINITION_SHAPE('Placement','Placement of an item',#)")[:, 0]
    at = table.positions(usage)
    every = entities.with_keyword("NEXT_ASSEMBLY_USAGE_OCCURRENCE")
    require(np.array_equal(np.sort(at), np.sort(every)), "the usages of a part")
    relating, related = table.values[table.start[at][:, None] + np.arange(2)].T
    require(relating == [of_representation.get(n) for n in whole.tolist()], "the assembly of a usage")
    require(related == [of_representation.get(n) for n in part.tolist()], "the part of a usage")
