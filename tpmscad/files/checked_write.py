"""STEP files that are read back and compared with what was written, before they appear under their name.

A file is written under a temporary name and renamed only if it holds what was meant; a failure leaves no file behind. The text
of a boundary representation is read by a parser of its own and compared number for number. Then the kernel reads the file
without healing and finds valid closed solids of the expected volume; of a large file it reads an excerpt, unless more is asked.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.export.file_check import carries_gaps, check_excerpt
from tpmscad.kernel.export.kernel_writer import heal_solid, write_with_kernel
from tpmscad.kernel.export.shape_file import write_solids
from tpmscad.kernel.measure.edge_gaps import measure_accuracy, measure_edge_length
from tpmscad.kernel.measure.invalid_faces import describe_invalid_face
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_report import ShapeReport, check_step
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.face_labels import NamedSolid, find_label_colour, label_faces
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.kernel.step.text_check import check_text
from tpmscad.rigid_motion import Motion

KERNEL_READ_LIMIT = 3_000_000
"""Bytes of a file that the kernel always reads as a whole, faster than its solid was made; of larger ones it reads an excerpt."""

REREAD_VOLUME_RTOL = 1e-9
"""Relative difference allowed between the volume written and the volume read back, for faces that are all B-spline patches."""

REREAD_VOLUME_RTOL_OF_BODIES = 1e-7
"""The same for solids that contain faces of a CAD body."""

REREAD_TERM_RTOL = 1e-8
"""The same in terms of the sum that is the volume, area x size / 3. A thin layer of a lattice has terms fifteen times its volume:
curves that a file holds 4e-8 off their surfaces changed it by 1.1e-7 of the volume, 7e-9 of the terms."""

HEALING_PRECISIONS = (1e-7, 1e-6, 1e-5)
"""mm: largest gaps that healing closes, the smallest first."""

ADVICE = "nothing was written; give a smaller `tol`, bring the part nearer to the origin, or make it in units of 1 to 1000 mm"


def describe_fault(report: ShapeReport) -> str:
    """What is wrong with the solids of a report, in words."""
    faults = ("invalid", not report.valid), ("open", not report.closed), ("inside out", not report.outward)
    return " and ".join(word for word, is_so in faults if is_so) or "missing"


def limit_reread_volume(volume: float, area: float, size: float) -> float:
    """Relative difference allowed between volumes written and read back of a solid with faces of a CAD body; size: of its box."""
    return max(REREAD_VOLUME_RTOL_OF_BODIES, REREAD_TERM_RTOL * area * size / (3 * volume))


def make_volume_check(volume: float, rtol: float, *, healed: bool = False) -> Callable[[Path], None]:
    """Function that raises KernelError unless a file holds valid closed solids of total `volume`, to within `rtol`.

    healed: the file is read with the kernel's healing, as CAD programs read it.
    """

    def verify(path: Path) -> None:
        try:
            report = check_step(path, healed=healed)
        except InvalidRequest as error:
            raise KernelError("export_step", str(error)) from error
        if not report.ok:
            where = describe_invalid_face(read_step(path, healed=healed).shape)
            raise KernelError(
                "export_step",
                f"the kernel finds its solids {describe_fault(report.shape)} in the file{where and f': {where}'}; {ADVICE}",
            )
        difference = abs(report.shape.volume - volume)
        if difference > rtol * volume:
            raise KernelError(
                "export_step",
                f"the file's volume is {report.shape.volume:.12g}, that of the solid {volume:.12g}: they differ by "
                f"{difference / volume:.2g} of it, the limit is {rtol:g}; {ADVICE}",
            )

    return verify


def write_checked_brep(
    built: BrepSolids,
    path: str | Path,
    *,
    schema: str,
    name: str,
    rtol: float = REREAD_VOLUME_RTOL,
    instances: Sequence[Motion] = (),
    verify: str | None = None,
    time_stamp: str | None = None,
) -> None:
    """Write the solids of a boundary representation as STEP, once or as an assembly of copies, and check what the file holds.

    `instances` are the levels of the assembly as for `write_step`. If `verify` is "kernel", the kernel reads the whole file,
    however large. A STEP file states no tolerance of an edge, so that one with edges off their faces is read with healing, as CAD
    programs read it. KernelError if the file does not hold what was written.
    """
    brep, nesting, labels = built.brep, built.nesting, label_faces(built.brep)
    volume = math.prod(map(len, instances)) * float(integral_properties.volume(nesting.moments)[0])

    def check(written: Path) -> None:
        if verify == "kernel" or written.stat().st_size <= KERNEL_READ_LIMIT:
            check_text(written, brep, nesting, instances)
            make_volume_check(volume, rtol, healed=carries_gaps(brep))(written)
        else:
            check_excerpt(written, brep, nesting, instances)

    write_step(
        brep,
        nesting,
        path,
        schema=schema,
        name=name,
        instances=instances,
        labels=labels,
        colours={label: find_label_colour(label) for label in set(labels)},
        time_stamp=time_stamp,
        verify=check,
    )


def write_checked_solids(
    solids: Sequence[NamedSolid],
    path: str | Path,
    *,
    schema: str,
    name: str,
    volume: float,
    assembly: bool = False,
    failure: KernelError | None = None,
) -> None:
    """Write kernel solids as STEP, read the file back and compare the volume; if `assembly`, each is a product of its own.

    A CAD body may bring edges that lie off its faces by more than the kernel's confusion. STEP states no tolerance of an edge, so
    such a file is valid only as CAD programs read it, with healing. If the file does not read back, other ways to write it are
    tried, and a warning tells which one was taken. failure: why the same solids could not be written as arrays.
    """
    moments = np.array([solid_moments(of.solid) for of in solids]).reshape(-1, 5)
    outcome = WRITERS.run(SolidsRequest(solids, Path(path), schema, name, assembly, volume, moments))
    failures = (*([failure] if failure else []), *outcome.failures)
    if failures:
        reasons = "; ".join(dict.fromkeys(str(error).removesuffix(f"; {ADVICE}") for error in failures))
        warnings.warn(f"{path} was written {outcome.name}, since {reasons}", stacklevel=4)


@dataclass(frozen=True, slots=True, eq=False)
class SolidsRequest:
    """Kernel solids to be written to a STEP file, their total volume, and their moments (n, 5) as `solid_moments` gives them."""

    solids: Sequence[NamedSolid]
    path: Path
    schema: str
    name: str
    assembly: bool
    volume: float
    moments: Array

    def write(self, healed: bool = False) -> None:
        """Write the solids with their names, labels and colours; if `healed`, the file is checked as CAD programs read it."""
        accuracy = measure_accuracy(of.solid for of in self.solids)
        verify = self._make_check(accuracy, healed)
        write_solids(
            self.solids,
            self.path,
            schema=self.schema,
            name=self.name,
            assembly=self.assembly,
            accuracy=accuracy,
            moments=self.moments,
            verify=verify,
        )

    def write_with_kernel(self) -> None:
        """Write the solids with the kernel's writer, which keeps names of solids only."""
        accuracy = measure_accuracy(of.solid for of in self.solids)
        write_with_kernel(self.solids, self.path, self.name, self._make_check(accuracy))

    def write_healed(self, precision: float) -> None:
        """Write the solids healed with gaps up to `precision` in mm."""
        healed = [replace(of, source=heal_solid(of.solid, precision)) for of in self.solids]
        moments = np.array([solid_moments(of.solid) for of in healed])
        replace(self, solids=healed, moments=moments).write()

    def _make_check(self, accuracy: float, healed: bool = False) -> Callable[[Path], None]:
        """The check of a file of solids whose edges lie off their faces by up to `accuracy` in mm.

        The volume of a solid with gaps along its edges is defined up to gap times length of the edges times a third of the size.
        """
        shapes = [of.solid for of in self.solids]
        size = max(map(box_diagonal, shapes))
        rtol = limit_reread_volume(self.volume, float(self.moments[:, 0].sum()), size)
        if accuracy > CONFUSION_TOLERANCE:
            rtol = max(rtol, accuracy * sum(map(measure_edge_length, shapes)) * size / (3 * self.volume))
        return make_volume_check(self.volume, rtol, healed=healed or accuracy > CONFUSION_TOLERANCE)


WRITERS: Fallbacks[[SolidsRequest], None] = Fallbacks(
    (
        Fallback("with names, labels and colours", SolidsRequest.write, "a second for 1000 faces"),
        Fallback("for programs that heal what they read", partial(SolidsRequest.write, healed=True), "as much"),
        Fallback(
            "by the kernel's writer, without labels and colours of faces", SolidsRequest.write_with_kernel, "as much"
        ),
        *(
            Fallback(
                f"healed by the kernel, with shifts up to {p:g} mm", partial(SolidsRequest.write_healed, precision=p)
            )
            for p in HEALING_PRECISIONS
        ),
    ),
    retry_on=(KernelError,),
)
"""How kernel solids are written as STEP: a file that misses its check is followed by the next one. CAD programs heal what they
read; the second way keeps names and geometry, of which each later one gives something up."""
