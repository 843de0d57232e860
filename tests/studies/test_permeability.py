"""Slow flow through periodic channels."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tests.cli.test_cli_end_to_end import list_warnings
from tpmscad.simulation.permeability import permeability
from tpmscad.studies._permeability import ChannelPermeability

pytestmark = [pytest.mark.kernel, pytest.mark.slow]


def test_a_channel_of_schwarz_p_lets_through_what_was_published() -> None:
    """Jung and Torquato, Phys. Rev. E 72 (2005) 056319: 3.4765e-3 cells squared at porosity 1/2, by a grid method.

    Finer meshes tend to a value 3 % below it.
    """
    pytest.importorskip("gmsh")
    pytest.importorskip("skfem")
    channel = tpmscad.lattice("P", cell=2.0, volume_fraction=0.5, kind="skeletal")
    found = tpmscad.permeability(channel, size=0.36)
    np.testing.assert_allclose(found.permeability, 4 * 3.4765e-3 * np.eye(3), atol=4 * 3.4765e-3 * 0.04)
    assert found.porosity == pytest.approx(0.5, rel=1e-6)
    assert 0.0 < found.error < 0.1


def test_a_channel_of_fluid_domains_lets_through_what_the_solid_on_its_side_of_the_wall_does() -> None:
    """The two routes share neither faces nor meshes: a body cut in three, and a skeletal lattice in a box."""
    pytest.importorskip("gmsh")
    pytest.importorskip("skfem")
    body = bd.Box(10, 10, 10, align=bd.Align.MIN)
    domains = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1, tol=0.02, phase=(0.1, 0.2, 0.3))
    mesh = domains.plus.mesh(1.8, periodic=True)
    found = permeability(mesh)
    skeletal = {"kind": "skeletal", "side": "+", "offset": 0.5, "tol": 0.02, "loose": "keep"}
    alone = tpmscad.lattice("gyroid", cell=10, phase=(0.3, 0.1, 0.2), **skeletal).mesh(1.8, periodic=True)
    expected = np.trace(permeability(alone)) / 3  # of a cubic channel, which no phase changes
    np.testing.assert_allclose(found, expected * np.eye(3), atol=0.005 * expected)
    assert mesh.openings == {f"opening {axis}{sign}" for axis in "XYZ" for sign in "+-"}
    renamed = replace(mesh, facet_groups={"all": np.arange(mesh.n_facets)}, openings=frozenset())
    np.testing.assert_array_equal(permeability(renamed), found)


def test_the_command_prints_and_reports_the_permeability_of_a_channel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gajetti et al., Int. J. Heat Mass Transf. 252 (2025) 127439: 0.0156 x porosity^2.78 cells squared, by finite volumes.

    Both channels of a symmetric wall are congruent. The box cuts chips off them, which belong to the flow.
    """
    pytest.importorskip("gmsh")
    pytest.importorskip("skfem")
    line = f"permeability gyroid --cell 8 --thickness 0.8 --size 0.15 --report {tmp_path / 'p.json'}"
    assert run(f"{line} --side +") == 0
    out, err = capsys.readouterr()
    assert list_warnings(err) == []
    found = json.loads((tmp_path / "p.json").read_text())
    porosity = tpmscad.surfaces.skeletal_volume_fraction("gyroid", "minimal", 0.05, "+")
    assert found["porosity"] == pytest.approx(porosity, rel=1e-3)
    expected = 0.0156 * porosity**2.78 * 64
    np.testing.assert_allclose(found["permeability"], expected * np.eye(3), atol=0.04 * expected)
    assert 0.0 < found["error"] < 0.1
    assert "gyroid skeletal, a channel of porosity 0.34" in out
    assert "mm2; mean of the axes 0.05" in out

    def take(channel: Any, size: float, progress: Any) -> ChannelPermeability:
        return ChannelPermeability(channel.name, size * np.eye(3), np.eye(3), channel.volume / 512, 1, 1.0)

    monkeypatch.setattr(tpmscad, "permeability", take)
    assert run(f"{line} --side - --quiet") == 0
    assert capsys.readouterr().out == ""
    found = json.loads((tmp_path / "p.json").read_text())
    assert found["porosity"] == pytest.approx(porosity, rel=1e-3)
    assert found["permeability"][0][0] == pytest.approx(0.15 * 8)
