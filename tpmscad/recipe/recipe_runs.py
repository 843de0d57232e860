"""What the command line does with a recipe: describe it in a dry run, or make its solid.

A `RecipeRun` gives both with the report that belongs to it. A blend is computed in either case; the dry run of a solid does what
comes before the fits, and computes the volume fraction of its field.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tpmscad import workflows
from tpmscad._typing import Progress
from tpmscad.blending import BlendResult
from tpmscad.errors import NotMet
from tpmscad.recipe.blend_recipe import BlendRecipe, read_blend_recipe
from tpmscad.recipe.solid_recipe import SolidRecipe, read_solid_recipe

if TYPE_CHECKING:
    from tpmscad.workflows import Model


class RecipeRun(Protocol):
    """A recipe that was read, and can be described or made."""

    def describe(self) -> tuple[str, dict[str, Any]]:
        """The text and the report of a dry run."""

    def make(self, progress: Progress | None) -> tuple[Model, dict[str, Any]]:
        """The solid and its report."""


def run_blend_recipe(
    recipe: BlendRecipe, *, allow_errors: bool = False, progress: Progress | None = None
) -> BlendResult:
    """The blend of a recipe; NotMet if it has topological errors of its own or too thin a neck, unless they are allowed."""
    result = recipe.run(progress)
    if not allow_errors and (not result.converged or result.necks):
        raise NotMet(f"the blend misses the request: {result.message}", result)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class BlendRun:
    """A blend that was computed, to be made a solid within `tol` (mm)."""

    result: BlendResult
    tol: float

    @classmethod
    def read(cls, path: Path, *, allow_errors: bool = False, progress: Progress | None = None) -> BlendRun:
        """The blend of the recipe in a TOML file; errors as `read_blend_recipe` and `run_blend_recipe`."""
        recipe = read_blend_recipe(path)
        return cls(run_blend_recipe(recipe, allow_errors=allow_errors, progress=progress), recipe.tol)

    def describe(self) -> tuple[str, dict[str, Any]]:
        """The message of the blend, and its report."""
        return self.result.message, self.result.to_dict()

    def make(self, progress: Progress | None) -> tuple[Model, dict[str, Any]]:
        """The solid in the domain of the blend; the notes of its certificate include the message of the blend."""
        model = workflows.solidify(self.result.field, self.result.domain, tol=self.tol, progress=progress)
        certificate = replace(model.certificate, notes=(*model.certificate.notes, f"blend: {self.result.message}"))
        model = replace(model, name="blended scaffold", certificate=certificate)
        return model, certificate.to_dict() | {"blend": self.result.to_dict()}


@dataclass(frozen=True, slots=True, eq=False)
class SolidRun:
    """A field that was read, to be made a solid."""

    recipe: SolidRecipe

    @classmethod
    def read(cls, path: Path) -> SolidRun:
        """The field of the recipe in a TOML file; errors as `read_solid_recipe`."""
        return cls(read_solid_recipe(path))

    def describe(self) -> tuple[str, dict[str, Any]]:
        """The domain, the tolerance and the volume fraction; an error that making the solid would end in before its fits."""
        recipe = self.recipe
        with recipe.locate_errors():
            found = workflows.preview_solid(recipe.field, recipe.domain, tol=recipe.tol)
        domain = str(recipe.domain) if isinstance(recipe.domain, Path) else [list(corner) for corner in recipe.domain]
        content = {"domain": domain, "tol": recipe.tol, "volume_fraction": found.volume_fraction}
        text = f"domain {domain}, about {100 * found.volume_fraction:.1f} % solid, tolerance {recipe.tol:g}"
        return text, content

    def make(self, progress: Progress | None) -> tuple[Model, dict[str, Any]]:
        """The solid of the field in its domain, and its report."""
        recipe = self.recipe
        with recipe.locate_errors():
            model = workflows.solidify(recipe.field, recipe.domain, tol=recipe.tol, progress=progress)
        return model, model.certificate.to_dict()
