"""A case of OpenFOAM for steady laminar flow with conjugate heat transfer on the groups of a mesh as regions.

Properties are constant, so that the flow does not depend on temperature: `simpleFoam` solves it in each channel, and
`chtMultiRegionSimpleFoam` takes its fluxes as frozen and solves the heat of all regions, coupled at their interfaces. (That
program's own flow is unstable on tetrahedra, where it reconstructs velocities from fluxes.) A fluid enters its channel at
the openings of one side of the body and leaves at those of the opposite side; other openings are closed.

A channel of a periodic mesh has no ends: a body force drives the flow, and the case is one of flow alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.mesh_arrays import AXES, MeshArrays
from tpmscad.meshing.openfoam_dictionaries import (
    ALLRUN_FLOW,
    ALLRUN_HEAD,
    ALLRUN_HEAT,
    CONTROL,
    DRIVING_FORCE,
    FLOW_FILES,
    FLOW_ITERATIONS,
    FLOW_SOLUTION,
    FLUID_FILES,
    HEAT_ITERATIONS,
    HEAT_SOLUTION,
    IN,
    INTERFACES,
    OPENINGS,
    OUT,
    PASCAL_PER_UNIT,
    PRESSURE_DROP_BETWEEN,
    PRESSURE_DROP_OF_PERIOD,
    SCHEMES,
    SOLID_FILES,
    WATER_HEAT_CAPACITY,
    heat_balance,
    pressure_drop,
)
from tpmscad.meshing.poly_meshes import (
    HEADER,
    PolyMesh,
    divide_regions,
    name_for_foam,
    name_period,
    vector_areas,
    write_poly_mesh,
)

MILLIMETRES_PER_METRE = 1e3

OPPOSITE = {"+": "-", "-": "+"}

HOT, COLD, MIDDLE = 350.0, 300.0, 325.0
"""Kelvin at which the fluid enters the first and the other channels, and at which solids start."""


def write_openfoam_case(mesh: MeshArrays, folder: Path, flow: Mapping[str, str] | None, velocity: float) -> None:
    """Write the folder, complete or not at all; InvalidRequest if it holds something, or the flow does not fit the mesh.

    `flow` names for each group of elements with a fluid the side that it flows to: "X+".
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidRequest(f"{folder} is not an empty folder: give the name of a new one")
    parts = divide_regions(mesh)
    directions = _choose_flow(parts, mesh) if flow is None else dict(flow)
    _check_flow(parts, directions)
    with atomic_write(folder) as aside:
        _write_case(aside, parts, directions, MILLIMETRES_PER_METRE * velocity, mesh)


def _openings(part: PolyMesh) -> dict[str, list[str]]:
    """The names of the patches at openings of a region, by the side that they are on: "X+"."""
    found: dict[str, list[str]] = {}
    for patch in part.patches:
        if patch.side is not None:
            found.setdefault(patch.side, []).append(patch.name)
    return found


def _opposite(side: str) -> str:
    """The side across the body: "X-" of "X+"."""
    return side[:-1] + OPPOSITE.get(side[-1:], "")


def _is_driven(part: PolyMesh, to: str) -> bool:
    """Whether a flow to a side passes a period of the region instead of openings."""
    return any(patch.name == name_period(to[0].lower(), "near") for patch in part.patches)


def _choose_flow(parts: list[PolyMesh], mesh: MeshArrays) -> dict[str, str]:
    """Counterflow: each region with openings at both sides of an axis flows along the first one, by turns to and fro.

    A periodic region that is alone flows along its first period.
    """
    found: dict[str, str] = {}
    for part in parts:
        sides = _openings(part)
        through = [side for side in sides if _opposite(side) in sides]
        if through:
            found[part.region] = min(through)[:-1] + "+-"[len(found) % 2]
    periods = [axis.upper() + "+" for axis in AXES if axis in mesh.periodic]
    if not found and len(parts) == 1 and periods:
        return {parts[0].region: periods[0]}
    return found


