"""Conversion between arrays and OCCT objects, and access to the parts of OCCT shapes."""
