"""What a result says of itself: a few lines of text, and in a notebook a picture with a table."""

from __future__ import annotations

import base64
from html import escape
from typing import Any

import numpy as np

from tpmscad._typing import BoxCorners
from tpmscad.result_display import format_html_table
from tpmscad.results.certificate import Certificate

MAX_SHORTFALLS = 4
"""Shortfalls that a summary lists; the certificate has them all."""

PICTURE_SIZE = (480, 360)
"""Width and height of a notebook's picture, pixels."""


def measure_diagonal(box: BoxCorners) -> float:
    """Diagonal of a box."""
    return float(np.linalg.norm(np.subtract(box[1], box[0])))


def round_corners(box: BoxCorners) -> BoxCorners:
    """The corners without their round-off, to nine digits of the diagonal; 0 is never negative."""
    decimals = 9 - int(np.ceil(np.log10(measure_diagonal(box))))
    return tuple(map(tuple, (np.round(box, decimals) + 0.0).tolist()))


def count_pieces(pieces: int) -> str:
    """A number of pieces in words: 1 piece, 2 pieces."""
    return "1 piece" if pieces == 1 else f"{pieces} pieces"


def format_size(box: BoxCorners) -> str:
    """Edges of a box: 20 x 20 x 10."""
    return " x ".join(f"{edge:.5g}" for edge in np.subtract(box[1], box[0]).tolist())


def format_summary(name: str, box: BoxCorners, certificate: Certificate) -> str:
    """Name, size, pieces, volume, and whether the request is met with the reasons if not: at most nine lines."""
    (x0, y0, z0), (x1, y1, z1) = round_corners(box)
    lines = [
        f"{name}: {format_size(box)} mm, {count_pieces(len(certificate.pieces))}, {certificate.n_faces} faces",
        f"  box     ({x0:.6g}, {y0:.6g}, {z0:.6g}) to ({x1:.6g}, {y1:.6g}, {z1:.6g})",
        f"  volume  {certificate.volume:.7g}, area {certificate.area:.7g}",
    ]
    if certificate.met:
        found = f"deviation {certificate.max_deviation:.2g} of {certificate.tol:g} from the {certificate.reference}"
        return "\n".join([*lines, f"  met     {found}"])
    missed = [f"  NOT met {shortfall}" for shortfall in certificate.shortfalls[:MAX_SHORTFALLS]]
    more = len(certificate.shortfalls) - MAX_SHORTFALLS
    return "\n".join([*lines, *missed, *([f"  and {more} more: see .certificate"] if more > 0 else [])])


def format_html(shape: Any, name: str, box: BoxCorners, certificate: Certificate) -> str:
    """A picture of the model or domains as inline PNG, and the certificate as a table."""
    from tpmscad.studies._render import render_bytes

    encoded = base64.b64encode(render_bytes(shape, size=PICTURE_SIZE)).decode("ascii")
    rows = [
        ("size", f"{format_size(box)} mm"),
        ("request", "met" if certificate.met else "NOT met: " + "; ".join(certificate.shortfalls)),
        ("deviation", f"{certificate.max_deviation:.3g} of {certificate.tol:g} from the {certificate.reference}"),
        ("volume", f"{certificate.volume:.7g} mm3"),
        ("area", f"{certificate.area:.7g} mm2"),
        ("pieces", str(len(certificate.pieces))),
        ("faces", str(certificate.n_faces)),
    ]
    rows += [("warning", warning) for warning in certificate.warnings]
    rows += [("note", note) for note in certificate.notes]
    picture = f'<img src="data:image/png;base64,{encoded}" alt="{escape(name)}">'
    return f"<div>{picture}{format_html_table(name, rows)}</div>"
