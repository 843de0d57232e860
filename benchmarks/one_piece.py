"""Pieces of lattices by default: every surface of the catalogue, sheet and skeletal, at two volume fractions.

    python -m benchmarks.one_piece [--surfaces gyroid,octo] [--cells 1,1,1]

Each row: surface, kind, volume fraction, pieces, tunnels, closed cavities, loose pieces that were left out and their share of the
solid, whether the certificate is met, seconds; below it, why there is more than one piece.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import tpmscad
from tpmscad import surfaces
from tpmscad.errors import TpmscadError

FRACTIONS = (0.2, 0.4)
"""Volume fractions of both kinds."""

FRACTIONS_OF_SURFACE = {
    "neovius": {"sheet": (0.15, 0.3), "skeletal": (0.4, 0.6)},
    "frd": {"skeletal": (0.2, 0.4)},
    "fischer_koch_s": {"skeletal": (0.3, 0.5)},
    "octo": {"skeletal": (0.45, 0.6)},
    "lidinoid": {"skeletal": (0.3, 0.5)},
}
"""Others where the usual ones are out of reach of the offsets."""


@dataclass(frozen=True, slots=True)
class PiecesRow:
    """A lattice and its pieces; `failure` tells why there is none."""

    surface: str
    kind: str
    fraction: float
    certificate: Any
    seconds: float
    failure: str = ""

    def __str__(self) -> str:
        head = f"{self.surface:15}{self.kind:9}{self.fraction:5.2f}"
        if self.certificate is None:
            return f"{head}  {self.failure}"
        of = self.certificate
        pieces, tunnels, cavities = of.betti
        share = 100 * sum(of.dropped) / of.volume
        line = f"{head}{pieces:8}{tunnels:9}{cavities:10}{len(of.dropped):9}{share:9.3f} %  {of.met!s:6}{self.seconds:7.1f} s"
        told = [note for note in of.notes if "piece" in note] if pieces > 1 or of.dropped else []
        return "\n".join([line, *(f"    {note}" for note in told)])


def measure_pieces(names: Sequence[str], cells: Sequence[int]) -> Iterator[PiecesRow]:
    """The rows of the table, one after another."""
    for name in names:
        for kind in ("sheet", "skeletal"):
            for fraction in FRACTIONS_OF_SURFACE.get(name, {}).get(kind, FRACTIONS):
                begun = time.perf_counter()
                certificate, failure = None, ""
                try:
                    certificate = tpmscad.lattice(
                        name, cell=10.0, cells=cells, volume_fraction=fraction, kind=kind, tol=0.05
                    ).certificate
                except TpmscadError as error:
                    failure = f"{type(error).__name__}: {error}"
                yield PiecesRow(name, kind, fraction, certificate, time.perf_counter() - begun, failure)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surfaces", default=",".join(surfaces.CATALOGUE))
    parser.add_argument("--cells", default="1,1,1")
    given = parser.parse_args(arguments)
    print("surface        kind   fraction  pieces  tunnels  cavities  left out    share    met    time")
    rows = []
    for row in measure_pieces(given.surfaces.split(","), [int(n) for n in given.cells.split(",")]):
        rows.append(row)
        print(row, flush=True)
    single = sum(row.certificate is not None and row.certificate.betti[0] == 1 for row in rows)
    print(f"{single} of {len(rows)} lattices are one piece")


if __name__ == "__main__":
    main()
