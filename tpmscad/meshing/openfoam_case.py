"""A case of OpenFOAM for steady laminar flow with conjugate heat transfer on the groups of a mesh as regions.

Properties are constant, so that the flow does not depend on temperature: `simpleFoam` solves it in each channel, and
`chtMultiRegionSimpleFoam` takes its fluxes as frozen and solves the heat of all regions, coupled at their interfaces. (That
program's own flow is unstable on tetrahedra, where it reconstructs velocities from fluxes.) A fluid enters its channel at
the openings of one side of the body and leaves at those of the opposite side; other openings are closed.

Lengths are in mm. Densities are 1, so that heat capacities are those of volumes, mJ/(mm3 K); conductivities are in W/(m K),
and heat flows in mW. Tested with OpenFOAM v1912 (Debian's `openfoam`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.mesh_arrays import MeshArrays
from tpmscad.meshing.poly_meshes import HEADER, PolyMesh, divide_regions, name_for_foam, write_poly_mesh

MILLIMETRES_PER_METRE = 1e3

OPPOSITE = {"+": "-", "-": "+"}

HOT, COLD, MIDDLE = 350.0, 300.0, 325.0
"""Kelvin at which the fluid enters the first and the other channels, and at which solids start."""

FLOW_ITERATIONS, HEAT_ITERATIONS = 1000, 4000
"""Iterations at most, and always: a solid that conducts well takes on the temperature of its channels in some hundreds."""

CONTROL = """application     {program};
startFrom       startTime;
startTime       0;
stopAt          endTime;
endTime         {iterations};
deltaT          1;
writeControl    timeStep;
writeInterval   {iterations};
writeFormat     ascii;
writePrecision  12;
"""

SCHEMES = """ddtSchemes { default steadyState; }
gradSchemes { default Gauss linear; limited cellLimited Gauss linear 1; }
divSchemes
{
    default Gauss linear;
    div(phi,U) bounded Gauss linearUpwind limited;
    div(phi,h) bounded Gauss linearUpwind limited;
}
laplacianSchemes { default Gauss linear limited 0.5; }
interpolationSchemes { default linear; }
snGradSchemes { default limited 0.5; }
"""

FLOW_SOLUTION = """solvers
{
    p { solver GAMG; smoother GaussSeidel; tolerance 1e-10; relTol 0.01; }
    U { solver PBiCGStab; preconditioner DILU; tolerance 1e-12; relTol 0.01; }
}
SIMPLE { consistent yes; nNonOrthogonalCorrectors 1; residualControl { p 1e-6; U 1e-6; } }
relaxationFactors { equations { U 0.9; } }
"""
HEAT_SOLUTION = """solvers
{
    h { solver PBiCGStab; preconditioner diagonal; tolerance 1e-12; relTol 1e-3; }
}
SIMPLE { nNonOrthogonalCorrectors 1; frozenFlow true; }
relaxationFactors { equations { h 0.95; } }
"""

FLOW_FILES = {
    "transportProperties": "transportModel Newtonian;\nnu 0.853;  // mm2/s: water at 300 K; pressures are over the density\n",
    "turbulenceProperties": "simulationType laminar;\n",
}
"""Files of flow/REGION/constant."""

THERMO = """thermoType
{{
    type {kind}; mixture pureMixture; transport {transport}; thermo hConst;
    equationOfState rhoConst; specie specie; energy sensibleEnthalpy;
}}
mixture
{{
    specie {{ molWeight 1; }}
    equationOfState {{ rho 1; }}
    {values}
}}
"""
WATER = "thermodynamics { Cp 4.167; Hf 0; }     // mJ/(mm3 K)\n    transport { mu 0.853; Pr 5.83; }  // conductivity = Cp mu / Pr"
ALUMINIUM = "thermodynamics { Cp 2.43; Hf 0; }   // mJ/(mm3 K)\n    transport { kappa 200; }       // W/(m K)"
FLUID_FILES = {
    "thermophysicalProperties": THERMO.format(kind="heRhoThermo", transport="const", values=WATER),
    "turbulenceProperties": "simulationType laminar;\n",
    "radiationProperties": "radiationModel none;\n",
    "g": "dimensions [0 1 -2 0 0 0 0];\nvalue (0 0 0);\n",
}
SOLID_FILES = {
    "thermophysicalProperties": THERMO.format(kind="heSolidThermo", transport="constIso", values=ALUMINIUM),
    "radiationProperties": "radiationModel none;\n",
}
"""Files of constant/REGION."""

RUN_HEAD = """#!/bin/sh
set -e
cd "$(dirname "$0")"
export WM_PROJECT_DIR="${WM_PROJECT_DIR:-/usr/share/openfoam}"  # Debian's place
"""
RUN_FLOW = """mkdir -p flow/{0}/constant/polyMesh
cp constant/{0}/polyMesh/* flow/{0}/constant/polyMesh
simpleFoam -case flow/{0}
last=$(ls flow/{0} | grep '^[1-9][0-9]*$' | sort -n | tail -1)
sed 's/\\[0 3 -1 0 0 0 0\\]/[1 0 -1 0 0 0 0]/' "flow/{0}/$last/phi" > 0/{0}/phi
"""


def write_openfoam_case(mesh: MeshArrays, folder: Path, flow: Mapping[str, str] | None, velocity: float) -> None:
    """Write the folder, complete or not at all; InvalidRequest if it holds something, or the flow does not fit the mesh.

    `flow` names for each group of elements with a fluid the side that it flows to: "X+".
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidRequest(f"{folder} is not an empty folder: give the name of a new one")
    parts = divide_regions(mesh)
    directions = _choose_flow(parts) if flow is None else dict(flow)
    _check_flow(parts, directions)
    with atomic_write(folder) as aside:
        _write_case(aside, parts, directions, velocity)


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


def _choose_flow(parts: list[PolyMesh]) -> dict[str, str]:
    """Counterflow: each region with openings at both sides of an axis flows along the first one, by turns to and fro."""
    found: dict[str, str] = {}
    for part in parts:
        sides = _openings(part)
        through = [side for side in sides if _opposite(side) in sides]
        if through:
            found[part.region] = min(through)[:-1] + "+-"[len(found) % 2]
    return found


def _check_flow(parts: list[PolyMesh], flow: Mapping[str, str]) -> None:
    """Refuse a flow through no region, or from and to sides where there is no opening."""
    known = {part.region: _openings(part) for part in parts}
    if not flow:
        raise InvalidRequest(
            "no group of elements has openings at two opposite sides: a case needs a channel of fluid_domains"
        )
    for region, side in flow.items():
        if region not in known:
            raise InvalidRequest(f"flow: {region!r} is no group of elements; they are {', '.join(map(repr, known))}")
        if not {side, _opposite(side)} <= set(known[region]):
            there = ", ".join(sorted(known[region])) or "no side"
            raise InvalidRequest(
                f'flow: {region!r} cannot flow to {side!r}: it is open at {there}; name a side as in "X+"'
            )


def _write_case(case: Path, parts: list[PolyMesh], flow: Mapping[str, str], velocity: float) -> None:
    """All files of the case."""
    fluids = [name_for_foam(part.region) for part in parts if part.region in flow]
    solids = [name_for_foam(part.region) for part in parts if part.region not in flow]
    for part in parts:
        name, to = name_for_foam(part.region), flow.get(part.region)
        write_poly_mesh(part, case / "constant" / name / "polyMesh")
        for file, text in (SOLID_FILES if to is None else FLUID_FILES).items():
            _write(case, f"constant/{name}", file, text)
        _write_solver(case, f"system/{name}", HEAT_SOLUTION)
        _write_heat_fields(case, part, to, MIDDLE if to is None else HOT if next(iter(flow)) == part.region else COLD)
        if to is not None:
            below = case / "flow" / name
            for file, text in FLOW_FILES.items():
                _write(below, "constant", file, text)
            _write_solver(below, "system", FLOW_SOLUTION)
            _write(below, "system", "controlDict", CONTROL.format(program="simpleFoam", iterations=FLOW_ITERATIONS))
            _write_flow_fields(below, part, to, MILLIMETRES_PER_METRE * velocity)
    _write_solver(case, "system", HEAT_SOLUTION)
    _write(
        case, "system", "controlDict", CONTROL.format(program="chtMultiRegionSimpleFoam", iterations=HEAT_ITERATIONS)
    )
    regions = f"regions ( fluid ({' '.join(fluids)}) solid ({' '.join(solids)}) );\n"
    _write(case, "constant", "regionProperties", regions)
    _write(case, "constant", "g", FLUID_FILES["g"])
    (case / "case.foam").touch()  # what ParaView opens
    checks = "".join(f"checkMesh -region {name}\n" for name in fluids + solids)
    runs = "".join(RUN_FLOW.format(name) for name in fluids)
    script = f"{RUN_HEAD}{checks}{runs}chtMultiRegionSimpleFoam\n"
    (case / "Allrun").write_text(script, encoding="ascii", newline="\n")
    (case / "Allrun").chmod(0o755)


def _write_flow_fields(case: Path, part: PolyMesh, to: str, speed: float) -> None:
    """Velocity, mm/s, and pressure over density, mm2/s2, of a channel whose fluid flows to the side `to`."""
    openings = _openings(part)
    vector = ["0", "0", "0"]
    vector["XYZ".index(to[0])] = f"{speed if to[-1] == '+' else -speed:.9g}"
    names = [patch.name for patch in part.patches]
    entering = f"fixedValue; value uniform ({' '.join(vector)})"
    velocities = dict.fromkeys(names, "noSlip") | dict.fromkeys(openings[_opposite(to)], entering)
    velocities |= dict.fromkeys(openings[to], "zeroGradient")
    _write_field(case, "0", "U", "0 1 -1 0 0 0 0", "(0 0 0)", velocities)
    pressures = dict.fromkeys(names, "zeroGradient") | dict.fromkeys(openings[to], "fixedValue; value uniform 0")
    _write_field(case, "0", "p", "0 2 -2 0 0 0 0", "0", pressures)


def _write_heat_fields(case: Path, part: PolyMesh, to: str | None, temperature: float) -> None:
    """Temperature, K, of a region, and the fields that the program reads beside it; `to` is None in a solid."""
    place, names = f"0/{name_for_foam(part.region)}", [patch.name for patch in part.patches]
    coupled = (
        "compressible::turbulentTemperatureCoupledBaffleMixed; Tnbr T; "
        f"kappaMethod {'solidThermo' if to is None else 'fluidThermo'}; value uniform {temperature:g}"
    )
    temperatures = {patch.name: coupled if patch.other else "zeroGradient" for patch in part.patches}
    if to is not None:
        entering = f"fixedValue; value uniform {temperature:g}"
        temperatures |= dict.fromkeys(_openings(part)[_opposite(to)], entering)
        _write_field(
            case, place, "U", "0 1 -1 0 0 0 0", "(0 0 0)", dict.fromkeys(names, "calculated; value uniform (0 0 0)")
        )
        _write_field(
            case, place, "p_rgh", "1 -1 -2 0 0 0 0", "1e5", dict.fromkeys(names, "calculated; value uniform 1e5")
        )
    _write_field(case, place, "T", "0 0 0 1 0 0 0", f"{temperature:g}", temperatures)
    _write_field(case, place, "p", "1 -1 -2 0 0 0 0", "1e5", dict.fromkeys(names, "calculated; value uniform 1e5"))


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
