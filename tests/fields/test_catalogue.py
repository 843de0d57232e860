"""The triply periodic surfaces: their formulas, symmetries, ranges and names."""

from __future__ import annotations

import inspect
from itertools import permutations, product

import numpy as np
import pytest
from numpy import cos, sin
from scipy.optimize import minimize

from tpmscad import fields, surfaces
from tpmscad.errors import InvalidRequest

RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-20, 30, (500, 3))


def written_out(name: str, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The formulas as the literature prints them, in NumPy."""
    cx, cy, cz, sx, sy, sz = cos(x), cos(y), cos(z), sin(x), sin(y), sin(z)
    c2x, c2y, c2z, s2x, s2y, s2z = cos(2 * x), cos(2 * y), cos(2 * z), sin(2 * x), sin(2 * y), sin(2 * z)
    return {
        "gyroid": sx * cy + sy * cz + sz * cx,
        "diamond": sx * sy * sz + sx * cy * cz + cx * sy * cz + cx * cy * sz,
        "schwarz_p": cx + cy + cz,
        "iwp": 2 * (cx * cy + cy * cz + cz * cx) - (c2x + c2y + c2z),
        "neovius": 3 * (cx + cy + cz) + 4 * cx * cy * cz,
        "frd": 4 * cx * cy * cz - (c2x * c2y + c2y * c2z + c2z * c2x),
        "lidinoid": 0.5 * (s2x * cy * sz + s2y * cz * sx + s2z * cx * sy)
        - 0.5 * (c2x * c2y + c2y * c2z + c2z * c2x)
        + 0.15,
        "split_p": 1.1 * (s2x * cy * sz + s2y * cz * sx + s2z * cx * sy)
        - 0.2 * (c2x * c2y + c2y * c2z + c2z * c2x)
        - 0.4 * (c2x + c2y + c2z),
        "fischer_koch_s": c2x * sy * cz + cx * c2y * sz + sx * cy * c2z,
        "octo": 0.6 * (cx * cy + cy * cz + cz * cx) - 0.4 * (cx + cy + cz) + 0.25,
    }[name]


GROUPS = {
    # operations in the cubic cell, lattice translations among them, proper rotations of the point group, inversion
    "I4_132 (214)": (48, 2, 24, False),
    "Fd-3m (227)": (192, 4, 24, True),
    "Pm-3m (221)": (48, 1, 24, True),
    "Im-3m (229)": (96, 2, 24, True),
    "Fm-3m (225)": (192, 4, 24, True),
    "Ia-3d (230)": (96, 2, 24, True),
    "Ia-3 (206)": (48, 2, 12, True),
    "I-43d (220)": (48, 2, 12, False),
}
MIRRORED = {"Pm-3m (221)", "Im-3m (229)", "Fm-3m (225)"}
"""Groups with mirrors x -> const - x, where those with the same counts above have glides."""

TURNS = [np.eye(3)[list(p)] * np.array(s)[:, None] for p in permutations(range(3)) for s in product((1, -1), repeat=3)]
SHIFTS = np.array(list(product(range(8), repeat=3))) / 8


@pytest.fixture(params=fields.TPMS)
def info(request: pytest.FixtureRequest) -> fields.SurfaceRecord:
    return fields.TPMS[request.param]


def test_the_formula_that_is_printed_is_the_one_that_is_evaluated(info: fields.SurfaceRecord) -> None:
    period, phase = np.array((3.0, 4.0, 5.0)), np.array((0.1, 0.2, -0.3))
    expected = written_out(info.name, *(2 * np.pi * (POINTS / period - phase)).T)
    np.testing.assert_allclose(fields.tpms(info.name, period, phase)(POINTS), expected, rtol=0, atol=5e-13)


def test_the_space_group_is_the_one_stated(info: fields.SurfaceRecord) -> None:
    field, points = fields.tpms(info.name, 1.0), RNG.random((12, 3))
    value = field(points)[:, None]
    kept = {
        turn: np.flatnonzero(np.abs(field((points @ TURNS[turn].T)[:, None] + SHIFTS) - value).max(axis=0) < 1e-9)
        for turn in range(len(TURNS))
    }
    group = [turn for turn, shifts in kept.items() if len(shifts)]
    of = {tuple(TURNS[turn].ravel()): kept[turn] for turn in group}
    counts = (
        sum(len(shifts) for shifts in kept.values()),
        len(of[tuple(np.eye(3).ravel())]),
        sum(np.linalg.det(TURNS[turn]) > 0 for turn in group),
        tuple(-np.eye(3).ravel()) in of,
    )
    assert counts == GROUPS[info.space_group]
    mirrors = SHIFTS[of.get(tuple(np.diag((-1.0, 1.0, 1.0)).ravel()), np.empty(0, int))]
    assert bool(len(mirrors) and (mirrors[:, 1:] == 0).all(axis=1).any()) == (info.space_group in MIRRORED)


def test_the_range_is_attained_and_not_exceeded(info: fields.SurfaceRecord) -> None:
    field = fields.tpms(info.name, 1.0)
    t = (np.arange(48) + 0.37) / 48
    samples = field.on_grid(t, t, t)
    extremes = []
    for sign in (1, -1):
        starts = np.argsort(sign * samples, axis=None)[:60:6]
        found = min(
            minimize(
                lambda p, sign=sign: sign * float(field(p)),
                t[np.array(np.unravel_index(start, samples.shape))],
                jac=lambda p, sign=sign: sign * field.gradient(p),
                options={"gtol": 1e-10},
            ).fun
            for start in starts
        )
        extremes.append(sign * found)
    assert extremes == pytest.approx(info.value_range, abs=1e-12)
    low, high = info.value_range
    assert samples.min() >= low - 1e-12
    assert samples.max() <= high + 1e-12


def test_every_entry_cites_the_surface_and_its_formula(info: fields.SurfaceRecord) -> None:
    assert info.source
    assert info.formula_source
    assert info.title


def test_fields_and_surfaces_read_one_catalogue() -> None:
    assert fields.TPMS is surfaces.CATALOGUE
    assert inspect.unwrap(fields.find_surface) is inspect.unwrap(surfaces.find_surface)


@pytest.mark.parametrize("period", [0, -1.0, np.nan, np.inf, (1, 2), (1, 2, 0), "wide"])
def test_periods_must_be_positive(period: object) -> None:
    with pytest.raises(InvalidRequest, match="period"):
        fields.tpms("gyroid", period)
