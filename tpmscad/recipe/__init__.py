"""Recipes: blends and solids of fields described in TOML files, for the command line.

Lengths are in mm, angles in degrees. A field is a table with a `kind`, a number, or the name of a field that the recipe
defines under `[fields.NAME]`. An invalid recipe raises RecipeError, whose message begins with the file, the line and the key.
The modules are loaded at their first use, because they need NumPy and the fields.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad.errors import RecipeError
    from tpmscad.recipe.blend_recipe import BlendRecipe, read_blend_recipe
    from tpmscad.recipe.key_reference import format_reference, read_template
    from tpmscad.recipe.recipe_runs import BlendRun, SolidRun, run_blend_recipe
    from tpmscad.recipe.solid_recipe import SolidRecipe, read_solid_recipe

__all__ = [
    "BlendRecipe",
    "BlendRun",
    "RecipeError",
    "SolidRecipe",
    "SolidRun",
    "format_reference",
    "read_blend_recipe",
    "read_solid_recipe",
    "read_template",
    "run_blend_recipe",
]

_MODULE_OF_NAME = {
    "BlendRecipe": "tpmscad.recipe.blend_recipe",
    "BlendRun": "tpmscad.recipe.recipe_runs",
    "RecipeError": "tpmscad.errors",
    "SolidRecipe": "tpmscad.recipe.solid_recipe",
    "SolidRun": "tpmscad.recipe.recipe_runs",
    "format_reference": "tpmscad.recipe.key_reference",
    "read_blend_recipe": "tpmscad.recipe.blend_recipe",
    "read_solid_recipe": "tpmscad.recipe.solid_recipe",
    "read_template": "tpmscad.recipe.key_reference",
    "run_blend_recipe": "tpmscad.recipe.recipe_runs",
}

__getattr__, __dir__ = lazy_attributes(__name__, _MODULE_OF_NAME)
