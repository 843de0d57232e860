"""Texts of a case of OpenFOAM: control and schemes, properties of water and aluminium, function objects, and the script `Allrun`.

Residuals fall to round-off only with schemes that are linear in the solution: gradients have no limiter. On tetrahedra the
correction of pressure for faces that are not orthogonal is as large as what it corrects; SIMPLE with its usual relaxation of 0.3
converges where its consistent variant, without relaxation of the pressure, does not. Gradients interpolate through points: linear
interpolation between the centres of tetrahedra misses those of their faces, by a tenth of the permeability.

Lengths are in mm. Densities are 1, so that heat capacities are those of volumes, mJ/(mm3 K); conductivities are in W/(m K),
and heat flows in mW. Tested with OpenFOAM v1912 (Debian's `openfoam`).
"""

from __future__ import annotations

from collections.abc import Sequence

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

RESIDUAL = 1e-6
"""Initial residuals of pressure and velocity at which the flow has converged."""

HEAT_WINDOW = 20
"""Iterations whose mean the heat of a channel may not leave at convergence."""

HEAT_TOLERANCE = 1e-4
"""Part of the greatest heat that may flow, of the imbalance and of the change of a channel's heat at convergence."""

IN, OUT, OPENINGS, INTERFACES = "inlets", "outlets", "openings", "interfaces"
"""Zones of faces."""

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
functions
{{
{functions}}}
"""

SCHEMES = """ddtSchemes { default steadyState; }
gradSchemes { default Gauss pointLinear; }
divSchemes
{
    default Gauss linear;
    div(phi,U) bounded Gauss linearUpwind default;
    div(phi,h) bounded Gauss linearUpwind default;
}
laplacianSchemes { default Gauss linear limited 0.5; }
interpolationSchemes { default linear; }
snGradSchemes { default limited 0.5; }
"""

FLOW_SOLUTION = f"""solvers
{{
    p {{ solver GAMG; smoother GaussSeidel; tolerance 1e-12; relTol 0.001; }}
    U {{ solver PBiCGStab; preconditioner DILU; tolerance 1e-12; relTol 0.01; }}
}}
SIMPLE
{{
    nNonOrthogonalCorrectors 2;
    pRefCell 0;
    pRefValue 0;
    residualControl {{ p {RESIDUAL}; U {RESIDUAL}; }}
}}
relaxationFactors {{ fields {{ p 0.3; }} equations {{ U 0.8; }} }}
"""

HEAT_SOLUTION = """solvers
{
    h { solver PBiCGStab; preconditioner diagonal; tolerance 1e-12; relTol 1e-3; }
}
SIMPLE { nNonOrthogonalCorrectors 1; frozenFlow true; }
relaxationFactors { equations { h 1; } }  // below 1 the mean temperature of a solid lags by thousands of iterations
"""

FLOW_FILES = {
    "transportProperties": f"transportModel Newtonian;\nnu {WATER_VISCOSITY};  // mm2/s; pressures are over the density\n",
    "turbulenceProperties": "simulationType laminar;\n",
}
"""Files of flow/REGION/constant."""

DRIVING_FORCE = """driving
{{
    type meanVelocityForce; selectionMode all; fields (U); Ubar ({velocity}); relaxation 1;
}}
"""
"""flow/REGION/constant/fvOptions of a periodic channel: a body force that keeps the mean velocity over the fluid."""

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
WATER = (
    f"thermodynamics {{ Cp {WATER_HEAT_CAPACITY}; Hf 0; }}     // mJ/(mm3 K)\n"
    f"    transport {{ mu {WATER_VISCOSITY}; Pr 5.83; }}  // conductivity = Cp mu / Pr"
)
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

ZONE_VALUE = (
    "type surfaceFieldValue; libs (fieldFunctionObjects); regionType faceZone; name {zone}; writeFields false; "
    "fields ({field}); operation {operation};"
)
"""A value of one zone of faces."""

PRESSURE_DROP = """    pressureDrop  // Pa
    {{
        type fieldValueDelta; libs (fieldFunctionObjects); operation subtract; log true;
        region1 {{ {first} }}
        region2 {{ {second} }}
    }}
"""

HEAT_OF_REGION = """    wallHeatFlux_{region}
    {{
        region {region}; type wallHeatFlux; libs (fieldFunctionObjects); writeControl writeTime;
    }}
    {name}  // mW through the interfaces into this region
    {{
        region {region}; {through} log true;
    }}
"""

ENTHALPY_OF_FLUID = """    enthalpy_{region}  // mW that this fluid carries out of its openings beyond what it carries in
    {{
        region {region}; {carried} log true;
    }}
"""

CONVERGENCE = """    convergence
    {{
        region {region}; type runTimeControl; libs (utilityFunctionObjects); satisfiedAction end;
        conditions
        {{
{conditions}        }}
    }}
