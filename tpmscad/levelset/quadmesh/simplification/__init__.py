"""Simplification of a quad mesh by local collapses, greedily and best first, with edits that can be undone.

Sources: Daniels, Silva, Shepherd and Cohen, "Quadrilateral mesh simplification", 2008 (polychord collapses); Tarini, Pietroni,
Cignoni, Panozzo and Puppo, "Practical quad mesh simplification", 2010 (diagonal collapses, doublet removal).

`simplify_mesh` simplifies a mesh; `EditHistory.undo` of its result undoes edits round polygons whose patches a fit rejects.

- `polygon_mesh`: mutable mesh with half-edge look-up; plans, applies and undoes edits that keep the topology.
- `vertex_stars`: the polygons round each vertex in arrays, for rating many collapses at once.
- `collapses`: candidate collapses and their rating.
- `collapse_candidates`: all candidates of a set of polygons, ranked, and which of them do not overlap.
- `greedy_simplification`: rounds of non-overlapping collapses, smoothing and verification.
- `edit_history`: the mesh at any time, and the edits that can be undone.
"""
