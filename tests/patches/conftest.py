"""The folder's own modules (solids of revolution made by hand) can be imported by its tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
