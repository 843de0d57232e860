"""Pieces of periodic solids in space: closed forms, and laws of periods."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.topology import PeriodicPieces, periodic_pieces

CONVENTIONS = ("strict", "top_cells")


def samples(name: str, n: int, length: float = 1.0) -> np.ndarray:
    axis = length * np.arange(n) / n
    return fields.tpms(name, 1.0)(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1))


@pytest.mark.parametrize(("name", "joined"), [("schwarz_p", -1.0), ("gyroid", -np.sqrt(2)), ("diamond", -1.0)])
def test_the_saddle_that_joins_a_network_lies_between_both_conventions(name: str, joined: float) -> None:
    early, late = (periodic_pieces(samples(name, 24), c).one_piece_levels[0, 0] for c in ("top_cells", "strict"))
    assert early <= joined + 1e-12
    assert joined <= late + 1e-12 < joined + 0.06
    assert periodic_pieces(samples(name, 24)).count_at(0.0) == 1


def test_balls_that_repeat_are_pieces_without_end_and_below_them_is_nothing() -> None:
    found = periodic_pieces(samples("schwarz_p", 16))
    assert (found.count_at(-3.1), found.count_at(-2.0), found.count_at(0.0)) == (None, 0, 1)


def test_rods_and_layers_that_span_no_volume_are_without_end() -> None:
    x = np.cos(2 * np.pi * np.arange(8) / 8)
    layers = np.broadcast_to(x[:, None, None], (8, 7, 6))
    rods = np.broadcast_to((x[:, None] + x[None, :7])[..., None], (8, 7, 6))
    for values in (layers, rods):
        assert periodic_pieces(values).count_at(-0.5) == 0
        assert periodic_pieces(values).counts[-1] == 1  # all is solid


def test_networks_that_a_translation_exchanges_are_two_though_they_are_one_component_of_a_period() -> None:
    """The diamond surface moved by half a cell along an axis is itself, with its sides exchanged."""
    half = -np.abs(samples("diamond", 16, 0.5))
    whole = -np.abs(samples("diamond", 32))
    assert periodic_pieces(half).count_at(-0.4) == periodic_pieces(whole).count_at(-0.4) == 2


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(0, 5), min_size=4 * 5 * 4, max_size=4 * 5 * 4),
    st.sampled_from(CONVENTIONS),
    st.tuples(st.integers(0, 3), st.integers(0, 4), st.integers(0, 3)),
    st.tuples(st.integers(1, 2), st.integers(1, 2), st.integers(1, 3)),
)
def test_where_a_period_begins_and_how_many_are_sampled_does_not_matter(
    numbers: list[int], convention: str, shift: tuple[int, int, int], repeats: tuple[int, int, int]
) -> None:
    values = np.array(numbers, float).reshape(4, 5, 4)
    found = periodic_pieces(values, convention)
    for other in (np.roll(values, shift, (0, 1, 2)), np.tile(values, repeats), values.transpose(1, 2, 0)):
        assert_same(periodic_pieces(other, convention), found)


def assert_same(found: PeriodicPieces, expected: PeriodicPieces) -> None:
    np.testing.assert_array_equal(found.levels, expected.levels)
    np.testing.assert_array_equal(found.counts, expected.counts)


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="5 x 3 x 5 samples are too few: at least 4"):
        periodic_pieces(np.zeros((5, 3, 5)))
