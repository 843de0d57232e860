"""Files of beams, one for each feature of the 3MF beam lattice extension, written by lib3mf."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lib3mf
import numpy as np

from tpmscad.fields.data.beam_files import keep_locale

POINTS = np.array([[0.0, 0, 0], [6, 0, 0], [0, 5, 1], [1, 1, 7]])
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2]])
DIAMETERS = np.array([[2.0, 1.0], [2.0, 0.6], [1.0, 1.0], [0.5, 1.2]])

AXES_TURNED = ((0, 2, 0), (-2, 0, 0), (0, 0, 2), (1, 2, 3))
"""A placement: rows of the images of x, y and z, and of the origin, twice as large."""


def make_placement(rows: Any) -> Any:
    """The transform of four rows of three numbers."""
    placement = lib3mf.Transform()
    for row, values in enumerate(rows):
        placement.Fields[row][:] = values
    return placement


def save(path: Path, *, unit: str = "MilliMeter", **options: Any) -> Path:
    """A file of an object of beams, with what else is asked for, and a mesh.

    graph: points, edges and diameters of other beams; caps, balls, clip; placement; `beside`: the mesh, too; `represented`: the
    mesh represents the beams; `again`: the object once more, elsewhere; sets: numbers of beams by name.
    """
    points, edges, diameters = options.get("graph", (POINTS, EDGES, DIAMETERS))
    wrapper = lib3mf.Wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(getattr(lib3mf.ModelUnit, unit))
    solid = model.AddMeshObject()
    low, high = options.get("box", ((-9, 0, 0), (-5, 4, 4)))
    corners = [[x, y, z] for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
    for corner in corners:
        solid.AddVertex(lib3mf.Position(Coordinates=tuple(map(float, corner))))
    for quad in ((0, 2, 3, 1), (0, 1, 5, 4), (0, 4, 6, 2), (1, 3, 7, 5), (2, 6, 7, 3), (4, 5, 7, 6)):
        for triangle in ((quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3])):
            solid.AddTriangle(lib3mf.Triangle(Indices=triangle))
    frame = model.AddMeshObject()
    for point in points.tolist():
        frame.AddVertex(lib3mf.Position(Coordinates=tuple(point)))
    beams = frame.BeamLattice()
    beams.SetMinLength(1e-4)
    caps = options.get("caps", (0, 0))
    for (i, j), (first, last) in zip(edges.tolist(), (diameters / 2).tolist(), strict=True):
        beams.AddBeam(lib3mf.Beam(Indices=(i, j), Radii=(first, last), CapModes=caps))
    if "balls" in options:
        mode, default = options["balls"]
        beams.SetBallOptions(mode, default)
        beams.AddBall(lib3mf.Ball(Index=3, Radius=1.5))
    if "clip" in options:
        beams.SetClipping(options["clip"], solid.GetResourceID())
    if options.get("represented"):
        beams.SetRepresentation(solid.GetResourceID())
    for name, numbers in options.get("sets", {}).items():
        found = beams.AddBeamSet()
        found.SetName(name)
        found.SetReferences(numbers)
    identity = wrapper.GetIdentityTransform()
    both = model.AddComponentsObject()
    both.AddComponent(frame, identity)
    if options.get("again"):
        both.AddComponent(frame, make_placement(((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 12))))
    model.AddBuildItem(both, options.get("placement", identity))
    if options.get("beside"):
        model.AddBuildItem(solid, identity)
    with keep_locale():
        model.QueryWriter("3mf").WriteToFile(str(path))
    return path


def save_all(folder: Path) -> Iterator[Path]:
    """Ten files, named by what they show."""
    modes, clips, caps = lib3mf.BeamLatticeBallMode, lib3mf.BeamLatticeClipMode, lib3mf.BeamLatticeCapMode
    rng = np.random.default_rng(1)
    net = np.array([[x, y, z] for x in range(4) for y in range(4) for z in range(4)])
    sides = np.array([[i, j] for i in range(64) for j in range(i) if np.abs(net[i] - net[j]).sum() == 1])
    many = 5.0 * net + rng.uniform(-1, 1, net.shape), sides, rng.uniform(0.6, 1.4, (len(sides), 2))
    around = {"box": ((-2, -2, -2), (4, 3, 4))}
    samples: dict[str, dict[str, Any]] = {
        "units_and_placement": {"unit": "Inch", "placement": make_placement(AXES_TURNED)},
        "several_objects": {"again": True, "beside": True},
        "balls_mixed": {"balls": (modes.Mixed, 1.3)},
        "balls_all": {"balls": (modes.All, 1.3)},
        "flat_and_hemispherical_caps": {"caps": (caps.Butt, caps.HemiSphere)},
        "clipped_inside": {"clip": clips.Inside, **around},
        "clipped_outside": {"clip": clips.Outside, **around},
        "representation": {"represented": True},
        "many_radii": {"graph": many},
        "sets": {"sets": {"legs": [0, 1, 2], "tie": [3]}},
    }
    for name, options in samples.items():
        yield save(folder / f"{name}.3mf", **options)
