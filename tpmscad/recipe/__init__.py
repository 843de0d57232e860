"""Recipes: blends and solids of fields described in TOML files, for the command line. Errors name the file, the line, the key.

Lengths in mm, angles in degrees, as everywhere. A field is a table with a `kind`, a number, or the name of a field that the
recipe defines under `[fields.NAME]`.
"""

from __future__ import annotations

from dataclasses import replace

from tpmscad._typing import Progress
from tpmscad.blending import BlendResult
from tpmscad.errors import NotMet, RecipeError
from tpmscad.recipe.blend_recipe import BlendRecipe, read_blend_recipe
from tpmscad.recipe.solid_recipe import SolidRecipe, read_solid_recipe
from tpmscad.workflows.model import Model

__all__ = [
    "BlendRecipe",
    "RecipeError",
    "SolidRecipe",
    "read_blend_recipe",
    "read_solid_recipe",
    "run_blend_recipe",
    "solidify_blend",
    "solidify_recipe",
]


def run_blend_recipe(
    scaffold: BlendRecipe, *, allow_errors: bool = False, progress: Progress | None = None
) -> BlendResult:
    """The blend of a recipe. NotMet if errors of its own are left or a neck could not be had, unless they are allowed."""
    result = scaffold.run(progress)
    if not allow_errors and (not result.converged or result.necks):
        raise NotMet(f"the blend misses the request: {result.message}", result)
    return result


def solidify_blend(scaffold: BlendRecipe, result: BlendResult, progress: Progress | None = None) -> Model:
    """The solid of a blend, in the domain it was blended in; what is to be said of the blend is in the certificate's notes."""
    from tpmscad.workflows.implicit_solid import solidify

    model = solidify(result.field, result.domain, tol=scaffold.tol, progress=progress)
    certificate = replace(model.certificate, notes=(*model.certificate.notes, f"blend: {result.message}"))
    return replace(model, name="blended scaffold", certificate=certificate)


def solidify_recipe(part: SolidRecipe, progress: Progress | None = None) -> Model:
    """The solid of a field's recipe."""
    from tpmscad.workflows.implicit_solid import solidify

    return solidify(part.field, part.domain, tol=part.tol, progress=progress)
