"""Pictures of quantities that depend on direction: the surface has the radius asked for, and its own normals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tpmscad
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.render.polar_surface import make_polar_surface
from tpmscad.simulation.periodic_cell import IsotropicMaterial
from tpmscad.simulation.properties import HomogenizedProperties

pytestmark = pytest.mark.kernel


def test_an_ellipsoid_has_its_radii_and_its_normals() -> None:
    semi_axes = np.array([1.0, 2.0, 3.0])
    scene = make_polar_surface(lambda n: 1.0 / np.linalg.norm(n / semi_axes, axis=1))
    np.testing.assert_allclose(np.linalg.norm(scene.points / semi_axes, axis=1), 1.0)
    np.testing.assert_allclose(scene.values, np.linalg.norm(scene.points, axis=1))
    gradient = scene.points / semi_axes**2
    exact = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(scene.normals, exact, atol=1e-7)


def test_effective_stiffness_is_drawn_and_takes_no_colours_of_faces(tmp_path: Path) -> None:
    stiffness = IsotropicMaterial(3.0, 0.25).stiffness
    found = HomogenizedProperties("plain", stiffness, np.eye(3), 1.0, 0.0, stiffness, np.eye(3), 3.0, 0.25, 1, 1, 0.0)
    tpmscad.render(found, tmp_path / "stiffness.png", size=(400, 300))
    with Image.open(tmp_path / "stiffness.png") as picture:
        assert picture.size == (400, 300)
    with pytest.raises(InvalidRequest, match="leave color_by and hide out"):
        tpmscad.render(found, tmp_path / "stiffness.png", color_by="tag")