def _check_flow(parts: list[PolyMesh], flow: Mapping[str, str]) -> None:
    """Refuse a flow through no region, or from and to sides where there is no opening."""
    known = {part.region: part for part in parts}
    if not flow:
        raise InvalidRequest(
            "no group of elements has openings at two opposite sides: a case needs a channel of fluid_domains, or flow= "
            "through the group of a channel of a periodic mesh"
        )
    for region, side in flow.items():
        if region not in known:
            raise InvalidRequest(f"flow: {region!r} is no group of elements; they are {', '.join(map(repr, known))}")
        openings = _openings(known[region])
        if not {side, _opposite(side)} <= set(openings) and not (_opposite(side) and _is_driven(known[region], side)):
            there = ", ".join(sorted(openings)) or "no side"
            raise InvalidRequest(
                f'flow: {region!r} cannot flow to {side!r}: it is open at {there}; name a side as in "X+"'
            )
    driven = [region for region, side in flow.items() if _is_driven(known[region], side)]
    if driven and len(driven) < len(flow):
        raise InvalidRequest(
            f"flow: {driven[0]!r} flows through a period and others do not: write a case for each, or mesh without periodic="
        )


def _write_case(case: Path, parts: list[PolyMesh], flow: Mapping[str, str], speed: float, mesh: MeshArrays) -> None:
    """All files of the case; `speed` in mm/s."""
    fluids = [part for part in parts if part.region in flow]
    solids = [part for part in parts if part.region not in flow]
    names = [name_for_foam(part.region) for part in fluids]
    script = ALLRUN_HEAD
    is_driven = _is_driven(fluids[0], flow[fluids[0].region])
    for name, part in zip(names, fluids, strict=True):
        to, openings = flow[part.region], _openings(part)
        zones = {IN: part.number_faces(openings.get(_opposite(to), ())), OUT: part.number_faces(openings.get(to, ()))}
        zones[OPENINGS] = np.concatenate([zones[IN], zones[OUT]])
        zones[INTERFACES] = part.number_faces([patch.name for patch in part.patches if patch.other])
        write_poly_mesh(part, case / "constant" / name / "polyMesh", {} if is_driven else zones)
        below = case / "flow" / name
        for file, text in FLOW_FILES.items():
            _write(below, "constant", file, text)
        _write_solver(below, "system", FLOW_SOLUTION)
        functions = "" if is_driven else pressure_drop()
        if is_driven:
            _write(below, "constant", "fvOptions", DRIVING_FORCE.format(velocity=_vector(to, speed)))
            period = abs(float(mesh.translation(to[0].lower())["XYZ".index(to[0])]))
            drop = PRESSURE_DROP_OF_PERIOD.format(name, scale=period * PASCAL_PER_UNIT)
        else:
            drop = PRESSURE_DROP_BETWEEN.format(name)
        control = CONTROL.format(program="simpleFoam", iterations=FLOW_ITERATIONS, functions=functions)
        _write(below, "system", "controlDict", control)
        _write_flow_fields(below, part, to, speed)
        script += ALLRUN_FLOW.format(name, drop=drop)
    if not is_driven:
        _write_heat(case, fluids, solids, flow, speed)
        script += ALLRUN_HEAT.format(
            fluids=" ".join(names),
            solids=" ".join(name_for_foam(part.region) for part in solids),
            iterations=HEAT_ITERATIONS,
        )
    (case / "case.foam").touch()  # what ParaView opens
    (case / "Allrun").write_text(script, encoding="ascii", newline="\n")
    (case / "Allrun").chmod(0o755)


def _write_heat(
    case: Path, fluids: Sequence[PolyMesh], solids: Sequence[PolyMesh], flow: Mapping[str, str], speed: float
) -> None:
    """The files of all regions for the heat."""
    for part in (*fluids, *solids):
        name, to = name_for_foam(part.region), flow.get(part.region)
        if to is None:
            zones = {INTERFACES: part.number_faces([patch.name for patch in part.patches if patch.other])}
            write_poly_mesh(part, case / "constant" / name / "polyMesh", zones)
        for file, text in (SOLID_FILES if to is None else FLUID_FILES).items():
            _write(case, f"constant/{name}", file, text)
        _write_solver(case, f"system/{name}", HEAT_SOLUTION)
        _write_heat_fields(case, part, to, MIDDLE if to is None else HOT if next(iter(flow)) == part.region else COLD)
    _write_solver(case, "system", HEAT_SOLUTION)
    greatest = (HOT - COLD) * WATER_HEAT_CAPACITY * min(_find_rate(part, flow[part.region], speed) for part in fluids)
    names, solid_names = ([name_for_foam(part.region) for part in parts] for parts in (fluids, solids))
    functions = heat_balance(names, solid_names, greatest)
    control = CONTROL.format(program="chtMultiRegionSimpleFoam", iterations=HEAT_ITERATIONS, functions=functions)
    _write(case, "system", "controlDict", control)
    regions = f"regions ( fluid ({' '.join(names)}) solid ({' '.join(solid_names)}) );\n"
    _write(case, "constant", "regionProperties", regions)
    _write(case, "constant", "g", FLUID_FILES["g"])


