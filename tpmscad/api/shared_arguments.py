"""Arguments that functions of several rooms share: an annotation with a name, see `tpmscad.api.arguments`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.shared_kinds import ANYTHING, NUMBER, PROGRESS, TEXT

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
ProgressKeyword = Annotated["ProgressOption", PROGRESS, "Who shows the progress; see `tpmscad.lattice`."]
StageProgress = Annotated[
    "ProgressOption",
    PROGRESS,
    "Called with the name of a stage and the fraction of it that is done. By default work of more than two seconds shows a "
    "bar in a terminal or a notebook, and of more than ten a line for each stage on standard error "
    "elsewhere; False shows nothing.",
]
LoosePieces = Annotated[
    str,
    choice_of("drop", "keep"),
    "Whether pieces below 1 % of the largest one's volume are left out or kept. The certificate counts those left out.",
]
