"""Parameter studies: a table of designs in, each made and measured by any executor, a table of results out.

`sweep` reads the table (`parameter_table`), makes the designs that the table of results does not hold yet (`design_runs`), and
appends a row for each as it is finished (`results_table`). `results_plot` draws columns of results. The modules are loaded at
their first use, because they need NumPy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad.sweeps.parameter_sweep import SweepResults, sweep

__all__ = ["SweepResults", "sweep"]

_MODULE_OF_NAME = {
    "SweepResults": "tpmscad.sweeps.parameter_sweep",
    "sweep": "tpmscad.sweeps.parameter_sweep",
}

__getattr__, __dir__ = lazy_attributes(__name__, _MODULE_OF_NAME)
