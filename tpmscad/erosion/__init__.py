"""Erosion of a body: the boundary representation of what is deeper than a skin, as an arrangement of offset surfaces."""
