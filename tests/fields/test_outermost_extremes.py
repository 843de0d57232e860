"""Fields with their minima and maxima outermost: the same solid, from leaves whose signs decide; leaves that are quadrics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpmscad import fields
from tpmscad.fields.analysis.exact_leaves import StrutLeaf, find_exact, find_quadric
from tpmscad.fields.analysis.outermost_extremes import (
    combine_solids,
    expose_extremes,
    list_leaves,
    replace_leaves,
)
from tpmscad.fields.analysis.volume_quadrature import integrate_volume
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.primitive_regions import BoxRegion

POINTS = np.random.default_rng(4).uniform(-3, 3, (4000, 3))

PRIMITIVES = (
    fields.sphere((0.3, -0.2, 0.4), 1.7),
    fields.cylinder((0.1, 0.2, 0.3), 1.1, (1, 2, 2), 2.5),
    fields.cylinder((0, 0.4, 0), 0.9, "y"),
    fields.box((-1, -2, -0.5), (2, 1, 1.5)),
    fields.halfspace((0.5, 0, 0), (1, 1, 0.3)),
    fields.tpms("gyroid", 4.0) - 0.2,
)


def trees() -> st.SearchStrategy[Field]:
    """Random trees of the operations through which minima and maxima pass."""

    def extend(inner: st.SearchStrategy[Field]) -> st.SearchStrategy[Field]:
        return st.one_of(
            st.builds(fields.union, inner, inner),
            st.builds(fields.intersection, inner, inner),
            st.builds(fields.difference, inner, inner),
            st.builds(fields.complement, inner),
            st.builds(lambda f, a: f + a, inner, st.floats(-0.3, 0.3)),
            st.builds(lambda f, a: f * a, inner, st.sampled_from([-2.0, 0.5, 3.0])),
            st.builds(lambda f, a: fields.translate(f, (a, 0.2, -a)), inner, st.floats(-1, 1)),
            st.builds(lambda f, a: fields.rotate(f, "z", a), inner, st.floats(-180, 180)),
            st.builds(lambda f, g: fields.smooth_union(f, g, 0.4), inner, inner),
        )

    return st.recursive(st.sampled_from(PRIMITIVES), extend, max_leaves=5)


@settings(deadline=None, max_examples=60)
@given(trees())
def test_it_is_the_same_solid_and_its_leaves_decide(field: Field) -> None:
    exposed = expose_extremes(field)
    assert not any(isinstance(leaf, MinMaxField | BoxRegion) for leaf in list_leaves(exposed))
    expected = field(POINTS)
    clear = np.abs(expected) > 1e-9
    leaves = list_leaves(exposed)
    values = np.array([leaf(POINTS) for leaf in leaves])
    assert np.array_equal((exposed(POINTS) < 0)[clear], (expected < 0)[clear])
    assert np.array_equal(combine_solids(exposed, values < 0)[clear], (expected < 0)[clear])
    np.testing.assert_allclose(expose_extremes(field, True)(POINTS), expected, atol=1e-12)
    assert list_leaves(replace_leaves(exposed, leaves)) == leaves


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: fields.sphere((1, 2, 3), 2.0) + 0.5, "sphere"),
        (lambda: 0.25 - 3 * fields.sphere((1, 2, 3), 2.0), "sphere"),
        (lambda: fields.translate(fields.cylinder((1, 0, 0), 1.0, "y"), (0, 1, 2)) * 0.5 - 0.1, "cylinder"),
        (lambda: fields.scale(fields.rotate(fields.cylinder((1, 0, 0), 1.0, (1, 1, 0)), "x", 30), 1.5), "cylinder"),
        (lambda: -fields.rotate(fields.halfspace((1, 0, 2), (1, 2, 3)), "y", 70) + 0.3, "plane"),
    ],
)
def test_the_quadric_of_a_moved_field_has_its_level_set(make: Callable[[], Field], kind: str) -> None:
    field = make()
    found = find_quadric(field)
    assert found is not None
    assert found.kind == kind
    offset = POINTS - found.point
    if kind == "plane":
        distance = offset @ found.axis
    elif kind == "sphere":
        distance = np.linalg.norm(offset, axis=1) - found.radius
    else:
        distance = np.linalg.norm(np.cross(offset, found.axis), axis=1) - found.radius
    np.testing.assert_allclose(field(POINTS), found.sign * found.slope * distance, atol=1e-9)


TRIPOD = fields.struts([[0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 3]], [[0, 1], [0, 2], [0, 3]], 0.8, node_radius=0.7)
MIRRORED = AffineTransformedField(TRIPOD, ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (1.0, 0.0, 0.0), 1.0)


@pytest.mark.parametrize(
    "field",
    [
        fields.translate(TRIPOD, (0, 0, 0)),
        fields.complement(fields.translate(TRIPOD, (2**0.5, 3**0.5, 1))),
        fields.rotate(fields.rotate(TRIPOD, "z", 10), (1, 2, 3), 33),
        fields.scale(fields.rotate(TRIPOD, "x", 10), 0.9) - 0.1,
        0.5 * MIRRORED + 0.1,
    ],
    ids=["translated", "complement", "rotated", "scaled", "mirrored"],
)
def test_struts_that_are_moved_reversed_and_offset_are_struts(field: Field) -> None:
    found = find_exact(field)
    assert isinstance(found, StrutLeaf)
    np.testing.assert_allclose(field(POINTS), found.sign * found.slope * found.struts(POINTS), atol=1e-12)


@pytest.mark.parametrize(
    "field",
    [
        fields.tpms("gyroid", 4.0),
        TRIPOD + 0.5,
        AffineTransformedField(TRIPOD, ((1.0, 0.0, 0.0), (0.0, 1.1, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0), 1.0),
        fields.sphere((0, 0, 0), 1.0) * fields.halfspace((0, 0, 0), "z"),
        fields.sphere((0, 0, 0), 1.0) + 1.5,
        fields.smooth_union(fields.sphere((0, 0, 0), 1.0), fields.sphere((1, 0, 0), 1.0), 0.2),
    ],
)
def test_other_fields_are_not_exact(field: Field) -> None:
    assert find_exact(field) is None


LENS = np.pi * (4 + 0.8) * (2 - 0.8) ** 2 / 12
PAIR = fields.sphere((0, 0, 0), 1.0), fields.sphere((0.8, 0, 0), 1.0)
CROSS = [fields.cylinder((0, 0, 0), 1.0, axis) for axis in "xy"]


@pytest.mark.parametrize(
    ("field", "volume"),
    [
        (fields.union(*PAIR), 8 * np.pi / 3 - LENS),
        (fields.intersection(*PAIR), LENS),
        (fields.complement(fields.union(*PAIR)), 64 - 8 * np.pi / 3 + LENS),
        (fields.union(*CROSS), 8 * np.pi - 16 / 3),
        (fields.intersection(*CROSS), 16 / 3),
        (fields.cylinder((0, 0, 0), 1.0, (1, 1, 1)) & fields.box((-1.5,) * 3, (1.5,) * 3), None),
    ],
)
@pytest.mark.slow
def test_volumes_of_solids_that_cross_are_those_of_one_field(field: Field, volume: float | None) -> None:
    lo, hi = np.full(3, -2.0), np.full(3, 2.0)
    found, error = integrate_volume(field, lo, hi, 4 / 64)
    if volume is None:
        rng = np.random.default_rng(0)
        sample = rng.uniform(-2, 2, (400_000, 3))
        volume = float((field(sample) < 0).mean() * 64)
        assert found == pytest.approx(volume, rel=0.02)
        return
    assert found == pytest.approx(volume, rel=3e-4)
    assert abs(found - volume) < max(error, 1e-3 * volume)
