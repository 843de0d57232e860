"""The scripts of the README run as they stand there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.kernel

README = (Path(__file__).resolve().parent.parent / "README.md").read_text()
SCRIPTS = re.findall(r"^```python\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def run(script: str, folder: Path) -> None:
    """Run a script, whose last line must write a STEP file that holds valid solids."""
    import tpmscad

    (written,) = re.findall(r'"(\w+\.step)"\)\n$', script)
    exec(compile(script, "README.md", "exec"), {"__name__": "__main__"})
    assert tpmscad.check_step(folder / written).ok


@pytest.mark.documentation
@pytest.mark.parametrize(
    "script",
    [
        pytest.param(script, marks=[pytest.mark.frontend] if "cadquery" in script else [], id=script.split()[1])
        for script in SCRIPTS
    ],
)
def test_a_script_makes_what_it_says(script: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    run(script, tmp_path)
