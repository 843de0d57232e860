"""The benchmark runs, and shows what it says."""

from __future__ import annotations

import pytest

from benchmarks import cpia


@pytest.mark.slow
def test_the_printed_update_diverges_in_every_reading_and_cpia_converges(capsys: pytest.CaptureFixture[str]) -> None:
    radii, table = cpia.run("diamond")
    assert len(radii) == 36
    assert min(radii) > 2
    assert table["eq. 18 as printed, best reading"][-1] > 1e50
    assert table["CPIA, G2, Chebyshev, cosine grid"][-1] < table["PIA, cubic"][-1]
    assert "CPIA, G2" in capsys.readouterr().out
