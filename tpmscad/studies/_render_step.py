"""Pictures of STEP files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tpmscad.api.public_calls import public
from tpmscad.studies._render import render


@public()
def render_step(
    path: str | Path,
    picture: str | Path,
    *,
    view: str | Sequence[float] = "iso",
    section: Any = None,
    size: tuple[int, int] = (1200, 900),
    color_by: str | None = None,
    hide: str | Sequence[str] = (),
) -> None:
    """Draw a STEP file as a PNG picture, without a display.

    Parameters
    ----------
    path : str or Path
        The STEP file.
    picture : str or Path
        The PNG file to write.
    view, section, size, color_by, hide
        As in `tpmscad.render`. By default the solids and faces have the colours that the file holds; ``color_by="piece"`` gives
        every solid its own.

    Raises
    ------
    InvalidRequest
        If there is no such file, it is not a STEP file, the kernel cannot read it or finds no solid in it, or an argument is not
        understood.

    Examples
    --------
    >>> tpmscad.render_step("gyroid.step", "gyroid.png", section="z=5")  # doctest: +SKIP
    """
    render(Path(path), picture, view=view, section=section, size=size, color_by=color_by, hide=hide)
