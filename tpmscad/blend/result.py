"""What a blend returns: the field, the weights, the errors counted before and after, and what became of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.grid import Array
from tpmscad.blend.weight import Weight


@dataclass(frozen=True, slots=True)
class Tally:
    """Numbers of one kind of error at each resolution checked: before, after, and of these the inputs' own."""

    initial: tuple[int, ...]
    final: tuple[int, ...]
    intrinsic: tuple[int, ...]

    @property
    def left(self) -> tuple[int, ...]:
        """Final errors that are the blend's, not the inputs'."""
        return tuple(f - i for f, i in zip(self.final, self.intrinsic, strict=True))


@dataclass(frozen=True, slots=True)
class Errors:
    """n0: isolated components (solid, joined through faces, beside the greatest); n2: isolated holes (void, joined through faces,
    that do not reach the domain's border); at each of `resolutions`, the working one first."""

    resolutions: tuple[tuple[int, int, int], ...]
    n0: Tally
    n2: Tally

    @property
    def left(self) -> int:
        """Errors of the blend itself, at the resolution that has most."""
        return max(a + b for a, b in zip(self.n0.left, self.n2.left, strict=True))

    def to_dict(self) -> dict[str, object]:
        tallies = {
            name: {"initial": t.initial, "final": t.final, "intrinsic": t.intrinsic}
            for name, t in (("n0", self.n0), ("n2", self.n2))
        }
        return {"resolutions": self.resolutions, **tallies}


@dataclass(frozen=True, slots=True, eq=False)
class BlendResult:
    """A blend. `converged` is True only if no error of the blend's own is left at any resolution checked.

    field: f(points), f.gradient(points), f < 0 solid. weight: of two structures the weight of the second, w(points), exactly 0 or
    1 outside the blending region; of more, the shares of all, (..., n). weights: the spline of each stage. seconds: CPU by stage.
    """

    field: BlendedField
    weight: Callable[[Array], Array]
    weights: tuple[Weight, ...]
    errors: Errors
    converged: bool
    iterations: int
    message: str
    method: str
    resolution: tuple[int, int, int]
    seconds: Mapping[str, float]
