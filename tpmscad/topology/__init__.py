"""Topology of sampled fields: persistence in dimensions 0 and 2 by union-find, components, cavities, Betti numbers.

Loops are compiled by numba on first use (some seconds, once per machine: they are cached on disk).
"""

from tpmscad.topology.components import (
    LabelledComponents,
    count_components_and_cavities,
    label_cavities,
    label_components,
)
from tpmscad.topology.cubical_betti import Betti, betti, bound_component_counts, euler_characteristic
from tpmscad.topology.persistence import PersistencePairs, compute_pairs_at_level, compute_persistence
from tpmscad.topology.voxels import CONNECTIVITY

__all__ = [
    "CONNECTIVITY",
    "Betti",
    "LabelledComponents",
    "PersistencePairs",
    "betti",
    "bound_component_counts",
    "compute_pairs_at_level",
    "compute_persistence",
    "count_components_and_cavities",
    "euler_characteristic",
    "label_cavities",
    "label_components",
]
