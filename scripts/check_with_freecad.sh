#!/usr/bin/env bash
# Opens STEP files in FreeCAD, whose OCCT is older than ours (7.6 in Debian 12), and checks that each holds valid, closed
# solids of positive volume. Exit status 1 if one does not.
#
#     apt-get install --no-install-recommends freecad-python3     # 162 packages, 1.3 GB, under a minute
#     scripts/check_with_freecad.sh gyroid.step ...
set -euo pipefail

[ $# -gt 0 ] || { echo "usage: $0 FILE.step ..." >&2; exit 2; }
command -v freecadcmd >/dev/null || {
    echo "$0: freecadcmd not found: apt-get install --no-install-recommends freecad-python3" >&2
    exit 2
}

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat >"$folder/check.py" <<'PYTHON'
import os
import sys

import FreeCAD
import Part

def line_of(path):
    shape = Part.Shape()
    shape.read(path)
    shape.check()  # raises, naming what the kernel finds wrong
    solids = shape.Solids
    sound = solids and all(solid.isValid() and solid.isClosed() and solid.Volume > 0 for solid in solids)
    loose = len(shape.Faces) - sum(len(solid.Faces) for solid in solids)
    line = "%d solids, %d faces, volume %.9g, area %.9g" % (len(solids), len(shape.Faces), shape.Volume, shape.Area)
    if not sound or loose:
        raise ValueError("not sound: %s, %d faces outside solids" % (line, loose))
    return line

try:
    for path in os.environ["STEP_FILES"].split(os.pathsep):
        print("freecad %s: %s: %s" % (".".join(FreeCAD.Version()[:3]), path, line_of(path)))
    print("freecad agrees")
except Exception as error:
    print("freecad: %s: %s" % (path, error))
sys.stdout.flush()
os._exit(0)  # FreeCAD's own ending knows no status
PYTHON

files=()
for file in "$@"; do
    files+=("$(realpath -e "$file")")
done
answer=$(STEP_FILES=$(IFS=:; echo "${files[*]}") freecadcmd "$folder/check.py" </dev/null 2>&1 || true)
grep "^freecad[ :]" <<<"$answer" || echo "$answer"
grep -q '^freecad agrees' <<<"$answer"
