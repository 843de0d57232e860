"""Results travel between processes: a pickle keeps shapes, volumes, certificates, names, labels and shared faces."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

import tpmscad
from tpmscad import fields
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of
from tpmscad.results.domain_results import FluidDomains

pytestmark = pytest.mark.kernel


def assert_same(copy: tpmscad.Model, model: tpmscad.Model) -> None:
    """Both are one model: certificate, faces, names, labels, boxes and the kernel's own measures."""
    assert copy.certificate.to_dict() == model.certificate.to_dict()
    assert (copy.name, copy.trimmed_by, copy.is_fluid) == (model.name, model.trimmed_by, model.is_fluid)
    assert [(s.name, s.labels) for s in copy.named_solids()] == [(s.name, s.labels) for s in model.named_solids()]
    assert copy.bounding_box == model.bounding_box
    found, expected = check_shape(copy.wrapped), check_shape(model.wrapped)
    assert found.ok
    assert (found.volume, found.area, found.faces) == (expected.volume, expected.area, expected.faces)


def test_a_lattice_survives_pickling_with_all_that_it_can_do(tmp_path: Path) -> None:
    model = tpmscad.lattice("schwarz_p", cell=10, cells=(2, 1, 1), thickness=1, tol=0.1)
    copy = pickle.loads(pickle.dumps(model))
    assert_same(copy, model)
    assert copy.unit_cell is not None
    copy.export_step(tmp_path / "copy.step", instanced=True)
    assert copy.distance_to_reference([[1.0, 2.0, 3.0]]) == model.distance_to_reference([[1.0, 2.0, 3.0]])


@pytest.mark.slow
def test_functions_that_cannot_be_pickled_stay_behind() -> None:
    model = tpmscad.solidify(lambda p: p[:, 0] - 5.0, ((0, 0, 0), (10, 10, 10)), tol=0.1)
    assert model.volume == pytest.approx(500, rel=1e-9)
    copy = pickle.loads(pickle.dumps(model))
    assert_same(copy, model)
    assert copy.distance_to_reference is None


@pytest.mark.slow
def test_domains_share_their_faces_after_pickling_as_before() -> None:
    domains = tpmscad.fluid_domains(
        fields.box((0, 0, 0), (10, 10, 10)), "schwarz_p", cell=10, thickness=1, tol=0.1, phase=(0.25, 0.25, 0.25)
    )
    copy = pickle.loads(pickle.dumps(domains))
    for name, model in domains.domains.items():
        assert_same(copy.domains[name], model)

    def shared(of: FluidDomains) -> int:
        wall = {ShapeKey(face) for face in faces_of(of.wall.wrapped)}
        return sum(ShapeKey(face) in wall for face in faces_of(of.plus.wrapped))

    assert 0 < shared(copy) == shared(domains)
    assert copy.touches[0].areas == domains.touches[0].areas
    assert (copy.name, copy.volume, copy.surface, copy.cell) == (
        domains.name,
        domains.volume,
        domains.surface,
        domains.cell,
    )
