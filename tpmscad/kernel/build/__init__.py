"""OCCT solids from boundary representations, by connectivity alone."""
