"""Rules of topology and solids (ISO 10303-42, -511, -514), the labels those of AP214 and AP242.

Evaluated: every WHERE rule of the entities in the table that can fail, and of the informal propositions that a closed shell uses
each of its edges once either way. Not evaluated: those about what the table has no entity for, which hold of every file that
passes the types (mapped items, polylines and loops of them, swept and oriented surfaces, faceted solids), and the
other informal propositions, which only the geometry can tell: curves on their surfaces, loops that do not cross, manifolds.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from tests.part21.model import Item
from tests.part21.rules import one_of, rule


def ends(edge: Item) -> tuple[Item, Item]:
    """Start and end; those of an oriented edge are derived from its element's."""
    if "oriented_edge" in edge.types:
        start, end = ends(edge["edge_element"])
        return (start, end) if edge["orientation"] else (end, start)
    return edge["edge_start"], edge["edge_end"]


@rule("oriented_edge", "WR1")
def orients_no_oriented_edge(item: Item) -> bool:
    return "oriented_edge" not in item["edge_element"].types


@rule("path", "WR1")
def runs_head_to_tail(item: Item) -> bool:
    joints = [ends(e) for e in item["edge_list"]]
    return all(before[1] is after[0] for before, after in zip(joints, joints[1:], strict=False))


@rule("edge_loop", "WR1")
def ends_where_it_starts(item: Item) -> bool:
    return ends(item["edge_list"][0])[0] is ends(item["edge_list"][-1])[1]


@rule("face", "WR2")
def has_one_outer_bound_at_most(item: Item) -> bool:
    return sum("face_outer_bound" in b.types for b in item["bounds"]) <= 1


@rule("advanced_face", "WR1")
def lies_on_an_elementary_or_b_spline_surface(item: Item) -> bool:
    return one_of(item["face_geometry"], "elementary_surface", "b_spline_surface", "swept_surface")


def edges(face: Item) -> list[Item]:
    return [e for b in face["bounds"] if "edge_loop" in b["bound"].types for e in b["bound"]["edge_list"]]


@rule("advanced_face", "WR2")
def is_bounded_by_edges_on_curves(item: Item) -> bool:
    return all("edge_curve" in e["edge_element"].types for e in edges(item))


@rule("advanced_face", "WR3")
def is_bounded_by_lines_conics_and_b_splines(item: Item) -> bool:
    kinds = ("line", "conic", "polyline", "surface_curve", "b_spline_curve")
    curves = (e["edge_element"]["edge_geometry"] for e in edges(item) if "edge_curve" in e["edge_element"].types)
    return all(one_of(c, *kinds) for c in curves)


@rule("advanced_face", "WR4")
def has_corners_at_points(item: Item) -> bool:
    return all(
        "vertex_point" in v.types and "cartesian_point" in v["vertex_geometry"].types
        for e in edges(item)
        for v in ends(e)
    )


@rule("advanced_face", "WR7")
def has_vertex_loops_at_points(item: Item) -> bool:
    corners = [b["bound"]["loop_vertex"] for b in item["bounds"] if "vertex_loop" in b["bound"].types]
    return all("vertex_point" in v.types and "cartesian_point" in v["vertex_geometry"].types for v in corners)


@rule("advanced_face", "WR8")
def is_bounded_by_edge_loops(item: Item) -> bool:
    return all(one_of(b["bound"], "edge_loop", "vertex_loop") for b in item["bounds"])


@rule("advanced_face", "WR9")
def has_parameter_curves_beside_curves_on_surfaces(item: Item) -> bool:
    curves = (e["edge_element"]["edge_geometry"] for e in edges(item) if "edge_curve" in e["edge_element"].types)
    return all("pcurve" in a.types for c in curves if "surface_curve" in c.types for a in c["associated_geometry"])


@rule("oriented_closed_shell", "WR1")
def orients_no_oriented_shell(item: Item) -> bool:
    return "oriented_closed_shell" not in item["closed_shell_element"].types


@rule("closed_shell", "each edge once either way")
def has_each_edge_once_either_way(item: Item) -> bool:
    uses: Counter[Any] = Counter()
    for bound in (b for face in item["cfs_faces"] or [] for b in face["bounds"] if "edge_loop" in b["bound"].types):
        uses.update(
            (e["edge_element"].number, e["orientation"] == bound["orientation"]) for e in bound["bound"]["edge_list"]
        )
    return all(uses[edge, True] == uses[edge, False] == 1 for edge, _ in list(uses))


def shells(solid: Item) -> list[Item]:
    """Those with faces of their own: the outer one and what the voids are made of."""
    voids = solid["voids"] if "brep_with_voids" in solid.types else []
    return [solid["outer"], *(v["closed_shell_element"] for v in voids)]


def solids(representation: Item) -> list[Item]:
    return [i for i in representation["items"] if "manifold_solid_brep" in i.types]


@rule("advanced_brep_shape_representation", "WR1")
def holds_solids_and_placements(item: Item) -> bool:
    kinds = ("manifold_solid_brep", "faceted_brep", "mapped_item", "axis2_placement_3d")
    return all(one_of(i, *kinds) for i in item["items"])


@rule("advanced_brep_shape_representation", "WR2")
def holds_a_solid(item: Item) -> bool:
    return any(one_of(i, "manifold_solid_brep", "mapped_item") for i in item["items"])


@rule("advanced_brep_shape_representation", "WR3")
def has_advanced_faces_only(item: Item) -> bool:
    return all(
        "advanced_face" in f.types for solid in solids(item) for s in shells(solid) for f in s["cfs_faces"] or []
    )


@rule("advanced_brep_shape_representation", "WR4")
def has_outer_shells_as_they_are(item: Item) -> bool:
    return all("oriented_closed_shell" not in solid["outer"].types for solid in solids(item))


@rule("advanced_brep_shape_representation", "WR5")
def has_voids_turned_over(item: Item) -> bool:
    return not any(v["orientation"] for s in solids(item) if "brep_with_voids" in s.types for v in s["voids"])
