"""A case of OpenFOAM for steady laminar flow with conjugate heat transfer on the groups of a mesh as regions.

Properties are constant, so that the flow does not depend on temperature: `simpleFoam` solves it in each channel, and
`chtMultiRegionSimpleFoam` takes its fluxes as frozen and solves the heat of all regions, coupled at their interfaces. (That
program's own flow is unstable on tetrahedra, where it reconstructs velocities from fluxes.) A fluid enters its channel at
the openings of one side of the body and leaves at those of the opposite side; other openings are closed.

A channel of a periodic mesh has no ends: a body force drives the flow, and the case is one of flow alone.

Residuals fall to round-off only with schemes that are linear in the solution: gradients have no limiter. On tetrahedra the
correction of pressure for faces that are not orthogonal is as large as what it corrects; SIMPLE with its usual relaxation of 0.3
converges where its consistent variant, without relaxation of the pressure, does not. Gradients interpolate through points: linear
interpolation between the centres of tetrahedra misses those of their faces, by a tenth of the permeability.

Lengths are in mm. Densities are 1, so that heat capacities are those of volumes, mJ/(mm3 K); conductivities are in W/(m K),
and heat flows in mW. The texts of the dictionaries and of the script `Allrun` are files of the folder `openfoam_templates`, with
values in place of ``@{name}``. Tested with OpenFOAM v1912 (Debian's `openfoam`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

import numpy as np

from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.mesh_arrays import AXES, MeshArrays
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

TEMPLATES = Path(__file__).parent / "openfoam_templates"

WATER_DENSITY = 997.0
"""kg/m3."""

WATER_VISCOSITY = 0.853
"""mm2/s, kinematic, at 300 K."""

WATER_HEAT_CAPACITY = 4.167
"""mJ/(mm3 K)."""

PASCAL_PER_UNIT = 1e-6 * WATER_DENSITY
"""Pa per mm2/s2 of pressure over density."""

FLOW_ITERATIONS, HEAT_ITERATIONS = 1000, 4000
"""At most."""

HEAT_WINDOW = 20
"""Iterations whose mean the heat of a channel may not leave at convergence."""

HEAT_TOLERANCE = 1e-4
"""Part of the greatest heat that may flow, of the imbalance and of the change of a channel's heat at convergence."""

IN, OUT, OPENINGS, INTERFACES = "inlets", "outlets", "openings", "interfaces"
"""Zones of faces."""

OPPOSITE = {"+": "-", "-": "+"}

HOT, COLD, MIDDLE = 350.0, 300.0, 325.0
"""Kelvin at which the fluid enters the first and the other channels, and at which solids start."""


class _CaseTemplate(Template):
    """A text with values in place of ``@{name}``."""

    delimiter = "@"


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
    script = _fill_template("Allrun/head")
    is_driven = _is_driven(fluids[0], flow[fluids[0].region])
    for name, part in zip(names, fluids, strict=True):
        to, openings = flow[part.region], _openings(part)
        zones = {IN: part.number_faces(openings.get(_opposite(to), ())), OUT: part.number_faces(openings.get(to, ()))}
        zones[OPENINGS] = np.concatenate([zones[IN], zones[OUT]])
        zones[INTERFACES] = part.number_faces([patch.name for patch in part.patches if patch.other])
        write_poly_mesh(part, case / "constant" / name / "polyMesh", {} if is_driven else zones)
        below = case / "flow" / name
        _fill_folder(below, "constant", "flow", viscosity=WATER_VISCOSITY)
        _write_solver(below, "system", "Flow")
        script += _fill_template("Allrun/flow", region=name)
        if is_driven:
            functions = ""
            _fill_folder(below, "constant", "driven", velocity=_vector(to, speed))
            period = abs(float(mesh.translation(to[0].lower())["XYZ".index(to[0])]))
            scale = f"{period * PASCAL_PER_UNIT:.9g}"
            script += _fill_template("Allrun/pressureDropOfPeriod", region=name, scale=scale)
        else:
            functions = _fill_template("functions/pressureDrop", pascal=f"{PASCAL_PER_UNIT:g}")
            script += _fill_template("Allrun/pressureDropBetween", region=name)
        _write_control(below, "simpleFoam", FLOW_ITERATIONS, functions)
        _write_flow_fields(below, part, to, speed)
    if not is_driven:
        _write_heat(case, fluids, solids, flow, speed)
        solid_names = " ".join(name_for_foam(part.region) for part in solids)
        script += _fill_template("Allrun/heat", fluids=" ".join(names), solids=solid_names, iterations=HEAT_ITERATIONS)
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
        water = {"viscosity": WATER_VISCOSITY, "heat_capacity": WATER_HEAT_CAPACITY}
        _fill_folder(case, f"constant/{name}", "solid" if to is None else "fluid", **water)
        _write_solver(case, f"system/{name}", "Heat")
        _write_heat_fields(case, part, to, MIDDLE if to is None else HOT if next(iter(flow)) == part.region else COLD)
    _write_solver(case, "system", "Heat")
    greatest = (HOT - COLD) * WATER_HEAT_CAPACITY * min(_find_rate(part, flow[part.region], speed) for part in fluids)
    names, solid_names = ([name_for_foam(part.region) for part in parts] for parts in (fluids, solids))
    functions = _balance_heat(names, solid_names, greatest)
    _write_control(case, "chtMultiRegionSimpleFoam", HEAT_ITERATIONS, functions)
    regions = f"regions ( fluid ({' '.join(names)}) solid ({' '.join(solid_names)}) );\n"
    _write(case, "constant", "regionProperties", regions)
    _write(case, "constant", "g", _fill_template("fluid/g"))


