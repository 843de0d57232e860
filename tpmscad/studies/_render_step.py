"""Pictures of STEP files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, PATH, PICTURE_SIZE, TEXT, TEXTS
from tpmscad.studies._render import render


@validate_call()
def render_step(
    path: Annotated[str | Path, PATH, "The STEP file."],
    picture: Annotated[str | Path, PATH.described_as(example='"part.png"'), "The PNG file to write."],
    *,
    view: Annotated[
        str | Sequence[float],
        TEXT.or_else(POINT).described_as(example='"iso"'),
        "As in `tpmscad.render`. By default the solids and faces have the colours that the file holds; "
        '``color_by="piece"`` gives every solid its own.',
    ] = "iso",
    section: Annotated[Any, ANYTHING, "As `view`."] = None,
    size: Annotated[tuple[int, int], PICTURE_SIZE, "As `view`."] = (1200, 900),
    color_by: Annotated[str | None, TEXT.described_as(example='"piece"'), "As `view`."] = None,
    hide: Annotated[str | Sequence[str], TEXTS.described_as(example='"skin"'), "As `view`."] = (),
) -> None:
    """Draw a STEP file as a PNG picture, without a display.

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
