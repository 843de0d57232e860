"""Arguments that functions of several rooms share: an annotation with a name, see `tpmscad.api.arguments`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tpmscad.api.argument_kinds import POINT, choice_of
from tpmscad.api.shared_kinds import ANYTHING, NUMBER, PATH, PICTURE_SIZE, PROGRESS, TEXT

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from tpmscad._typing import ProgressOption

SurfaceName = Annotated[str, TEXT, "Name or alias of a surface of the catalogue."]
Reference = Annotated[str, TEXT.described_as(example='"nodal"'), "The minimal surface, or the trigonometric level set."]
Samples = Annotated["ArrayLike", ANYTHING, "Samples of the field."]
Level = Annotated[float, NUMBER.described_as(example="0.0"), "Value of the field; 0 is the surface of the solid."]
SampleConnectivity = Annotated[
    str, choice_of("vertices", "top_cells", "strict"), "Connectivity of the samples, see `CONNECTIVITY`."
]
Schema = Annotated[str, TEXT.described_as(example='"ap242"'), "STEP application protocol."]
PicturePath = Annotated[str | Path, PATH, "The PNG file to write."]
View = Annotated[str | Sequence[float], TEXT.or_else(POINT).described_as(example='"iso"'), "As in `tpmscad.render`."]
Section = Annotated[Any, ANYTHING, "As in `tpmscad.render`."]
PictureSize = Annotated[tuple[int, int], PICTURE_SIZE, "As in `tpmscad.render`."]
ColorBy = Annotated[str | None, TEXT.described_as(example='"piece"'), "As in `tpmscad.render`."]
ProgressKeyword = Annotated["ProgressOption", PROGRESS, "Who shows the progress; see `tpmscad.lattice`."]
StageProgress = Annotated[
    "ProgressOption",
    PROGRESS,
    "Called with the name of a stage and the fraction of it that is done. By default work of more than two seconds shows a "
    "bar in a terminal or a notebook; False shows nothing.",
]
LoosePieces = Annotated[
    str,
    choice_of("drop", "keep"),
    "Whether pieces below 1 % of the largest one's volume are left out or kept. The certificate counts those left out.",
]
