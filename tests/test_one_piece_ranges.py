"""The stored ranges in which structures are one piece: closed forms, independent counts, and what requests outside them say."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad import cli, fields, surfaces, topology
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.fields.kinds import one_piece_ranges
from tpmscad.fields.kinds.one_piece_ranges import find_level_ranges, find_sheet_limit, is_one_piece, note_sheet
from tpmscad.fields.kinds.strut_graphs import make_strut_graph
from tpmscad.lattices.strut_contacts import find_contact
from tpmscad.strut_cells import KINDS, LARGEST_DIAMETERS

N = 32
BOTH = [(name, reference) for name, record in surfaces.CATALOGUE.items() for reference in record.references]


def samples(name: str, reference: str) -> np.ndarray:
    axis = np.arange(N) / N
    return fields.tpms(name, 1.0, reference=reference).value_and_gradient_on_grid(axis, axis, axis)[0]


def test_saddles_of_the_cubic_surfaces_have_closed_forms() -> None:
    """cos x + cos y + cos z joins at (0, pi, pi); the gyroid at -sqrt 2, the diamond at -1; Neovius at -3/4."""
    for name, level in (("schwarz_p", 1.0), ("gyroid", math.sqrt(2)), ("diamond", 1.0), ("neovius", 0.75)):
        for side, sign in (("-", -1), ("+", 1)):
            (found,) = find_level_ranges(name, "nodal", side)
            assert found.level == pytest.approx(sign * level, abs=1e-6)
        assert find_sheet_limit(name, "nodal") == pytest.approx(level, abs=1e-6)


@pytest.mark.parametrize(("name", "reference"), BOTH)
@pytest.mark.slow
def test_a_coarse_grid_counts_one_piece_well_within_every_range_and_not_outside(name: str, reference: str) -> None:
    """Levels nearer to an end than the two connectivities tell apart are left out."""
    values = samples(name, reference)
    judged = 0
    for side, sign in (("-", 1), ("+", -1)):
        early, late = (topology.periodic_pieces(sign * values, each) for each in ("top_cells", "strict"))
        for level in np.linspace(values.min(), values.max(), 41)[1:-1]:
            counts = early.count_at(sign * level), late.count_at(sign * level)
            if counts[0] != counts[1]:
                continue
            margin = 0.02 * np.ptp(values)
            ends = [end for each in find_level_ranges(name, reference, side) for end in (each.level, each.to_level)]
            if min(abs(level - end) for end in ends) > margin:
                assert is_one_piece(name, reference, side, float(level)) == (counts[0] == 1), (side, level, counts)
                judged += 1
    assert judged > 40


@pytest.mark.parametrize(("name", "reference"), [("schwarz_p", "nodal"), ("frd", "nodal"), ("octo", "nodal")])
def test_ranges_that_nobody_stored_are_measured(name: str, reference: str) -> None:
    """At first use, on one grid: what a new surface of the catalogue has until its row is printed."""
    slack = 0.01 * np.ptp(surfaces.CATALOGUE[name].value_range)
    for side in "-+":
        measured = one_piece_ranges._measure_ranges(name, reference, side)
        stored = find_level_ranges(name, reference, side)
        assert len(measured) == len(stored)
        for row, kept in zip(measured, stored, strict=True):
            np.testing.assert_allclose(row[:2], (kept.level, kept.to_level), rtol=0, atol=slack)
            np.testing.assert_allclose(row[2:], (kept.fraction, kept.to_fraction), rtol=0, atol=0.02)


def test_fractions_are_those_of_the_levels() -> None:
    found = find_level_ranges("diamond", "nodal", "-")[0]
    rods = fields.rod(fields.tpms("diamond", 1.0), found.level)
    assert fields.volume_fraction(rods) == pytest.approx(found.fraction, abs=1e-4)


def test_structures_in_several_pieces_say_so_and_name_the_limit() -> None:
    phi = fields.tpms("schwarz_p", 10.0)
    for balls in (fields.rod(phi, -1.5), fields.pore(phi, 1.5)):
        (note,) = collect_notes(balls)
        assert "the solid of the schwarz_p is not one piece" in note
        assert "1 (volume fraction 0.213) on" in note
    (note,) = collect_notes(fields.rod(phi, 1.5))
    assert "the void of the schwarz_p is not one piece" in note
    shells = collect_notes(fields.sheet(phi, 1.2, 1.5))
    assert "one piece if it holds a level from -1 to 1" in shells[0]
    assert "the channel on the side +" in shells[1]
    assert len(note_sheet("schwarz_p", "nodal", -1.2, 1.2)) == 2


def test_structures_of_one_piece_have_no_note() -> None:
    for name, reference in BOTH:
        phi = fields.tpms(name, 1.0, reference=reference)
        limit = 0.9 * find_sheet_limit(name, reference)
        assert not collect_notes(fields.sheet(phi, -limit, limit)), name
        assert not collect_notes(fields.rod(phi, fields.ramp("x", (0, 1), (-0.1, 0.1))))


@pytest.mark.parametrize("kind", KINDS)
def test_struts_are_one_graph_and_touch_first_at_the_stored_diameter(kind: str) -> None:
    points, edges = make_strut_graph(kind, 1.0, 3)
    graph = coo_array((np.ones(len(edges)), tuple(edges.T)), shape=(len(points),) * 2)
    labels = connected_components(graph, directed=False)[1]
    middle = ((points >= 1.0) & (points <= 2.0)).all(axis=1)
    assert len(np.unique(labels[middle])) == 1  # and of neighbours, which share nodes
    points, edges = make_strut_graph(kind, 1.0, 2)
    contact = find_contact(points, edges, np.full(len(points), 0.15), np.zeros(len(points)))
    assert contact is not None
    assert 0.3 * contact.ratio == pytest.approx(LARGEST_DIAMETERS[kind], rel=1e-6)


def test_the_catalogue_shows_the_ranges(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["surfaces"])
    shown = capsys.readouterr().out
    assert "schwarz_p       nodal      0.213-1" in shown
    assert "octet                 0.4082 cell" in shown
    with pytest.raises(SystemExit):
        cli.main(["surfaces", "--json"])
    rows = {row["name"]: row["one_piece"] for row in json.loads(capsys.readouterr().out)}
    assert rows["schwarz_p"]["nodal"]["-"] == [{"levels": [-1.0, None], "volume_fractions": [0.2133, 1.0]}]
