"""What the command line does with a recipe: describe it in a dry run, or make its solid.

A `RecipeRun` gives both with the report that belongs to it. A blend is computed in either case; the dry run of a solid does what
comes before the fits, and computes the volume fraction of its field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tpmscad._typing import Progress
from tpmscad.blending import BlendResult
from tpmscad.errors import NotMet
from tpmscad.fields import Field
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.recipe.array_fields import make_array_field
from tpmscad.recipe.blend_recipe import BlendRecipe, read_blend_recipe
from tpmscad.recipe.solid_recipe import SolidDomain, SolidRecipe, read_solid_recipe
from tpmscad.recipe.toml_entry import read_document

if TYPE_CHECKING:
    from tpmscad.results.model import Model


def read_recipe(path: Path, changes: Mapping[str, Any]) -> BlendRecipe | SolidRecipe:
    """The recipe of a blend or of a solid, whichever the file holds, with other values for some keys."""
    is_blend = "structures" in read_document(path).value
    return read_blend_recipe(path, changes) if is_blend else read_solid_recipe(path, changes)


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
    keep_loose: bool = False

    @classmethod
    def read(
        cls, path: Path, *, allow_errors: bool = False, keep_loose: bool = False, progress: Progress | None = None
    ) -> BlendRun:
        """The blend of the recipe in a TOML file; errors as `read_blend_recipe` and `run_blend_recipe`."""
        recipe = read_blend_recipe(path)
        return cls(run_blend_recipe(recipe, allow_errors=allow_errors, progress=progress), recipe.tol, keep_loose)

    def describe(self) -> tuple[str, dict[str, Any]]:
        """The message of the blend, and its report."""
        return self.result.message, self.result.to_dict()

    def make(self, progress: Progress | None) -> tuple[Model, dict[str, Any]]:
        """The solid in the domain of the blend; the notes of its certificate include the message of the blend."""
        result = self.result
        model = _make_solid(result.field, result.domain, self.tol, self.keep_loose, progress)
        certificate = replace(model.certificate, notes=(*model.certificate.notes, f"blend: {result.message}"))
        model = replace(model, name="blended scaffold", certificate=certificate)
        return model, certificate.to_dict() | {"blend": result.to_dict()}


@dataclass(frozen=True, slots=True, eq=False)
class SolidRun:
    """A field that was read, to be made a solid in a box or a body within `tol` (mm); of a recipe, if there is one.

    passive: the CAD files of `keep` and `clear`, of `solidify`, by these names, where they are given.
    """

    field: Field
    domain: SolidDomain
    tol: float
    passive: Mapping[str, Path]
    recipe: SolidRecipe | None = None
    keep_loose: bool = False

    @classmethod
    def read(cls, path: Path, *, keep_loose: bool = False) -> SolidRun:
        """The field of the recipe in a TOML file; errors as `read_solid_recipe`."""
        recipe = read_solid_recipe(path)
        return cls(recipe.field, recipe.domain, recipe.tol, recipe.passive, recipe, keep_loose)

    @classmethod
    def sample(
        cls,
        path: Path,
        *,
        keep: Path | None = None,
        clear: Path | None = None,
        tol: float | None = None,
        keep_loose: bool = False,
        **given: Any,
    ) -> SolidRun:
        """The field of an image, array or file of beams, with what is `given` to `make_array_field`, in its domain."""
        made, domain, tol = make_array_field(path, tol=tol, **given)
        passive = {name: path for name, path in (("keep", keep), ("clear", clear)) if path is not None}
        return cls(made, domain, tol, passive, None, keep_loose)

    def describe(self) -> tuple[str, dict[str, Any]]:
        """The domain, the tolerance and the volume fraction; an error that making the solid would end in before its fits."""
        from tpmscad.solids._preview_solid import preview_solid  # loads the kernel

        with self._locate_errors():
            found = preview_solid(self.field, self.domain, tol=self.tol)
        box = [list(corner) for corner in found.box]
        content = {"domain": box, "tol": self.tol, "volume_fraction": found.volume_fraction}
        if self.recipe is not None:
            content["domain"] = self.recipe.recipe["domain"].value
        fraction = f"about {100 * found.volume_fraction:.1f} % of it solid"
        notes = collect_notes(self.field)
        if self.passive:
            from tpmscad.solids.passive_regions import PassiveRegions

            with self._locate_errors():
                notes = (*notes, *PassiveRegions.read(**self.passive).describe())
        content |= {"notes": list(notes)} if notes else {}
        text = f"box {_format_corner(box[0])} to {_format_corner(box[1])}, {fraction}, tolerance {self.tol:g}"
        return "\n".join([text, *(f"note        {note}" for note in notes)]), content

    def make(self, progress: Progress | None) -> tuple[Model, dict[str, Any]]:
        """The solid of the field in its domain, and its report."""
        with self._locate_errors():
            model = _make_solid(self.field, self.domain, self.tol, self.keep_loose, progress, **self.passive)
        return model, model.certificate.to_dict()

    def _locate_errors(self) -> AbstractContextManager[None]:
        return nullcontext() if self.recipe is None else self.recipe.locate_errors()


RecipeRun = BlendRun | SolidRun
"""A recipe that was read, and can be described or made."""


def _format_corner(corner: Sequence[float]) -> str:
    return f"({', '.join(f'{x:.6g}' for x in corner)})"


def _make_solid(
    field: Field, domain: Any, tol: float, keep_loose: bool, progress: Progress | None, **passive: Path
) -> Model:
    """The solid of a field, with or without its loose pieces, and with passive regions if they are given."""
    from tpmscad.solids._solidify import solidify  # loads the kernel

    options: dict[str, Any] = {**passive, **({"loose": "keep"} if keep_loose else {})}
    return solidify(field, domain, tol=tol, progress=progress, **options)
