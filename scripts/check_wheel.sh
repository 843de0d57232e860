#!/usr/bin/env bash
# Builds the source archive and from it the wheel, installs the wheel in a fresh virtual environment, and makes and checks a solid
# in an empty folder, without the source tree.
#
#     pip install build && scripts/check_wheel.sh [EXTRA...]     # each extra in an environment of its own: scripts/check_wheel.sh mesh cadquery
set -euo pipefail

tree=$(cd "$(dirname "$0")/.." && pwd)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python -m build --outdir "$folder/dist" "$tree" >"$folder/build.log" || { cat "$folder/build.log" >&2; exit 1; }
wheel=$(echo "$folder"/dist/*.whl)
ls -s --block-size=1K "$folder/dist"

check() { # an extra, or nothing
    local home="$folder/venv${1:+-$1}"
    python -m venv "$home"
    "$home/bin/pip" install -q --no-compile "$wheel${1:+[$1]}"
    mkdir -p "$home/out"
    (
        cd "$home/out"
        unset PYTHONPATH
        "$home/bin/python" -c "
import pathlib, tpmscad
assert pathlib.Path(tpmscad.__file__).is_relative_to('$home'), tpmscad.__file__
assert pathlib.Path(tpmscad.__file__).with_name('py.typed').exists()"
        "$home/bin/tpmscad" lattice gyroid --cell 10 --thickness 1 --tol 0.05 -o gyroid.step
        "$home/bin/tpmscad" check gyroid.step
        "$home/bin/tpmscad" template solidify > /dev/null
    )
    rm -rf "$home"
}

check
for extra in "$@"; do
    echo "with $extra"
    check "$extra"
done
echo "the wheel works"
