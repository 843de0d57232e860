"""Slices of blends as pictures, and the main program of the blending examples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tpmscad.blending import BlendResult

Span = tuple[float, float]


def draw(panel: Any, result: BlendResult, spans: Sequence[Span], height: float, axes: tuple[int, int] = (0, 1)) -> None:
    """Draw the solid in a plane, coloured by the weight, or by the mean index of several structures.

    `spans` are the intervals of the two `axes` of the plane; `height` is its position along the third.
    """
    u, v = np.meshgrid(*(np.linspace(*span, 400) for span in spans), indexing="ij")
    points = np.full((*u.shape, 3), height)
    points[..., axes[0]], points[..., axes[1]] = u, v
    part = result.weight(points)
    several = part.ndim > u.ndim
    kind = part @ np.arange(part.shape[-1]) if several else part
    shown = np.where(result.field(points) <= 0, kind, np.nan)
    colours = {"cmap": "turbo", "vmax": part.shape[-1] - 1} if several else {"cmap": "coolwarm", "vmax": 1}
    panel.imshow(shown.T, origin="lower", extent=(*spans[0], *spans[1]), vmin=0, **colours)


def figure(rows: int, columns: int, size: tuple[float, float], path: str, fill: Callable[[list[Any]], None]) -> None:
    """Save a picture of rows and columns of panels, which the caller fills. Needs matplotlib."""
    import matplotlib.pyplot as plt

    picture, panels = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    fill(list(panels.flat))
    picture.savefig(path, dpi=100)
    plt.close(picture)


def show(
    main: Callable[[], dict[str, BlendResult]], picture: Callable[[dict[str, BlendResult], str], None], path: str
) -> None:
    """Run an example: print the message of each blend and save the picture."""
    results = main()
    for name, result in results.items():
        print(f"{name}: {result.message}")
    picture(results, path)
