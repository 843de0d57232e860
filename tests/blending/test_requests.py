"""Requests that cannot be blended are refused with the fault and a remedy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.baseline_weights import blend_by_baseline
from tpmscad import fields
from tpmscad.blending import CylinderRadius, LinearCoordinate, LineWeightSpec, blend
from tpmscad.blending.composition.defects import count_defects
from tpmscad.errors import InvalidRequest

ROD, OTHER = fields.rod(fields.tpms("gyroid", period=0.5), 0.0), fields.rod(fields.tpms("schwarz_p", period=0.5), 0.0)
LEFT, RIGHT = fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))
MIDDLE = fields.box((0.3, 0, 0), (0.7, 0.5, 0.5))
SIZE = (24, 13, 12)
DOMAIN = ((0, 0, 0), (1, 0.5, 0.5))


def refused(message, structures=(ROD, OTHER), regions=(LEFT, RIGHT), blending=(MIDDLE,), **options):
    with pytest.raises(InvalidRequest, match=message):
        blend(structures, regions, blending, **{"resolution": SIZE, **options})


def test_numbers_of_structures_and_regions_must_agree():
    refused("1 structure given", structures=[ROD], regions=[LEFT], blending=[])
    refused("3 regions for 2 structures", regions=[LEFT, RIGHT, MIDDLE])
    refused("2 blending regions for 2 structures: 1 are needed", blending=[MIDDLE, MIDDLE])
    refused("2 weights for 1 blending regions", weight=["x", "y"])


def test_empty_overlapping_and_distant_regions_are_named():
    refused("region 1 is empty", regions=[LEFT, fields.box((3, 3, 3), (4, 4, 4))], domain=((0, 0, 0), (1, 0.5, 0.5)))
    refused("blending region 0 is empty", blending=[fields.box((5, 5, 5), (6, 6, 6))])
    refused("regions 0 and 1 overlap", regions=[fields.box((0, 0, 0), (0.8, 0.5, 0.5)), RIGHT])
    refused("blending region 0 does not touch region 1", blending=[fields.box((0.1, 0, 0), (0.3, 0.5, 0.5))])
    refused("does not touch any of the regions 0 to 0", blending=[fields.box((0.7, 0, 0), (0.9, 0.5, 0.5))])


def test_regions_without_bounds_need_a_domain():
    walls = fields.halfspace((0.5, 0, 0), "x"), fields.halfspace((0.5, 0, 0), (-1, 0, 0))
    refused("region 0 has no bounds: give domain", regions=walls)
    result = blend((ROD, OTHER), walls, [MIDDLE], resolution=SIZE, domain=((0, 0, 0), (1, 0.5, 0.5)))
    assert result.converged
    refused("inf.* must be finite", domain=((0, 0, 0), (1, math.inf, 1)))


def test_values_that_are_not_finite_and_functions_of_single_points_are_refused():
    hole = fields.from_function(lambda p: np.where(p[:, 0] > 0.8, np.nan, p[:, 0] - 0.5))
    refused("not finite at .* first at", structures=[hole, OTHER])
    refused("vectorised|array|points", structures=[lambda p: math.sin(p[0]), OTHER])


def test_under_sampled_structures_are_refused_with_a_resolution_that_would_do():
    fine = fields.rod(fields.tpms("iwp", period=1 / 16), -2.0)
    with pytest.raises(InvalidRequest, match=r"under-sampled.*3\.1 samples per period") as caught:
        blend((ROD, fine), (LEFT, RIGHT), [MIDDLE], resolution=(50, 26, 26))
    enough = tuple(int(n) for n in str(caught.value).split("resolution of (")[1].split(")")[0].split(","))
    assert (
        count_defects(fine.on_grid(*(np.linspace(0, s, n) for s, n in zip((1, 0.5, 0.5), enough, strict=True)))).n0 == 0
    )
    refused(
        "under-sampled.*isolated components and holes there",
        structures=[ROD, lambda p: fine(p)],
        resolution=(50, 25, 25),
    )


def test_names_and_numbers_out_of_range_are_refused():
    refused("method 'best': must be one of topological", method="best")
    refused("weight 'round': must be one of auto", weight="round")
    refused("max_change 0: must be above 0", max_change=0)
    refused("minimum_neck -1 must be positive", minimum_neck=-1)
    refused("at least 2 samples", resolution=(1, 4, 4))
    refused("it is no layer", weight=LineWeightSpec(CylinderRadius()))
    refused("minimum_neck inf must be finite", minimum_neck=math.inf)
    refused(
        "count 2: a weight of degree 3 has at least 4", weight=LineWeightSpec(LinearCoordinate(), count=2, degree=3)
    )
    with pytest.raises(InvalidRequest, match="degree 0 must be positive"):
        LineWeightSpec(LinearCoordinate(), degree=0)
    for coordinate in (LinearCoordinate, CylinderRadius):
        with pytest.raises(
            InvalidRequest, match=r"direction \(0.0, 0.0, 0.0\) has no length: give three finite numbers"
        ):
            coordinate(direction=(0, 0, 0))


def test_a_blending_region_without_thickness_or_around_a_whole_region_is_refused():
    plane = fields.expression("abs(x - 0.5)")
    refused("from 0.5 to 0.5 is empty: widen", blending=[plane], resolution=(25, 13, 12), domain=DOMAIN)
    covered = fields.box((0.3, 0, 0), (1, 0.5, 0.5))
    refused("nothing of the second region borders on .* shrink it if it covers", blending=[covered], weight="volume")


def test_discrete_reconstruction_of_structures_without_periods_needs_a_flat_layer():
    half, cube, core = (
        fields.halfspace((0, 0, 0.25), "z"),
        fields.box((0, 0, 0), (1, 1, 1)),
        fields.sphere((0.5, 0.5, 0.5), 0.3),
    )
    layer = fields.difference(fields.sphere((0.5, 0.5, 0.5), 0.4), fields.sphere((0.5, 0.5, 0.5), 0.2))
    regions = core, fields.difference(cube, core)
    with pytest.raises(
        InvalidRequest, match="needs structures with periods, or a blending region that is a flat layer"
    ):
        blend_by_baseline((half, half), regions, [layer], "discrete-reconstruction", (16, 17, 18))


def test_a_profile_needs_a_layer():
    with pytest.raises(InvalidRequest, match="needs a blending region that is a layer"):
        blend_by_baseline((ROD, OTHER), (LEFT, RIGHT), [MIDDLE], "sigmoid", SIZE, weight="volume")


def test_structures_that_no_affordable_resolution_holds_are_refused():
    fine, thin = fields.rod(fields.tpms("gyroid", 0.01), 0.0), fields.sheet(fields.tpms("gyroid", 0.5), -1e-6, 1e-6)
    refused(
        "need 1001 x 501 x 501 samples over the domain, above the limit of", structures=[ROD, fine], resolution=None
    )
    refused("structure 1 has parts too thin for 80 samples per period", structures=[ROD, thin], resolution=None)
    needles = fields.expression("abs(sin(3000*x)*sin(3100*y)*sin(3200*z)) - 0.00001 + 0*x")
    refused("structure 1 .* 200 samples along the domain", structures=[ROD, needles], resolution=None)


def test_without_a_resolution_one_is_chosen_that_keeps_the_structures_whole():
    thin = fields.sheet(fields.tpms("gyroid", period=0.5), -0.3, 0.3)
    result = blend((ROD, thin), (LEFT, RIGHT), [MIDDLE])
    assert result.converged
    assert min(result.resolution) >= 20
    spacing = [length / (n - 1) for length, n in zip((1, 0.5, 0.5), result.resolution, strict=True)]
    assert max(spacing) == pytest.approx(min(spacing), rel=0.1)


def test_a_function_of_points_is_a_structure_and_keeps_its_bits():
    def wavy(points):
        return np.sin(12 * points[..., 0]) * np.cos(12 * points[..., 1]) + 0.4 * np.sin(12 * points[..., 2]) - 0.3

    result = blend((wavy, OTHER), (LEFT, RIGHT), [MIDDLE], resolution=SIZE)
    points = np.random.default_rng(0).uniform(0, (0.29, 0.5, 0.5), (70_000, 3))
    assert np.array_equal(result.field(points), wavy(points))
    assert result.field(points.reshape(-1, 7, 3)[:50]).shape == (50, 7)


def test_progress_reports_the_beginning_and_the_end_of_each_stage_in_turn():
    reports = []
    result = blend(
        (ROD, OTHER), (LEFT, RIGHT), [MIDDLE], resolution=SIZE, progress=lambda *report: reports.append(report)
    )
    stages = list(result.seconds)
    assert reports == [(stage, fraction) for stage in stages for fraction in (0.0, 1.0)]
    assert stages == ["sampling", "weights", "optimisation", "subgrid defects", "check"]
