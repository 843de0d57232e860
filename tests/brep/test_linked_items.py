"""Connected components of linked items, against the closure of the relation."""

from __future__ import annotations

import numpy as np

from tpmscad.brep.linked_items import label_linked, label_sharing

RNG = np.random.default_rng(8)
N = 60
PAIRS = RNG.integers(0, N, (45, 2))


def reach(n: int, pairs: np.ndarray) -> np.ndarray:
    """Whether one item reaches another: the closure of the relation, by squaring its matrix."""
    linked = np.eye(n, dtype=bool)
    linked[pairs[:, 0], pairs[:, 1]] = linked[pairs[:, 1], pairs[:, 0]] = True
    for _ in range(n):
        linked = linked @ linked
    return linked


def test_two_items_have_one_label_if_and_only_if_links_lead_from_one_to_the_other() -> None:
    label = label_linked(N, PAIRS)
    np.testing.assert_array_equal(label[:, None] == label, reach(N, PAIRS))


def test_components_are_numbered_in_the_order_of_their_first_items() -> None:
    label = label_linked(N, PAIRS)
    _, first = np.unique(label, return_index=True)
    assert first.tolist() == sorted(first.tolist())
    assert label_linked(3, np.zeros((0, 2), np.int64)).tolist() == [0, 1, 2]


def test_items_with_a_number_in_common_are_in_one_component() -> None:
    item, shared = RNG.integers(0, N, 70), RNG.integers(0, 40, 70)
    pairs = np.array([(a, b) for a, s in zip(item, shared, strict=True) for b in item[shared == s]])
    np.testing.assert_array_equal(label_sharing(N, item, shared), label_linked(N, pairs))
    assert label_sharing(2, np.zeros(0, np.int64), np.zeros(0, np.int64)).tolist() == [0, 1]
