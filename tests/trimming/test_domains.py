"""The wall of a sheet lattice and its two channels, rebuilt from one arrangement, fill the body and share their faces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.shapes import round_shapes as shapes
from tests.shapes.misfits import volume
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.trimming.operands.polyhedra import box
from tpmscad.trimming.rebuild.trimmed_brep import LatticeDomain, TrimmedDomains
from tpmscad.trimming.trim_pipeline import trim, trim_domains

BODIES = {
    "box": (lambda: box(np.array([1.3, 2.1, 1.7]), np.array([8.2, 9.1, 7.9])), 6.9 * 7.0 * 6.2),
    "sphere": (lambda: shapes.sphere(3.9, translation=(5.1, 4.8, 5.3)), 4 / 3 * np.pi * 3.9**3),
}


@pytest.fixture(scope="module", params=BODIES)
def trimmed(
    request: pytest.FixtureRequest, cover: Callable[..., Brep]
) -> tuple[Brep, Brep, list[LatticeDomain], TrimmedDomains, float]:
    """Lattice, body, wall and channels as domains, these trimmed, and the body's volume."""
    lattice = cover("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (-0.03, 0.05))
    make, expected = BODIES[request.param]
    body = make()
    domains = [
        LatticeDomain(np.arange(len(lattice.faces)), 1),
        *(LatticeDomain(lattice.faces_with_tag(tag), -1) for tag in ("offset+", "offset-")),
    ]
    return lattice, body, domains, trim_domains(lattice, body, domains)[0], expected


@pytest.mark.slow
def test_each_domain_is_what_a_trim_of_its_own_gives(trimmed: tuple) -> None:
    lattice, body, domains, found, _ = trimmed
    for domain, brep in zip(domains, found.breps, strict=True):
        alone = trim(domain.select(lattice), body).brep
        assert len(brep.faces) == len(alone.faces)
        assert len(brep.edges) == len(alone.edges)
        np.testing.assert_allclose(volume(brep), volume(alone), rtol=1e-9)


@pytest.mark.slow
def test_domains_are_closed_and_fill_the_body(trimmed: tuple) -> None:
    *_, found, expected = trimmed
    assert all(connectivity.is_closed(brep) for brep in found.breps)
    assert sum(volume(brep) for brep in found.breps) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_faces_on_the_lattice_are_shared_by_the_wall_and_one_channel(trimmed: tuple) -> None:
    lattice, *_, found, _ = trimmed
    caps = found.shared.faces.tag >= len(lattice.tags)
    count = np.bincount(np.concatenate(found.members), minlength=len(found.shared.faces))
    np.testing.assert_array_equal(count, np.where(caps, 1, 2))
    for brep, members in zip(found.breps, found.members, strict=True):
        np.testing.assert_array_equal(found.shared.faces.carrier[members], brep.faces.carrier)
    wall, plus, minus = (set(m.tolist()) for m in found.members)
    assert wall & plus
    assert wall & minus
    assert not plus & minus
