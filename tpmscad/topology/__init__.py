"""Topology of sampled fields: persistence in dimensions 0 and 2 by union-find, components, cavities, Betti numbers.

Loops are compiled by numba on first use (some seconds, once per machine: they are cached on disk).
"""

from tpmscad.topology.betti import Betti, betti, certified, euler_characteristic
from tpmscad.topology.grid import CONNECTIVITY
from tpmscad.topology.persistence import Pairs, persistence
from tpmscad.topology.pieces import Pieces, cavities, components, isolated
from tpmscad.topology.straddle import straddling

__all__ = [
    "CONNECTIVITY",
    "Betti",
    "Pairs",
    "Pieces",
    "betti",
    "cavities",
    "certified",
    "components",
    "euler_characteristic",
    "isolated",
    "persistence",
    "straddling",
]
