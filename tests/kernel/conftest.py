"""The folder's own modules (complexes made by hand, a Part 21 parser) and those of patches can be imported by its tests."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "patches")]
