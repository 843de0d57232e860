"""The folder's own modules (complexes made by hand, a Part 21 parser) can be imported by its tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