"""


def pressure_drop() -> str:
    """The function object of the pressure drop of a channel, inlets less outlets, Pa."""
    first, second = (
        ZONE_VALUE.format(zone=zone, field="p", operation=f"areaAverage; scaleFactor {PASCAL_PER_UNIT:g}")
        for zone in (IN, OUT)
    )
    return PRESSURE_DROP.format(first=first, second=second)


def heat_balance(fluids: Sequence[str], solids: Sequence[str], greatest: float) -> str:
    """The function objects of the heat of each fluid, of the imbalance of each solid, and of convergence.

    `greatest` is the heat that flows at most, mW. A fluid takes up heat through its interfaces; the enthalpy that leaves through
    its openings beyond what enters differs by conduction through the inlets. The imbalance is the heat that stays in a solid.
    """
    through = ZONE_VALUE.format(zone=INTERFACES, field="wallHeatFlux", operation="areaIntegrate")
    carried = ZONE_VALUE.format(zone=OPENINGS, field="h", operation="weightedSum; weightField phi")
    names = {name: f"heat_{name}" for name in fluids} | {name: f"imbalance_{name}" for name in solids}
    lines = [HEAT_OF_REGION.format(region=region, name=name, through=through) for region, name in names.items()]
    lines += [ENTHALPY_OF_FLUID.format(region=name, carried=carried) for name in fluids]
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
    conditions = [f"{name} {{ type {what}; fields ({heat}); groupID 1; }}" for name, what in limits]
    block = "".join(f"            {line}\n" for line in conditions)
    return "".join(lines) + CONVERGENCE.format(region=fluids[0], conditions=block)


ALLRUN_HEAD = """#!/bin/sh
set -e
cd "$(dirname "$0")"
export WM_PROJECT_DIR="${WM_PROJECT_DIR:-/usr/share/openfoam}"  # Debian's place

run() {  # LOG COMMAND...
    log="$1"; shift
    "$@" > "$log" 2>&1 || { tail -n 20 "$log"; fail "$* fails: see $log"; }
}
fail() { echo "$1" >&2; exit 1; }
last() { awk 'END { print $NF }' "$@"; }
"""

ALLRUN_FLOW = """
mkdir -p flow/{0}/constant
ln -sfn ../../../constant/{0}/polyMesh flow/{0}/constant/polyMesh
run flow/{0}/log.checkMesh checkMesh -case flow/{0}
echo "{0}: $(grep -E '^(Mesh OK|Failed)' flow/{0}/log.checkMesh)"
run flow/{0}/log.simpleFoam simpleFoam -case flow/{0}
grep -q 'SIMPLE solution converged' flow/{0}/log.simpleFoam ||
    fail "{0}: the flow has NOT converged; give it a smaller velocity, or a mesh of smaller elements"
echo "{0}: the flow $(grep -o 'converged in .*' flow/{0}/log.simpleFoam)"
time=$(grep '^Time = ' flow/{0}/log.simpleFoam | last)
{drop}
"""

PRESSURE_DROP_BETWEEN = """echo "{0}: pressure drop $(last flow/{0}/postProcessing/pressureDrop/0/*.dat) Pa"
sed 's/\\[0 3 -1 0 0 0 0\\]/[1 0 -1 0 0 0 0]/' "flow/{0}/$time/phi" > 0/{0}/phi"""

PRESSURE_DROP_OF_PERIOD = """gradient=$(grep 'pressure gradient = ' flow/{0}/log.simpleFoam | last)
echo "{0}: pressure drop $(echo "$gradient" | awk '{{ print $1 * {scale:.9g} }}') Pa over a period\""""

ALLRUN_HEAT = """
for solid in {solids}; do
    run "log.checkMesh.$solid" checkMesh -region "$solid"
    echo "$solid: $(grep -E '^(Mesh OK|Failed)' "log.checkMesh.$solid")"
done
run log.chtMultiRegionSimpleFoam chtMultiRegionSimpleFoam
for fluid in {fluids}; do
    echo "$fluid: takes up $(last postProcessing/"$fluid"/heat_"$fluid"/0/*.dat) mW," \\
        "carries away $(last postProcessing/"$fluid"/enthalpy_"$fluid"/0/*.dat) mW"
done
for solid in {solids}; do
    echo "$solid: imbalance $(last postProcessing/"$solid"/imbalance_"$solid"/0/*.dat) mW"
done
grep -q 'Stopping calculation' log.chtMultiRegionSimpleFoam ||
    fail "the heat has NOT converged in {iterations} iterations: raise endTime in system/controlDict, or use smaller elements"
echo "the heat converged in $(grep '^Time = ' log.chtMultiRegionSimpleFoam | last) iterations"
"""
