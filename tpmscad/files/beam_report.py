"""The report on a 3MF file with beams: what its build holds."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import BoxCorners
from tpmscad.fields.data.beam_files import read_beam_file
from tpmscad.fields.data.edge_radii import greatest_radii
from tpmscad.result_display import fit_lines
from tpmscad.results.result_summary import format_size, round_corners


@dataclass(frozen=True, slots=True)
class BeamReport:
    """What the build of a file of beams holds, in mm.

    Attributes
    ----------
    file : str
        Name of the file.
    lattices, beams, nodes : int
        Objects with beams, beams that differ, and the nodes at their ends.
    radii : pair of float
        The smallest and the greatest radius of a beam.
    different_radii, conical, balls : int
        How many radii there are, beams with a radius of its own at each end, and balls at nodes.
    clipped : int
        Objects whose beams are clipped by a mesh.
    triangles : int
        Triangles of the meshes beside the beams.
    bounds : pair of (float, float, float)
        Opposite corners of a box around the beams, before they are clipped, and the triangles.
    notes : tuple of str
        What is not as in the file.
    """

    file: str
    lattices: int
    beams: int
    nodes: int
    radii: tuple[float, float]
    different_radii: int
    conical: int
    balls: int
    clipped: int
    triangles: int
    bounds: BoxCorners
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """True: a file that cannot be read as it is meant has no report."""
        return True

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values for JSON. All attributes and `ok`."""
        return {"ok": self.ok} | asdict(self)

    def summary(self, *, verbose: bool = False) -> str:
        """The report in plain words, with units; `verbose` changes nothing."""
        low, high = ("({:.6g}, {:.6g}, {:.6g})".format(*corner) for corner in round_corners(self.bounds))
        counts = [
            f"{self.different_radii} radii from {self.radii[0]:.6g} to {self.radii[1]:.6g} mm",
            f"{self.conical} conical" if self.conical else "",
            f"{self.balls} balls" if self.balls else "",
        ]
        lines = [
            f"{self.file}: beams",
            f"size        {format_size(self.bounds)} mm, from {low} to {high}",
            f"holds       {self.beams} beams, {self.nodes} nodes",
            f"beams       {', '.join(filter(None, counts))}",
        ]
        if self.clipped:
            lines.append(f"clipping    the beams of {self.clipped} of {self.lattices} objects are clipped by meshes")
        if self.triangles:
            lines.append(f"beside      {self.triangles} triangles")
        return "\n".join([*lines, *(f"warning     {note}" for note in self.notes)])

    def __str__(self) -> str:
        return fit_lines([self.summary()], ".summary()")


def report_beams(path: Path) -> BeamReport:
    """The report on a 3MF file with beams; InvalidRequest if it cannot be read."""
    found = read_beam_file(path)
    radii = np.concatenate([lattice.radii for lattice in found.lattices])
    ends, nodes = [], 0
    for lattice in found.lattices:
        ends_of_beams = greatest_radii(len(lattice.points), lattice.edges, lattice.radii)
        reach = np.maximum(ends_of_beams, lattice.balls)[:, None]
        used = np.unique(lattice.edges)
        ends += [lattice.points[used] - reach[used], lattice.points[used] + reach[used]]
        nodes += len(used)
    corners = np.concatenate([*ends, *(points for points, _ in found.meshes)])
    low, high = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return BeamReport(
        path.name,
        len(found.lattices),
        len(radii),
        nodes,
        (float(radii.min()), float(radii.max())),
        len(np.unique(radii)),
        int((radii[:, 0] != radii[:, 1]).sum()),
        int(sum((lattice.balls > 0).sum() for lattice in found.lattices)),
        sum(lattice.clipping is not None for lattice in found.lattices),
        sum(len(triangles) for _, triangles in found.meshes),
        (tuple(low), tuple(high)),
        found.notes,
    )
