#!/usr/bin/env bash
# Builds the source archive and from it the wheel, installs the wheel in a fresh virtual environment, and makes and checks a solid
# in an empty folder, without the source tree. Then the extras are installed in turn, and what each is for is tried once.
#
#     pip install build && scripts/check_wheel.sh [EXTRA...]     # default: mesh simulation images tables plot docs
#
# The extra cadquery needs another kernel, and so an environment of its own: scripts/check_wheel.sh cadquery
set -euo pipefail

tree=$(cd "$(dirname "$0")/.." && pwd)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python -m build --outdir "$folder/dist" "$tree" >"$folder/build.log" || { cat "$folder/build.log" >&2; exit 1; }
wheel=$(echo "$folder"/dist/*.whl)
ls -s --block-size=1K "$folder/dist"

home="$folder/venv"
python -m venv "$home"
mkdir "$home/out"
cd "$home/out"
unset PYTHONPATH
export PATH="$home/bin:$PATH"

install() { # an extra, or nothing
    pip install -q --no-compile "$wheel${1:+[$1]}"
}

try() { # what an extra is for
    case $1 in
    cadquery)
        python -c "
import cadquery as cq, cq_plugins.tpms
gyroid = cq.Workplane().tpms('gyroid', cell=10, thickness=1, tol=0.05)
cq.exporters.export(gyroid, 'cadquery.step')" ;;
    docs) python -c "import furo, myst_parser, numpydoc, sphinx" ;;
    images)
        python -c "
import nrrd, numpy
nrrd.write('ball.nrrd', 1.5 - numpy.linalg.norm(numpy.mgrid[-2:2:9j, -2:2:9j, -2:2:9j], axis=0))"
        tpmscad solidify ball.nrrd --level 0 --spacing 0.5 --tol 0.05 -o ball.stl ;;
    mesh) tpmscad mesh gyroid.step --size 2 --order 1 -o gyroid.msh ;;
    plot)
        python -c "
from tpmscad import fields, topology
rods = fields.rod(fields.tpms('schwarz_p', period=1), -0.8)
topology.persistence_diagram(rods, ((0, 0, 0), (1, 1, 1)), (11, 11, 11)).plot_diagram().figure.savefig('diagram.png')" ;;
    simulation) tpmscad homogenize P --volume-fraction 0.2 ;;
    tables)
        printf 'surface,cell,thickness,tol\nP,10,1,0.1\n' >designs.csv
        python -c "
import pyarrow.csv, pyarrow.parquet
pyarrow.parquet.write_table(pyarrow.csv.read_csv('designs.csv'), 'designs.parquet')"
        tpmscad sweep designs.parquet -o results.csv ;;
    *) echo "nothing to try with the extra $1" ;;
    esac
}

if [[ " $* " != *" cadquery "* ]]; then install; else install cadquery; fi
python -c "
import pathlib, tpmscad
assert pathlib.Path(tpmscad.__file__).is_relative_to('$home'), tpmscad.__file__
assert pathlib.Path(tpmscad.__file__).with_name('py.typed').exists()"
tpmscad lattice gyroid --cell 10 --thickness 1 --tol 0.05 -o gyroid.step
tpmscad check gyroid.step
tpmscad template solidify >/dev/null
for extra in ${@:-mesh simulation images tables plot docs}; do
    echo "with $extra"
    [[ $extra == cadquery ]] || install "$extra"
    try "$extra"
done
echo "the wheel works"
