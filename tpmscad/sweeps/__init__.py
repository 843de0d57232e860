"""Parameter studies: a table of designs in, each made and measured by any executor, a table of results out.

`sweep` reads the table (`parameter_table`), makes the designs that the table of results does not hold yet (`design_runs`), and
appends a row for each as it is finished (`results_table`). `results_plot` draws columns of results. The modules are loaded at
their first use, because they need NumPy.
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
