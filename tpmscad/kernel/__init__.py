"""Conversion of boundary representations to OCCT shapes and files, and back: the only room that imports OCP."""
