"""Recipes: blends and solids of fields described in TOML files, for the command line. Errors name the file, the line, the key.

Lengths in mm, angles in degrees, as everywhere. A field is a table with a `kind`, a number, or the name of a field that the
recipe defines under `[fields.NAME]`.
"""

from __future__ import annotations

from dataclasses import replace

from tpmscad.blend import BlendResult
from tpmscad.errors import NotMet
from tpmscad.model import Model, Progress
from tpmscad.recipe.entry import RecipeError
from tpmscad.recipe.part import Part, read_part
from tpmscad.recipe.scaffold import Scaffold, read_scaffold

__all__ = [
    "Part",
    "RecipeError",
    "Scaffold",
    "blend_of",
    "read_part",
    "read_scaffold",
    "solid_of_blend",
    "solid_of_part",
]


def blend_of(scaffold: Scaffold, *, allow_errors: bool = False, progress: Progress | None = None) -> BlendResult:
    """The blend of a recipe. NotMet if errors of its own are left or a neck could not be had, unless they are allowed."""
    result = scaffold.blended(progress)
    if not allow_errors and (not result.converged or result.necks):
        raise NotMet(f"the blend misses the request: {result.message}", result)
    return result


def solid_of_blend(scaffold: Scaffold, result: BlendResult, progress: Progress | None = None) -> Model:
    """The solid of a blend, in the domain it was blended in; what is to be said of the blend is in the certificate's notes."""
    from tpmscad.solids import solidify

    model = solidify(result.field, result.domain, tol=scaffold.tol, progress=progress)
    certificate = replace(model.certificate, notes=(*model.certificate.notes, f"blend: {result.message}"))
    return replace(model, name="blended scaffold", certificate=certificate)


def solid_of_part(part: Part, progress: Progress | None = None) -> Model:
    """The solid of a field's recipe."""
    from tpmscad.solids import solidify

    return solidify(part.field, part.domain, tol=part.tol, progress=progress)