def _balance_heat(fluids: Sequence[str], solids: Sequence[str], greatest: float) -> str:
    """The function objects of the heat of each fluid, of the imbalance of each solid, and of convergence.

    `greatest` is the heat that flows at most, mW. A fluid takes up heat through its interfaces; the enthalpy that leaves through
    its openings beyond what enters differs by conduction through the inlets. The imbalance is the heat that stays in a solid.
    """
    names = {name: f"heat_{name}" for name in fluids} | {name: f"imbalance_{name}" for name in solids}
    objects = [_fill_template("functions/heat", region=region, balance=name) for region, name in names.items()]
    objects += [_fill_template("functions/enthalpy", region=name) for name in fluids]
    heat, limit = f"areaIntegrate({INTERFACES},wallHeatFlux)", HEAT_TOLERANCE * greatest
    limits = [
        (name, f"average; functionObject heat_{name}; tolerance {limit:.6g}; window {HEAT_WINDOW}; windowType exact")
        for name in fluids
    ]
    limits += [
        (f"{name}_{mode}", f"minMax; functionObject imbalance_{name}; mode {mode}; value {value:.6g}")
        for name in solids
        for mode, value in (
            ("minimum", limit),
            ("maximum", -limit),
        )  # satisfied below a "minimum" and above a "maximum"
    ]
    conditions = "".join(
        f"            {name} {{ type {what}; fields ({heat}); groupID 1; }}\n" for name, what in limits
    )
    return "".join(objects) + _fill_template("functions/convergence", region=fluids[0], conditions=conditions)


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


def _write_solver(case: Path, place: str, of: str) -> None:
    """Schemes and solvers of a region for "Flow" or "Heat"."""
    _write(case, place, "fvSchemes", _fill_template("fvSchemes"))
    _write(case, place, "fvSolution", _fill_template(f"fvSolutionOf{of}"))


def _write_control(case: Path, program: str, iterations: int, functions: str) -> None:
    """The control of a program."""
    control = _fill_template("controlDict", program=program, iterations=iterations, functions=functions)
    _write(case, "system", "controlDict", control)


def _fill_folder(case: Path, place: str, templates: str, **values: object) -> None:
    """The files of a folder of templates."""
    for file in sorted((TEMPLATES / templates).iterdir()):
        _write(case, place, file.name, _fill_template(f"{templates}/{file.name}", **values))


def _fill_template(name: str, **values: object) -> str:
    """The text of a template with its values."""
    return _CaseTemplate((TEMPLATES / name).read_text(encoding="ascii")).substitute(values)


def _write(case: Path, place: str, name: str, text: str, kind: str = "dictionary") -> None:
    """One file with OpenFOAM's header."""
    folder = case / place
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(HEADER.format(kind=kind, place=place, name=name) + text, encoding="ascii", newline="\n")
