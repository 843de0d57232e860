"""Several models as one whose pieces keep the names of their parts: the solids of an assembly, each filled by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tpmscad.brep.boundary_representation import join_breps
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, estimate_volume
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.results.certificate import Certificate
from tpmscad.results.model import Model


def join_models(name: str, models: Mapping[str, Model], seconds: Mapping[str, float], envelope: str) -> Model:
    """The solids of models, by the names of their parts, as one model, largest first; nothing is united.

    The solids are those of the kernel, and the patches those of all parts. `envelope` names the bodies together.
    """
    pieces = [piece for part, model in models.items() for piece in replace(model, name=part).named_solids()]
    pieces.sort(key=lambda piece: -estimate_volume(piece.solid))
    first = next(iter(models.values()))
    bodies = [model.envelope for model in models.values() if model.envelope is not None]
    by_kernel = [model.trimmed_by for model in models.values() if not isinstance(model.built, OcctSolids)]
    return Model(
        name,
        join_breps([model.patches for model in models.values()]),
        join_certificates({part: model.certificate for part, model in models.items()}).with_seconds(seconds),
        OcctSolids(tuple(piece.solid for piece in pieces), tuple(piece.labels for piece in pieces)),
        trimmed_by=first.trimmed_by if len(by_kernel) == len(models) else "kernel",
        distance_to_reference=first.distance_to_reference,
        envelope=Envelope(
            envelope, sum(body.volume for body in bodies), make_compound(body.body for body in bodies if body.body)
        ),
        piece_names=tuple(piece.name for piece in pieces),
    )


def join_certificates(parts: Mapping[str, Certificate]) -> Certificate:
    """The certificate of solids that are apart: sums, greatest values, and what is said of each part under its name."""
    every = list(parts.values())
    areas = np.array([of.area for of in every])
    squares = np.array([of.rms_deviation for of in every]) ** 2
    common = [note for note in every[0].notes if all(note in of.notes for of in every)]
    own = [f"{part}: {note}" for part, of in parts.items() for note in of.notes if note not in common]
    b0, b1, b2 = np.sum([of.betti for of in every], axis=0).tolist()
    return Certificate(
        met=all(of.met for of in every),
        shortfalls=tuple(f"{part}: {text}" for part, of in parts.items() for text in of.shortfalls),
        tol=max(of.tol for of in every),
        max_deviation=max(of.max_deviation for of in every),
        rms_deviation=float(np.sqrt((areas * squares).sum() / areas.sum())),
        reference=every[0].reference,
        gap=max(of.gap for of in every),
        tangent_jump_deg=max(of.tangent_jump_deg for of in every),
        curvature_jump=max(of.curvature_jump for of in every),
        valid=all(of.valid for of in every),
        closed=all(of.closed for of in every),
        volume=sum(of.volume for of in every),
        area=float(areas.sum()),
        betti=(b0, b1, b2),
        pieces=_sort([of.pieces for of in every]),
        n_faces=sum(of.n_faces for of in every),
        n_primitives=sum(of.n_primitives for of in every),
        n_poles=sum(of.n_poles for of in every),
        bounds={
            name: max(of.bounds[name] for of in every if name in of.bounds)
            for name in dict.fromkeys(name for of in every for name in of.bounds)
        },
        figures={f"{part}: {name}": value for part, of in parts.items() for name, value in of.figures.items()},
        notes=(*common, *own),
        dropped=_sort([of.dropped for of in every]),
        warnings=tuple(f"{part}: {text}" for part, of in parts.items() for text in of.warnings),
    )


def _sort(values: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """All values, largest first."""
    return tuple(sorted((value for of in values for value in of), reverse=True))
