"""A type checker on a user's script finds misspelt names and wrong types, and nothing else."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mypy", reason="mypy is not installed: pip install '.[dev]'")

ROOT = Path(__file__).resolve().parents[1]

SCRIPT = """
import tpmscad
from tpmscad import fields, maps
from tpmscad.build123d import Tpms

model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1, map=maps.cylinder(20))
model.export("gyroid.step")
volume: float = model.certificate.volume
field = fields.tpms("gyroid", period=10)
tpmscad.solidify(fields.rod(field, 0.2), ((0, 0, 0), (10, 10, 10)), tol=0.05)
tpmscad.infill("body.step", "gyroid", cell=8, thickness=1, skin=1.5, open_faces=">Z")

tpmscad.latice("gyroid", cell=10)  # wrong
tpmscad.lattice("gyroid", cel=10)  # wrong
tpmscad.lattice("gyroid", cell="ten")  # wrong
tpmscad.lattice(5, cell=10)  # wrong
tpmscad.infill("body.step", "gyroid", cell=8, skn=1)  # wrong
tpmscad.infill("body.step", "gyroid", cell=8, skin="thick")  # wrong
tpmscad.fluid_domains("body.step", "gyroid", cell=8, thicknes=1)  # wrong
tpmscad.solidify(field, ((0, 0, 0), (10, 10, 10)), toll=0.05)  # wrong
tpmscad.solidify("field", ((0, 0, 0), (10, 10, 10)))  # wrong
tpmscad.struts("octet", cell=10, diametre=1)  # wrong
fields.tpms("gyroid", periode=10)  # wrong
fields.tpms("gyroid", period="ten")  # wrong
fields.rood(field, 0.2)  # wrong
maps.cylindre(20)  # wrong
maps.cylinder("20")  # wrong
model.certificate.volum  # wrong
model.certificate.volume.upper()  # wrong
model.exprt("gyroid.step")  # wrong
model.export(3)  # wrong
tpmscad.homogenize("gyroid", porosty=0.8)  # wrong
tpmscad.InvalidReqest  # wrong
Tpms("gyroid", cel=10)  # wrong
"""


@pytest.mark.slow
def test_misspelt_names_and_wrong_types_are_found_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, "-m", "mypy", "--config-file=", f"--cache-dir={tmp_path / 'cache'}", "script.py"]
    environment = {**os.environ, "MYPYPATH": str(ROOT)}
    answer = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    found = {int(number) for number in re.findall(r"^script\.py:(\d+): error", answer.stdout, re.MULTILINE)}
    lines = SCRIPT.splitlines()
    wrong = {number for number, line in enumerate(lines, 1) if line.endswith("# wrong")}
    assert sorted(lines[number - 1] for number in wrong ^ found) == [], answer.stdout + answer.stderr
