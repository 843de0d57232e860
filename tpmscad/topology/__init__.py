"""Topology of sampled fields: components, cavities, Betti numbers and persistent homology.

The solid of samples f at a level c is {f <= c}. The union-find sweeps count and pair components (dimension 0) and cavities
(dimension 2) fast enough for an optimisation loop; their loops are compiled by numba on first use and cached on disk.
`persistence_diagram` computes all three dimensions with gudhi, for inspection.
"""

from tpmscad.topology.components import (
    LabelledComponents,
    count_components_and_cavities,
    label_cavities,
    label_components,
)
from tpmscad.topology.cubical_betti import Betti, betti, bound_component_counts, euler_characteristic
from tpmscad.topology.diagrams import PersistenceDiagram, persistence_diagram
from tpmscad.topology.persistence import PersistencePairs, compute_pairs_at_level, compute_persistence
from tpmscad.topology.voxels import CONNECTIVITY

__all__ = [
    "CONNECTIVITY",
    "Betti",
    "LabelledComponents",
    "PersistenceDiagram",
    "PersistencePairs",
    "betti",
    "bound_component_counts",
    "compute_pairs_at_level",
    "compute_persistence",
    "count_components_and_cavities",
    "euler_characteristic",
    "label_cavities",
    "label_components",
    "persistence_diagram",
]


def __dir__() -> list[str]:
    return sorted(__all__)
