"""The box to blend in, from the regions: boxes, spheres, finite cylinders and what is made of them have one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.blend.grid import Array, Box, Field
from tpmscad.errors import InvalidRequest
from tpmscad.fields.booleans import Extreme
from tpmscad.fields.regions import Box as BoxField
from tpmscad.fields.regions import Cylinder, Sphere


def domain_of(regions: Sequence[Field], domain: Box | None) -> Box:
    """The box given, or the least that holds all regions. Raises InvalidRequest if a region is unbounded."""
    if domain is not None:
        box = np.array(domain, float)
        if box.shape != (2, 3) or not np.isfinite(box).all():
            raise InvalidRequest(f"domain {domain}: must be ((x0, y0, z0), (x1, y1, z1)) with finite numbers")
    else:
        boxes = [bounds(region) for region in regions]
        for number, found in enumerate(boxes):
            if not np.isfinite(found).all():
                raise InvalidRequest(
                    f"region {number} has no bounds: give domain=((x0, y0, z0), (x1, y1, z1)), the box to blend in"
                )
        both = np.array(boxes)
        box = np.stack([both[:, 0].min(axis=0), both[:, 1].max(axis=0)])
    (x0, y0, z0), (x1, y1, z1) = box.tolist()
    return (x0, y0, z0), (x1, y1, z1)


def bounds(region: Field) -> Array:
    """Least and greatest x, y, z of a region: (2, 3), infinite where it has none or they are not known."""
    everything = np.array([[-np.inf] * 3, [np.inf] * 3])
    if isinstance(region, BoxField):
        return np.array([region.lo, region.hi], float)
    if isinstance(region, Sphere):
        return np.array(region.center) + np.array([[-region.radius], [region.radius]])
    if isinstance(region, Cylinder) and region.height is not None:
        axis = np.array(region.axis)
        reach = abs(axis) * region.height / 2 + region.radius * np.sqrt(np.maximum(1 - axis**2, 0))
        return np.array(region.center) + np.array([-reach, reach])
    if isinstance(region, Extreme):
        first, second = bounds(region.first), bounds(region.second)
        inner = np.stack([np.maximum(first[0], second[0]), np.minimum(first[1], second[1])])
        outer = np.stack([np.minimum(first[0], second[0]), np.maximum(first[1], second[1])])
        return inner if region.sign > 0 else outer
    own = getattr(region, "bounds", None)
    return everything if own is None else np.array(own, float)
