"""Measurement of OCCT shapes: mass properties, validity, samples and distances."""
