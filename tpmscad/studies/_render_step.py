"""Pictures of files."""

from __future__ import annotations

from pathlib import Path

from tpmscad.api.arguments import select_arguments
from tpmscad.api.public_calls import validate_options
from tpmscad.requests.study_options import PiecesPictureOptions, RenderStepOptions
from tpmscad.studies._render import render


@validate_options(RenderStepOptions, 'render_step("part.step", "part.png", section="z")')
def render_step(options: RenderStepOptions) -> None:
    """Draw a CAD file (STEP, IGES, BREP), or triangles (STL, OBJ, PLY, 3MF) as they are, as a PNG picture, without a display.

    Raises
    ------
    InvalidRequest
        If there is no such file, it is none of a known format or cannot be read, it holds no solid and no triangle, or an
        argument is not understood.

    Examples
    --------
    >>> tpmscad.render_step("gyroid.step", "gyroid.png", section="z=5")  # doctest: +SKIP
    """
    render(Path(options.path), options.picture, **select_arguments(options, PiecesPictureOptions))
