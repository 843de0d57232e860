from tpmscad.sweeps._sweep import SweepResults as SweepResults
from tpmscad.sweeps._sweep import sweep as sweep
