"""The command line as `python -m tpmscad`."""

from __future__ import annotations

from tpmscad.cli import main

if __name__ == "__main__":
    main()