def _find_rate(part: PolyMesh, to: str, speed: float) -> float:
    """The volume, mm3/s, that enters a region."""
    corners = part.points[part.faces[part.number_faces(_openings(part)[_opposite(to)])]]
    return speed * float(np.linalg.norm(vector_areas(corners), axis=1).sum())


def _vector(to: str, speed: float) -> str:
    """A velocity to a side."""
    vector = ["0", "0", "0"]
    vector["XYZ".index(to[0])] = f"{speed if to[-1] == '+' else -speed:.9g}"
    return " ".join(vector)


def _write_flow_fields(case: Path, part: PolyMesh, to: str, speed: float) -> None:
    """Velocity, mm/s, and pressure over density, mm2/s2, of a channel whose fluid flows to the side `to`."""
    openings, driven = _openings(part), _is_driven(part, to)
    start = _vector(to, speed)
    velocities, pressures = _patch_types(part, "noSlip"), _patch_types(part, "zeroGradient")
    if not driven:
        velocities |= dict.fromkeys(openings[_opposite(to)], f"fixedValue; value uniform ({start})")
        velocities |= dict.fromkeys(openings[to], "zeroGradient")
        pressures |= dict.fromkeys(openings[to], "fixedValue; value uniform 0")
    _write_field(case, "0", "U", "0 1 -1 0 0 0 0", f"({start if driven else '0 0 0'})", velocities)
    _write_field(case, "0", "p", "0 2 -2 0 0 0 0", "0", pressures)


def _patch_types(part: PolyMesh, kind: str) -> dict[str, str]:
    """This type for each patch but cyclic ones."""
    return {patch.name: "cyclic" if patch.image else kind for patch in part.patches}


def _write_heat_fields(case: Path, part: PolyMesh, to: str | None, temperature: float) -> None:
    """Temperature, K, of a region, and the fields that the program reads beside it; `to` is None in a solid."""
    place = f"0/{name_for_foam(part.region)}"
    coupled = (
        "compressible::turbulentTemperatureCoupledBaffleMixed; Tnbr T; "
        f"kappaMethod {'solidThermo' if to is None else 'fluidThermo'}; value uniform {temperature:g}"
    )
    temperatures = _patch_types(part, "zeroGradient") | {patch.name: coupled for patch in part.patches if patch.other}
    if to is not None:
        entering = f"fixedValue; value uniform {temperature:g}"
        temperatures |= dict.fromkeys(_openings(part)[_opposite(to)], entering)
        _write_field(
            case, place, "U", "0 1 -1 0 0 0 0", "(0 0 0)", _patch_types(part, "calculated; value uniform (0 0 0)")
        )
        _write_field(
            case, place, "p_rgh", "1 -1 -2 0 0 0 0", "1e5", _patch_types(part, "calculated; value uniform 1e5")
        )
    _write_field(case, place, "T", "0 0 0 1 0 0 0", f"{temperature:g}", temperatures)
    _write_field(case, place, "p", "1 -1 -2 0 0 0 0", "1e5", _patch_types(part, "calculated; value uniform 1e5"))


def _write_field(case: Path, place: str, name: str, dimensions: str, start: str, types: Mapping[str, str]) -> None:
    """A field with its value at the start and the type of each patch."""
    rows = "".join(f"    {patch} {{ type {kind}; }}\n" for patch, kind in types.items())
    text = f"dimensions [{dimensions}];\ninternalField uniform {start};\nboundaryField\n{{\n{rows}}}\n"
    _write(case, place, name, text, "volVectorField" if name == "U" else "volScalarField")


def _write_solver(case: Path, place: str, solution: str) -> None:
    """Schemes and solvers of a region."""
    _write(case, place, "fvSchemes", SCHEMES)
    _write(case, place, "fvSolution", solution)


def _write(case: Path, place: str, name: str, text: str, kind: str = "dictionary") -> None:
    """One file with OpenFOAM's header."""
    folder = case / place
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(HEADER.format(kind=kind, place=place, name=name) + text, encoding="ascii", newline="\n")
